"""Each peer in a process of its own: a library that is missing, or that ends its process, takes no other peer along.

``benchmarks/_peer_server.py`` is that process.
"""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks._case import Size

Float32 = NDArray[np.float32]

MITSUBA = "Mitsuba 3 llvm_ad_mono"
"""The one peer that needs an LLVM of the system: lightopt's own is inside llvmlite, whose errors name LLVM as well."""

DEBIAN = {
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libgomp.so.1": "libgomp1",
}
"""Debian package of each library that a peer may lack."""

LLVM = "install Debian's package libllvm19 or a later one, or name its libLLVM.so in DRJIT_LIBLLVM_PATH"
"""Mitsuba 3.9 refuses LLVM 14; 15 and 16 end its process (no instruction for fminimum); 19 works."""


class PeerError(Exception):
    """A peer that does not run here; the message is one line that says what to do."""


def _explain(name: str, said: str, status: int) -> str:
    """Why a peer does not run and what to install, from its standard error and its exit status."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    missing = re.search(r"(lib[\w.+-]+\.so[.\d]*): cannot open shared object file", said)
    if name == MITSUBA and (problem := _llvm_problem(said)) is not None:
        return f"{problem}: {LLVM}"
    if missing and missing[1] in DEBIAN:
        return f"it lacks {missing[1]}: install Debian's package {DEBIAN[missing[1]]}"
    if missing:
        return f"it lacks {missing[1]}: install the Debian package that has it (apt-file search {missing[1]})"
    if module := re.search(r"No module named '([\w.]+)'", said):
        return f"{module[1]} is not installed: make bench installs it where there is a wheel for this Python"
    if status < 0:
        return f"its process was ended by signal {-status}" + (f": {lines[-1]}" if lines else "")
    return lines[-1] if lines else f"its process ended with status {status}"


def _llvm_problem(said: str) -> str | None:
    """What Dr.Jit says of the system's LLVM, or LLVM itself as it ends the process; None where that is not it."""
    if old := re.search(r"LLVM version \((\d+)\) is too old", said):
        return f"LLVM {old[1]} is too old"
    if "the LLVM backend is inactive" in said:
        return "there is no LLVM"
    if ended := re.search(r"LLVM ERROR: .*", said):
        return f"its LLVM ended the process ({ended[0].strip()})"
    return None


class PeerProcess:
    """One peer's process.

    Raises
    ------
    PeerError
        Where it does not start, or ends later on.
    """

    def __init__(self, name: str, size: Size, part: str, *, program: tuple[str, ...] | None = None) -> None:
        self.name = name
        self._errors = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        own = (sys.executable, "-m", "benchmarks._peer_server", name, size.name, part)
        self._process = subprocess.Popen(
            program or own,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            text=True,
            encoding="utf-8",
        )
        self._answer()

    def build(self) -> float:
        """Build whatever the mesh needs; the seconds that it took."""
        return float(self._ask("build"))

    def images(self) -> float:
        """Make the images of all lights from what was built; the seconds that it took."""
        return float(self._ask("images"))

    def levels(self) -> list[Float32]:
        """The images that were made last."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "images.npy"
            self._ask(f"save {path}")
            return list(np.load(path))

    def close(self) -> None:
        """End the process."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._process.wait()
        self._errors.close()

    def _ask(self, what: str) -> str:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # of which the missing answer tells
            self._process.stdin.write(what + "\n")
            self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if line.endswith("\n"):
            return json.loads(line)
        status = self._process.wait()
        self._errors.seek(0)
        reason = _explain(self.name, self._errors.read(), status)
        self.close()
        raise PeerError(f"{self.name} does not run here and is left out: {reason}")
