"""What light positions between the candidates can score at most.

Lights move continuously, candidates are steps. Between neighbouring candidates, in a cell of their grid, the level of a
patch and the evidence of a defect are taken to lie between those of the cell's corners. Then each cell is given, patch
by patch, the best that its corners allow, and the same exact search over combinations of cells gives a score that no
positions within the ranges exceed. For levels the best is

- the greatest, where all corners are below saturation or all are saturated;
- the greatest usable level, where some are saturated and others are not;

which no objective scores lower than any level between. For evidence it is the most units of any corner.

The assumption fails where a highlight is narrower than a step and passes between two candidates. It is tested: midway
between the corners of some cells, the share of the surface that shows more than the cell allows is part of the answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Int64
from lightopt.core.errors import percent
from lightopt.core.run_context import Share, ignore
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates, panels_of
from lightopt.design._cells import Cells, middle
from lightopt.design._problem import OptimizeOptions
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._image_evaluator import MOST_BYTES, ImageEvaluator, drawn_patches
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix
from lightopt.design.responses._pairs import Words
from lightopt.design.search._exact_search import search
from lightopt.lights import PanelLight

TESTED_CELLS = 4  # of each light
TESTED_SHARE, LEAST_TESTED, MOST_TESTED = 0.1, 200, 4_000  # share and numbers of patches that represent the others
MOST_OUTSIDE = 0.01  # share of the surface that may show more midway; more causes a warning


BETWEEN_MEANING = (
    "this bound is of all positions within the ranges, if the levels and the evidence of defects between neighbouring "
    "candidates lie between theirs"
)
"""What a score of positions between the candidates is."""


@dataclass(frozen=True, kw_only=True)
class BetweenSteps:
    bound: int  # score that no positions exceed, if levels between candidates lie between theirs
    outside: float  # share of the surface, × defects where these decide, that shows more midway in the cells tested

    def warning(self, postures: Sequence[Posture]) -> str | None:
        """The warning about steps that are too large for the bound to hold; None where they are not."""
        if self.outside <= MOST_OUTSIDE:
            return None
        return (
            f"{', '.join(map(str, postures))}: midway between candidate positions {percent(self.outside, 0)} of the "
            "surface shows more than at any of them: the bound for positions between the steps may be too low. Lower "
            "option 'step_deg', or distance_step_mm of the light"
        )


def cell_levels(layer: Levels, corners: Sequence[Int64], thresholds: LevelThresholds) -> Levels:
    """The best levels that the corners of each cell allow, shape (cells, p); `layer` has those of the candidates."""
    best = np.empty((len(corners), layer.shape[1]), layer.dtype)
    usable = min(thresholds.saturation - 1, int(np.iinfo(layer.dtype).max))
    for row, some in zip(best, corners, strict=True):
        least, greatest = layer[some].min(axis=0), layer[some].max(axis=0)
        row[:] = np.where(least <= usable, np.minimum(greatest, usable), greatest)
    return best


def cell_flags(flags: Words, corners: Int64) -> Words:
    """The most units of evidence of the corners of a cell, shape (units, p, words); `flags` has all candidates'."""
    return np.bitwise_or.reduce(flags[corners], axis=0)


def cell_matrix(matrix: LuminanceMatrix, cells: Cells, thresholds: LevelThresholds) -> LuminanceMatrix:
    """The luminance matrix of cells instead of candidates."""
    levels = (cell_levels(*own, thresholds) for own in zip(matrix.levels, cells.corners, strict=True))
    seen = matrix.visibility
    if seen is not None:
        lights = zip(seen.words, cells.corners, strict=True)
        words = tuple(np.array([cell_flags(flags, some) for some in corners]) for flags, corners in lights)
        seen = replace(seen, words=words)
    return replace(matrix, levels=tuple(levels), visibility=seen)


def bound_between(
    matrices: Sequence[LuminanceMatrix],
    objective: Objective,
    thresholds: LevelThresholds,
    cells: Cells,
    *,
    limit: int,
    threads: int | None = None,
    progress: Share = ignore,
) -> int | None:
    """A score that no positions between candidates exceed; None where memory does not suffice.

    matrices: Of the candidates, as for :func:`search`; also `limit`, `threads` and `progress` are as there.
    """
    layers = [layer for matrix in matrices for layer in (*matrix.levels, *_words(matrix))]
    if 2 * sum(layer.nbytes for layer in layers) > MOST_BYTES:
        return None
    best = [cell_matrix(matrix, cells, thresholds) for matrix in matrices]
    space = cells.space
    found = search(best, objective, thresholds, space=space, keep=2, limit=limit, threads=threads, progress=progress)
    return found.bound


def _words(matrix: LuminanceMatrix) -> tuple[Words, ...]:
    return () if matrix.visibility is None else matrix.visibility.words


def share_outside(
    rig: RigConfig,
    candidates: Candidates,
    options: OptimizeOptions,
    evaluator: ImageEvaluator,
    shots: Sequence[tuple[Posture, tuple[float, ...]]],
) -> float:
    """Share of the surface that shows more midway between candidates than the corners there allow.

    Of the lights the one with the largest share, in the mean of some of its cells. Where the evaluator tests images
    for defects, it is a share of surface × defects.

    shots: Postures, with the exposures of their images.
    """
    thresholds = LevelThresholds.of_sensor(evaluator.scene.sensor, shade_share=options.shade_below)
    few = max(LEAST_TESTED, min(MOST_TESTED // len(shots), round(TESTED_SHARE * len(evaluator.patches))))
    drawn = replace(evaluator, table=drawn_patches(evaluator.table, few), images=None, pool=None)
    cells = candidates.cells
    tested = [_evenly(len(own)) if moves else [] for own, moves in zip(cells.of_lights, cells.moves, strict=True)]
    # of each cell the panels at its corners, then the one midway
    panels: list[list[PanelLight]] = []
    for light, some in enumerate(tested):
        midway = [middle(cells.of_lights[light][k]) for k in some]
        between = panels_of(rig, light, midway, options.points)
        own = candidates.panels[light]
        panels.append(
            [
                one
                for k, at in zip(some, between, strict=True)
                for one in (*(own[c] for c in cells.corners[light][k]), at)
            ]
        )
    outside, whole = np.zeros(len(panels)), np.zeros(len(panels))
    for posture, exposures in shots:
        matrices = drawn.matrices(posture, panels, exposures=exposures)
        for light, some in enumerate(tested):
            start = 0
            for k in some:
                end = start + len(cells.corners[light][k])
                more, most = _outside(matrices, light, slice(start, end), thresholds)
                outside[light] += more
                whole[light] += most
                start = end + 1
    return float(np.max(outside / np.maximum(whole, 1e-12), initial=0.0))


def _evenly(count: int) -> list[int]:
    return [*dict.fromkeys(round(k * (count - 1) / (TESTED_CELLS - 1)) for k in range(TESTED_CELLS))]


def _outside(
    matrices: Sequence[LuminanceMatrix], light: int, corners: slice, thresholds: LevelThresholds
) -> tuple[float, float]:
    """Of a light's cell, the area × weight of defects that shows more midway, and all of it.

    `matrices` are of the exposures of an image; the position midway follows the corners.
    """
    first, midway = matrices[0], corners.stop
    if first.visibility is None:
        best, at = (
            cell_levels(first.levels[light], [np.arange(corners.start, corners.stop)], thresholds)[0],
            first.levels[light][midway],
        )
        usable, before = ((one >= thresholds.shade) & (one < thresholds.saturation) for one in (at, best))
        return float(first.areas @ (usable & ~before)), float(first.areas.sum())
    shown, below = (
        np.bitwise_or.reduce([some for matrix in matrices for some in _words(matrix)[light][rows]], axis=0)
        for rows in (slice(midway, midway + 1), corners)
    )
    more = np.bitwise_or.reduce(shown & ~below, axis=0)
    weights = sum(defect.weight for defect in first.visibility.defects)
    return float(first.areas @ first.visibility.weights(more)), float(first.areas.sum() * weights)
