"""Inspect a part: render one with random defects, find them, and place them on the part."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.images import read_image_set
from lightopt.inspection import InspectOptions, inspect_set, scatter_defects, write_defects
from lightopt.rendering import RenderOptions, render_image_set

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, good = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    defects = scatter_defects(rig, good, count=4, seed=1)
    print([defect.kind for defect in defects])
    render_image_set(rig, good, out / "images", options=RenderOptions(noise=1))
    result = inspect_set(rig, good, read_image_set(out / "images"), options=InspectOptions(fusion=None))
    print(len(result.defects), "defects")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-inspect"))
