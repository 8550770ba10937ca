"""How much of what ``optimize`` counts as seen ``inspect`` cannot judge, since the good part is dark there.

``python -m benchmarks.dark`` makes a table of docs/inspection.md: the sample parts on the sample rig in their first
posture, 20,000 patches, the built-in catalogue of defects, finishes from the part's file to a polished one. The planner
counts a defect as seen where its level is off the good part's by a threshold times the noise, however dark that is; the
inspection judges no pixel that is predicted to be less than three standard deviations above black.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.inspection import CONFIGS, PARTS, replace_block
from lightopt import build_scene
from lightopt.defects import BUILT_IN_CATALOGUE
from lightopt.inspection._deviation import LIT
from lightopt.optimize import Contrast, Inspection, luminance_matrix, unroll
from lightopt.rendering import build_patches, cast_rays_at

PATCHES = 20_000
SEEN_IN = 2
FINISHES = {"as its file says": {}, "satin": {"R_s": 1500.0, "sigma": 0.14}, "polished": {"R_d": 1.0}}


def shares(part: str, changes: dict[str, float], *, patches: int = PATCHES) -> tuple[float, float]:
    """Share of surface × defects that two images show, and that two images show where the good part is lit."""
    scene = build_scene(CONFIGS / "rigs" / "four-panel.yaml", CONFIGS / "parts" / f"{part}.yaml")
    posture = scene.postures[0]
    scene = replace(scene, postures=(posture,), reflectance=replace(scene.reflectance, **changes))
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=patches)
    looked_for = Inspection(
        trials=unroll(BUILT_IN_CATALOGUE),
        contrast=Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale),
    )
    panels = tuple((light,) for light in scene.lights)
    matrix = luminance_matrix(scene, table, posture, panels, caster=caster, inspection=looked_for)
    seen = matrix.visibility
    assert seen is not None
    sensor = scene.sensor
    signal = [layer[0].astype(np.float64) - sensor.black_level for layer in matrix.levels]
    photons = [level / sensor.electrons_per_level if sensor.electrons_per_level else 0.0 for level in signal]
    noise = [np.sqrt(sensor.read_noise_levels**2 + p + 1.0 / 12.0) for p in photons]
    lit = tuple(
        np.where((level >= LIT * own)[None, :, None], words, np.uint64(0))
        for level, own, words in zip(signal, noise, seen.words, strict=True)
    )
    first = (0,) * len(panels)
    whole = float(seen.areas.sum()) * seen.total_weight
    both = (view.weights(view.seen(first, SEEN_IN)) for view in (seen, replace(seen, words=lit)))
    planned, judged = (float(seen.areas @ weights) / whole for weights in both)
    return planned, judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-page", action="store_true", help="print the table only")
    given = parser.parse_args()
    lines = [
        "| part | finish | seen by the planner | of it where the good part is dark |",
        "|---|---|---|---|",
    ]
    for part in PARTS:
        for finish, changes in FINISHES.items():
            planned, judged = shares(part, changes)
            lost = 1.0 - judged / planned
            lines.append(f"| {part} | {finish} | {100 * planned:.1f} % | {100 * lost:.2f} % |")
            print(lines[-1], flush=True)
    if not given.no_page:
        replace_block("dark", "\n".join(lines))


if __name__ == "__main__":
    main()
