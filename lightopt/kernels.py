"""How kernels are compiled: numba, without the GIL, cached on disk under a name that changes with any kernel's source.

numba keys a cached kernel by the one file that it stands in, but compiles into it what it calls from other files. So
all kernels are cached in a folder named by the sources of all rooms that have any: after an edit or an update nothing
stale is ever run.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numba
from numba.core import config as numba_config

__all__ = ["cache_folder", "kernel"]

_ROOMS = ("fit", "inspection", "mesh", "optimize", "plan", "raycast", "reflectance", "rendering")


def cache_folder() -> Path:
    """Folder of this version's compiled kernels, in the user's cache; a temporary one where that cannot be written."""
    digest = hashlib.sha256(numba.__version__.encode())
    package = Path(__file__).parent
    for path in sorted(path for room in _ROOMS for path in (package / room).glob("*.py")):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    folder = base / "lightopt" / "kernels" / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        # cached kernels are pickles: never in a folder whose name others could have taken
        folder = Path(tempfile.mkdtemp(prefix="lightopt-kernels-"))
    return folder


# numba reads this when a kernel is declared; a person who set the variable knows better
if not os.environ.get("NUMBA_CACHE_DIR"):
    numba_config.CACHE_DIR = str(cache_folder())  # pyright: ignore[reportAttributeAccessIssue]

kernel: Any = numba.njit(cache=True, nogil=True)
"""Decorator of functions that run compiled, on arrays and numbers, without holding the interpreter's lock."""
