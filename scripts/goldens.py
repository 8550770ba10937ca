"""Render the golden scenes: ``check`` compares them with what is committed, ``renew`` replaces it.

The scenes are small (a 128 × 96 camera) and use the committed STL meshes, whose triangles do not depend on the version
of a CAD kernel. Everything goes through the commands that a user types.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests" / "regression" / "golden"
SCENES = GOLDEN / "scenes"

RENDERS: dict[str, list[str]] = {
    "knob": ["rig.yaml", "knob.yaml", "--layers", "--exposure", "1,1/16"],
    "knob-auto": ["rig.yaml", "knob.yaml", "--points", "auto", "--posture", "0,82"],
    "spout": ["rig-12bit.yaml", "spout.yaml"],
    "spout-auto": ["rig-12bit.yaml", "spout.yaml", "--points", "auto", "--supersample", "2"],
}
"""What is rendered for each golden set: rig, part and options."""

PATCHES = "500"


def run(*arguments: str) -> int:
    """Run lightopt and return its exit status."""
    return subprocess.run([sys.executable, "-m", "lightopt", *arguments], check=False).returncode


def render(name: str, folder: Path) -> None:
    """Render one golden scene into a folder."""
    rig, part, *options = RENDERS[name]
    status = run(
        "render", str(SCENES / rig), str(SCENES / part), "-o", str(folder), "--patches", PATCHES, "-q", *options
    )
    if status:
        sys.exit(f"{name}: lightopt render left with exit status {status}")


def check(out: Path) -> int:
    """Render all scenes into `out` and compare; returns the number of sets that differ."""
    failures = 0
    for name in RENDERS:
        print(f"== {name}", flush=True)
        shutil.rmtree(out / name, ignore_errors=True)
        render(name, out / name)
        different = run(
            "compare", str(GOLDEN / name), str(out / name), "--diff", str(out / name / "differences"),
            "--json", str(out / name / "comparison.json"),
        )  # fmt: skip
        failures += different != 0
    print(f"{len(RENDERS) - failures} of {len(RENDERS)} golden sets agree; the new ones are in {out}")
    return failures


def renew() -> None:
    """Replace the committed golden sets."""
    for name in RENDERS:
        shutil.rmtree(GOLDEN / name, ignore_errors=True)
        render(name, GOLDEN / name)
    size = sum(path.stat().st_size for path in GOLDEN.rglob("*") if path.is_file())
    print(f"{size / 1e6:.2f} MB of goldens in {GOLDEN}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("action", choices=["check", "renew"])
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "golden")
    options = parser.parse_args()
    if options.action == "renew":
        renew()
    elif check(options.out):
        sys.exit(1)


if __name__ == "__main__":
    main()
