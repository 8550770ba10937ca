"""Fixtures of the unit tests."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def read_only_folder(tmp_path: Path) -> Iterator[Path]:
    """A folder that this user, even root, cannot write to."""
    if sys.platform == "win32":
        pytest.skip("a Windows folder has no mode that keeps its owner from writing")
    if os.geteuid() == 0:
        yield Path("/sys")
    else:
        tmp_path.chmod(0o500)
        yield tmp_path
        tmp_path.chmod(0o700)
