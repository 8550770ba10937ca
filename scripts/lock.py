"""Renew requirements/*.lock: exact versions with hashes, for all supported Pythons, Linux and Windows.

``python scripts/lock.py`` keeps what is locked where it still satisfies pyproject.toml; ``--upgrade`` takes the newest.
uv, which resolves for all platforms at once, is installed into a temporary environment.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCKS = {"ci": ("dev", "aravis", "genicam"), "dev": ("dev",), "docs": ("docs",)}
"""Extras of each lock; those after the first are constrained by it, so that versions agree."""


def main(upgrade: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        scripts = Path(folder) / ("Scripts" if os.name == "nt" else "bin")
        subprocess.run([scripts / "python", "-m", "pip", "install", "--quiet", "uv>=0.8"], check=True)
        build = Path(folder) / "build.in"
        # an editable package is built in the environment itself, so that its builder is locked, too
        build.write_text("setuptools>=77\n", encoding="utf-8")
        first = ROOT / "requirements" / f"{next(iter(LOCKS))}.lock"
        for name, extras in LOCKS.items():
            lock = ROOT / "requirements" / f"{name}.lock"
            command = [str(scripts / "uv"), "pip", "compile", "--quiet", "--universal", "--generate-hashes"]
            command += ["--python-version", "3.10", "--no-annotate", "--no-header"]
            command += [f"--extra={extra}" for extra in extras]
            command += ["--upgrade"] if upgrade and lock == first else []
            command += [] if lock == first else ["--constraint", str(first)]
            command += [str(ROOT / "pyproject.toml"), str(build), "--output-file", str(lock)]
            subprocess.run(command, check=True, cwd=ROOT)
            text = lock.read_text(encoding="utf-8")
            note = f"# Made by make lock: extras {', '.join(extras)} of pyproject.toml, for Python 3.10 to 3.13.\n"
            lock.write_text(note + text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main("--upgrade" in sys.argv[1:])
