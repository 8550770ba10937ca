"""Objective ``coverage``: area that two images or more show usably and at most one image shows saturated.

The two conditions of the paper's section 5.1 as a number: a defect must be confirmed by two or more images, and
highlights must not fall on the same place in several. With U the number of images in which a patch is usable (neither
shaded nor saturated) and S the number in which it is saturated,

    score = Σ area · [U ≥ 2 and S ≤ 1],

in whole square micrometres. A patch's part in it depends on the classes of its levels only, and these change a few
times along the candidates of a light: see :mod:`lightopt.optimize._runs`. Patches whose classes change all the time are
left to :mod:`lightopt.optimize._bits`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.optimize._bits import bit_scores
from lightopt.optimize._matrix import Levels, Thresholds, area_units
from lightopt.optimize._runs import run_products, run_scores

__all__ = ["COVERAGE", "LEAST_USABLE", "MOST_SATURATED", "Coverage"]

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

LEAST_USABLE = 2
"""Images that must show a patch usably."""

MOST_SATURATED = 1
"""Images that may show it saturated."""

BITS_SHARE = 512
"""A patch goes to the packed bits when its classes make more than 1/512 of the table's number of cells: there the two
ways
take about the same time."""


@dataclass(frozen=True)
class Coverage:
    """Usable area; see the module's text."""

    name: str = "coverage"
    unit: str = "µm²"

    def refusal(self, lights: int) -> str | None:
        """One image is never two."""
        if lights >= LEAST_USABLE:
            return None
        return f"objective coverage wants each patch usable in {LEAST_USABLE} images, and there is one light only"

    def weights(self, areas: Float64) -> Int64:
        """Each patch counts by its area."""
        return area_units(areas)

    def score(self, levels: Levels, weights: Int64, thresholds: Thresholds) -> int:
        """Count images, compare, add areas."""
        saturated = levels >= thresholds.saturation
        usable = (levels >= thresholds.shade) & ~saturated
        covered = (usable.sum(axis=0) >= LEAST_USABLE) & (saturated.sum(axis=0) <= MOST_SATURATED)
        return int(weights[covered].sum())

    def scores(
        self, levels: Sequence[Levels], weights: Int64, thresholds: Thresholds, *, threads: int
    ) -> Int64:
        """By runs of candidates where a patch's class stays, or by packed bits."""
        products = run_products(levels, thresholds)
        cells = float(np.prod([len(layer) for layer in levels], dtype=np.float64))
        simple = products <= max(64.0, cells / BITS_SHARE)
        if simple.all():
            return run_scores(levels, weights, thresholds, rule=_rule(), threads=threads)
        table = np.zeros(tuple(len(layer) for layer in levels), np.int64)
        for chosen, ways in ((simple, run_scores), (~simple, bit_scores)):
            if chosen.any():
                some = [np.ascontiguousarray(layer[:, chosen]) for layer in levels]
                table += ways(some, weights[chosen], thresholds, rule=_rule(), threads=threads)
        return table

    def bound(self, levels: Sequence[Levels], weights: Int64, thresholds: Thresholds) -> int:
        """Patches that could be usable under two lights and need not be saturated under more than one."""
        can_use, must_saturate = 0, 0
        for layer in levels:
            saturated = layer >= thresholds.saturation
            can_use = can_use + ((layer >= thresholds.shade) & ~saturated).any(axis=0).astype(np.int64)
            must_saturate = must_saturate + saturated.all(axis=0).astype(np.int64)
        return int(weights[(can_use >= LEAST_USABLE) & (must_saturate <= MOST_SATURATED)].sum())


def _rule() -> tuple[int, int]:
    return LEAST_USABLE, MOST_SATURATED


COVERAGE = Coverage()
