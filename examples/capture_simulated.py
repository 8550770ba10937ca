"""Capture with the simulated rig: the same call drives a real one whose file has a `hardware` section."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.images import read_image_set
from lightopt.rig.capture import CaptureOptions, capture, make_plan
from lightopt.scene import part_postures

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, part = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    options = CaptureOptions(postures=part_postures(part)[:1], exposures=(1.0, 1 / 16))
    for step in make_plan(rig, part, options).steps():  # nothing moves yet
        print(step)
    capture(rig, part, out / "images", options=options)
    for entry in read_image_set(out / "images").images:
        print(f"{entry.light} at {entry.posture}, exposure {entry.exposure:g}: {entry.png}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-capture"))
