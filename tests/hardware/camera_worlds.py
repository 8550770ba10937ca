"""Cameras to test with: what they need, and rigs that have them."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import pytest

from lightopt.core.errors import InputError
from lightopt.rig.devices import check_camera_driver

__all__ = ["needs", "viky"]


def needs(driver: str) -> None:
    """Skip a test whose camera's software is not here; in CI it has to be."""
    if os.environ.get("CI") == "true":
        return
    try:
        check_camera_driver(driver, None)
    except InputError as error:
        pytest.skip(str(error))


def viky() -> Path:
    """The GenTL producer that the genicam wheel brings, with three simulated cameras of 400 × 400 pixels."""
    found = find_spec("genicam")
    assert found is not None
    assert found.origin is not None
    return Path(found.origin).parent / "viky.cti"
