"""Length units of files; inside the package everything is millimetres and radians."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

__all__ = ["MM_PER_UNIT", "UNIT_NAMES"]

MM_PER_UNIT: Mapping[str, float] = MappingProxyType(
    {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4, "ft": 304.8}
)
"""Millimetres in one unit, by the unit's name in YAML files."""

UNIT_NAMES: tuple[str, ...] = tuple(MM_PER_UNIT)
