"""Detectability: the search over all combinations against plain NumPy, the matrix against that of levels alone."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from benchmarks._case import CONFIGS, RIG, Size
from benchmarks._report import Report, Table, ratios, rounds
from benchmarks.bare import THREADS
from benchmarks.search import PLAIN_COMBINATIONS, REFINED, SCALES, THRESHOLDS, Scale, peak_bytes
from lightopt import build_scene, load_rig
from lightopt.defects import BUILT_IN_CATALOGUE, CatalogueEntry, DefectShape
from lightopt.design import (
    DetectabilityObjective,
    DetectionModel,
    LuminanceMatrix,
    PlannedCatalogue,
    find_candidates,
    luminance_matrix,
    planned_catalogue,
    search,
)
from lightopt.rendering import build_patches, cast_rays_at

PARTS = ("cover-knob", "spout")
SEEN_IN = (1, 2, 3)
SLOPES_DEG = (2.0, 4.0, 8.0)
FEW_POSITIONS = 4
"""Positions of each light in the comparison of matrices with converged panels."""


def three_slopes() -> PlannedCatalogue:
    """Dents of three slopes."""
    return planned_catalogue(
        [
            CatalogueEntry(
                f"dent of {slope:g}°", DefectShape(kind="dent", length=2.0, width=2.0, slope=math.radians(slope))
            )
            for slope in SLOPES_DEG
        ]
    )


def run(size: Size) -> Report:
    """Measure the matrix and the search on both sample parts."""
    scale = SCALES[size.name]
    repeats = min(5, size.repeats)
    numbers: dict[str, object] = {}
    searches: list[tuple[str, ...]] = []
    matrices: list[tuple[str, ...]] = []
    for part in PARTS:
        for name, trials in (
            ("three slopes", three_slopes()),
            ("built-in catalogue", planned_catalogue(BUILT_IN_CATALOGUE)),
        ):
            matrix = matrix_rows(part, name, trials, scale, 4, repeats, matrices, numbers)
            searches += search_rows(part, name, matrix, trials, repeats, numbers)
        matrix_rows(
            part, "built-in catalogue", planned_catalogue(BUILT_IN_CATALOGUE), scale, "auto", repeats, matrices, numbers
        )
    numbers["peak_bytes"] = peak_bytes()
    return Report(
        "detectability",
        [
            Table(
                f"search, every combination scored, {THREADS} threads (target < 3 s)",
                ("part", "defects", "pairs", "images", "combinations", "least s", "plain s", "times faster"),
                searches,
            ),
            Table(
                "matrix with the evidence of defects against that of levels alone",
                (
                    "part",
                    "defects",
                    "points",
                    "positions × patches",
                    "levels s",
                    "with defects s",
                    "ratio of least",
                    "median ratio",
                ),
                matrices,
            ),
        ],
        numbers,
        [
            f"plain NumPy: the definition for {PLAIN_COMBINATIONS // 10} combinations drawn at random, extrapolated",
            f"peak memory of the whole benchmark {peak_bytes() / 1e9:.2f} GB",
        ],
    )


def matrix_rows(
    part: str,
    name: str,
    trials: PlannedCatalogue,
    scale: Scale,
    points: int | str,
    repeats: int,
    rows: list[tuple[str, ...]],
    numbers: dict[str, object],
) -> LuminanceMatrix:
    """A row for a part's matrices with and without defects; returns the one with all positions, with few if `auto`."""
    scene = build_scene(RIG, CONFIGS / "parts" / f"{part}.yaml", points=points)  # type: ignore[arg-type]
    scene = replace(scene, postures=scene.postures[:1])
    caster = cast_rays_at(scene)
    wanted = scale.patches if points != "auto" else scale.patches // 10
    table = build_patches(scene, caster=caster, budget=round(REFINED * wanted))
    # halving faces stops short of the budget, and a mesh may have more faces: as many as are wanted are drawn
    keep = np.random.default_rng(3).random(len(table.patches)) < wanted / table.visible.sum()
    table = replace(table, visible=table.visible & keep)
    panels = find_candidates(load_rig(RIG), step_deg=scale.step_deg, points=points).panels  # type: ignore[arg-type]
    inspection = DetectionModel(
        catalogue=trials, sensor=scene.sensor, full_scale=scene.reflectance.full_scale, min_images=2
    )
    few = tuple(
        tuple(light[k] for k in np.linspace(0, len(light) - 1, min(len(light), FEW_POSITIONS)).astype(int))
        for light in panels
    )

    def made(some: tuple, looked_for: DetectionModel | None) -> LuminanceMatrix:  # type: ignore[type-arg]
        return luminance_matrix(
            scene, table, scene.postures[0], some, caster=caster, detection=looked_for, threads=THREADS
        )

    made(few, inspection)  # compiles
    times = rounds({"with": lambda: made(few, inspection), "levels": lambda: made(few, None)}, repeats)
    least, median = ratios(times["with"], times["levels"])
    start = time.perf_counter()
    matrix = made(few if points == "auto" else panels, inspection)
    whole = time.perf_counter() - start
    numbers[f"matrix: {part}, {name}, {points}"] = {"seconds": times, "ratio": least, "whole_seconds": whole}
    positions = sum(len(light) for light in few)
    rows.append(
        (
            part, name, str(points), f"{positions} × {len(matrix.areas):,}", f"{min(times['levels']):.2f}",
            f"{min(times['with']):.2f}", f"{least:.2f}", f"{median:.2f}",
        )
    )  # fmt: skip
    return matrix


def search_rows(
    part: str, name: str, matrix: LuminanceMatrix, trials: PlannedCatalogue, repeats: int, numbers: dict[str, object]
) -> list[tuple[str, ...]]:
    """A row for each number of images; the fast and the plain way in the same rounds."""
    rows: list[tuple[str, ...]] = []
    cells = int(np.prod(matrix.shape))
    rng = np.random.default_rng(1)
    count = PLAIN_COMBINATIONS // 10
    drawn = [tuple(int(rng.integers(n)) for n in matrix.shape) for _ in range(count)]
    for min_images in SEEN_IN:
        objective = DetectabilityObjective(trials.defects, min_images)
        weights = objective.weights(matrix.areas)

        def fast(objective: DetectabilityObjective = objective) -> object:
            return search([matrix], objective, THRESHOLDS, keep=2, threads=THREADS)

        def plain(objective: DetectabilityObjective = objective, weights: object = weights) -> object:
            return [objective.score(matrix.combination(c), weights, THRESHOLDS) for c in drawn]  # type: ignore[arg-type]

        fast()  # compiles
        times = rounds({"search": fast, "plain": plain}, repeats)
        numbers[f"search: {part}, {name}, {min_images}"] = times
        slow = min(times["plain"]) / count * cells
        rows.append(
            (
                part, name, f"{len(matrix.areas):,} × {len(trials.defects)}", str(min_images), f"{cells:,}",
                f"{min(times['search']):.3f}", f"{slow:,.0f}", f"{slow / min(times['search']):,.0f}",
            )
        )  # fmt: skip
    return rows
