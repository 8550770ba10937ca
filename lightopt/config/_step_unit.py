"""The length unit that a STEP file declares (ISO 10303-21, -41)."""

from __future__ import annotations

import re
from pathlib import Path

__all__ = ["step_units"]

_CONTEXT = re.compile(rb"GLOBAL_UNIT_ASSIGNED_CONTEXT\s*\(\s*\(([^)]*)\)")
_SI = re.compile(rb"SI_UNIT\s*\(\s*(\$|\.\w+\.)\s*,\s*\.METRE\.\s*\)")
_NAMED = re.compile(rb"CONVERSION_BASED_UNIT\s*\(\s*'(\w*)'")
_SI_NAMES = {b"$": "m", b".MILLI.": "mm", b".CENTI.": "cm", b".MICRO.": "um"}
_NAMES = {b"INCH": "inch", b"INCHES": "inch", b"IN": "inch", b"FOOT": "ft", b"FEET": "ft", b"FT": "ft"}


def step_units(path: Path) -> frozenset[str]:
    """Length units that the geometry of a STEP file is in, by their names in YAML files; usually one.

    Empty when the file declares none that is known, or cannot be read.
    """
    try:
        data = path.read_bytes()
    except OSError:
        return frozenset()
    used = {number for refs in _CONTEXT.findall(data) for number in re.findall(rb"#(\d+)", refs)}
    units: set[str] = set()
    for match in re.finditer(rb"\bLENGTH_UNIT\b", data):
        start = data.rfind(b";", 0, match.start()) + 1
        statement = data[start : data.find(b";", match.end())]
        number = re.search(rb"#(\d+)\s*=", statement)
        if number is None or number[1] not in used:
            continue
        if si := _SI.search(statement):
            units.add(_SI_NAMES.get(si[1], ""))
        elif named := _NAMED.search(statement):
            units.add(_NAMES.get(named[1].upper(), ""))
    return frozenset(units - {""})
