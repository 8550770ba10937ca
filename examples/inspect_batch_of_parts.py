"""Inspect several parts: one that cannot be inspected does not stop the rest."""

from __future__ import annotations

import sys
from pathlib import Path

from lightopt import load_part, load_rig
from lightopt.images import read_image_set
from lightopt.inspection import InspectOptions, inspect_batch
from lightopt.rendering import RenderOptions, render_image_set
from lightopt.scene import part_postures

HERE = Path(__file__).parent


def main(out: Path) -> None:
    rig, part = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    first = part_postures(part)[:1]
    sets = []
    for seed in (1, 2):
        folder = out / f"part-{seed}"
        render_image_set(rig, part, folder, options=RenderOptions(noise=seed, postures=first))
        sets.append(read_image_set(folder))
    for one in inspect_batch(rig, part, sets, options=InspectOptions(fusion=None)):
        print(one.name, one.error or one.verdict.explanation)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/example-batch"))
