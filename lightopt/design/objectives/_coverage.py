"""Objective ``coverage``: area that two images or more show usably and at most one image shows saturated.

The two conditions of the paper's section 5.1 as a number: a defect must be confirmed by two or more images, and
highlights must not fall on the same place in several. With U the number of images in which a patch is usable (neither
shaded nor saturated) and S the number in which it is saturated,

    score = Σ area · [U ≥ 2 and S ≤ 1],

in whole square micrometres. A patch's part in it depends on the classes of its levels only, and these change a few
times along the candidates of a light: see :mod:`._scores_by_level_classes`. Patches whose classes change all the time
are left to :mod:`._scores_by_packed_bits`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64, Int64
from lightopt.core.run_context import Share, part_of
from lightopt.core.threads import blocks
from lightopt.design.objectives._objective import INSPECTABLE_SURFACE, area_text
from lightopt.design.objectives._scores_by_level_classes import run_products, run_scores
from lightopt.design.objectives._scores_by_packed_bits import bit_scores
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix, area_units, level_range

LEAST_USABLE = 2  # images that must show a patch usably
MOST_SATURATED = 1  # images that may show it saturated

RULE = LEAST_USABLE, MOST_SATURATED

# a patch goes to the packed bits when its classes make more than 1/512 of the table's number of cells: there the two
# ways take about the same time
BITS_SHARE = 512

BOUND_PATCHES = 1 << 16  # patches whose bound is computed at once


@dataclass(frozen=True)
class CoverageObjective:
    """Usable area; see the module's text."""

    name: str = "coverage"
    unit: str = "µm²"
    share_of: str = INSPECTABLE_SURFACE

    def format_score(self, score: int, grain: float) -> str:
        return area_text(score, grain)

    def full_score(self, area: int) -> int | None:
        return area

    def refusal(self, lights: int) -> str | None:
        """One image is never two."""
        if lights >= LEAST_USABLE:
            return None
        return (
            f"objective coverage wants each patch usable in {LEAST_USABLE} images, and there is one light only; use "
            "the objective detectability"
        )

    def weights(self, areas: Float64) -> Int64:
        return area_units(areas)

    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        levels = np.concatenate(matrix.levels)
        saturated = levels >= thresholds.saturation
        usable = (levels >= thresholds.shade) & ~saturated
        covered = (usable.sum(axis=0) >= LEAST_USABLE) & (saturated.sum(axis=0) <= MOST_SATURATED)
        return int(weights[covered].sum())

    def scores(
        self,
        matrix: LuminanceMatrix,
        weights: Int64,
        thresholds: LevelThresholds,
        *,
        threads: int,
        progress: Share | None = None,
    ) -> Int64:
        """By runs of candidates where a patch's class stays, or by packed bits."""
        levels = matrix.levels
        products = run_products(levels, thresholds)
        cells = math.prod(len(layer) for layer in levels)
        simple = products <= max(64.0, cells / BITS_SHARE)
        # the work of each way, in boxes
        by_runs = float(products[simple].sum())
        by_bits = float(np.count_nonzero(~simple)) * cells / BITS_SHARE
        share = by_runs / max(1.0, by_runs + by_bits)
        table = run_scores(
            levels,
            np.flatnonzero(simple),
            weights,
            thresholds,
            rule=RULE,
            threads=threads,
            progress=part_of(progress, 0.0, share),
        )
        if not simple.all():
            table += bit_scores(
                levels,
                np.flatnonzero(~simple),
                weights,
                thresholds,
                rule=RULE,
                threads=threads,
                progress=part_of(progress, share, 1.0),
            )
        return table

    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """Patches that could be usable under two lights and need not be saturated under more than one."""
        total = 0
        for start, end in blocks(len(weights), BOUND_PATCHES):
            can_use = np.zeros(end - start, np.int64)
            must_saturate = np.zeros(end - start, np.int64)
            for layer in matrix.levels:
                usable, _, least = level_range(layer, thresholds, start, end)
                can_use += usable >= 0
                must_saturate += least >= thresholds.saturation
            could = (can_use >= LEAST_USABLE) & (must_saturate <= MOST_SATURATED)
            total += int(weights[start:end][could].sum())
        return total

    def details(self, matrices: Sequence[LuminanceMatrix], weights: Sequence[Int64]) -> Mapping[str, Any]:
        del matrices, weights
        return {}


COVERAGE = CoverageObjective()
