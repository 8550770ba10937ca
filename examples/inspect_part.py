"""Inspect a part: render one with random defects, find them, and place them on the part."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.images import read_image_set
from lightopt.inspection import (
    InspectOptions,
    inspect_set,
    judge,
    place_random_defects,
    random_defect_provenance,
    random_defects_text,
)
from lightopt.rendering import RenderOptions, render_image_set

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, good = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    defects = place_random_defects(rig, good, count=4, seed=1)
    made_from = random_defect_provenance(rig, good, count=4, seed=1)
    out.mkdir(parents=True, exist_ok=True)
    text = random_defects_text(good, defects, folder=out, comment="4 random defects", made_from=made_from)
    (out / "part.yaml").write_text(text, encoding="utf-8")
    defective = load_part(out / "part.yaml")

    render_image_set(rig, defective, out / "images", options=RenderOptions(noise=1))
    result = inspect_set(rig, good, read_image_set(out / "images"), options=InspectOptions(fusion=None))
    for defect in result.defects:
        x, y, z = defect.best.position  # in the coordinates of the mesh file
        print(f"{defect.best.kind} at {x:.1f}, {y:.1f}, {z:.1f} mm, area {defect.area:.2f} mm²")
    print(judge(result, good.inspection).word)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-inspect"))
