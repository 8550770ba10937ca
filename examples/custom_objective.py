"""Score light positions by an objective of your own, from the levels that the camera would deliver.

Here: the area of surface whose darkest and brightest levels of all lights differ least in ratio.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from lightopt import build_scene, load_part, load_rig
from lightopt.design import find_candidates, luminance_matrix
from lightopt.rendering import build_patches, cast_rays_at

HERE = Path(__file__).parent


def main() -> None:
    rig, part = load_rig(HERE / "rig.yaml"), load_part(HERE / "part.yaml")
    scene = build_scene(rig, part)
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=1000)
    candidates = find_candidates(rig, step_deg=15, scene=scene)
    matrix = luminance_matrix(scene, table, scene.postures[0], candidates.panels, caster=caster)
    # matrix.levels: per light, delivered levels, shape (candidates, patches); matrix.areas: [mm²], shape (patches,)

    def score(combination: tuple[int, ...]) -> float:
        levels = np.stack([layer[k] for layer, k in zip(matrix.levels, combination, strict=True)])
        even = levels.min(axis=0) > 0.5 * levels.max(axis=0)
        return float(matrix.areas[even].sum())

    best = max(itertools.product(*(range(len(layer)) for layer in matrix.levels)), key=score)
    for name, angles, number in zip(candidates.names, candidates.places, best, strict=True):
        print(f"{name}: elevation {angles[number][0]:g}°")
    print(f"{score(best):.0f} mm² lit evenly")


if __name__ == "__main__":
    main()
