"""What light positions between the candidates can score at most.

Lights move continuously, candidates are steps. Between neighbouring candidates, in a cell of their grid, the level of a
patch and the evidence of a defect are taken to lie between those of the cell's corners. Then each cell is given, patch
by patch, the best that its corners allow, and the same exact search over combinations of cells gives a score that no
positions within the ranges exceed. For levels the best is

- the greatest, where all corners are below saturation or all are saturated;
- the greatest usable level, where some are saturated and others are not;

which no objective scores lower than any level between. For evidence it is the most units of any corner.

A highlight that is narrower than a step may pass between two candidates, and every level has its maximum somewhere. So
some cells are also evaluated at places inside: those of the best combination of cells, those around the best
candidates, and others. What these places add to the score of a combination of cells, at most, is added to the bound.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.config import RigConfig
from lightopt.core.arrays import Int64
from lightopt.core.errors import LightoptError, percent
from lightopt.core.run_context import Share, ignore
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates, panels_of
from lightopt.design._cells import Cells, places_inside
from lightopt.design._problem import OptimizeOptions
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._image_evaluator import MOST_BYTES, ImageEvaluator, drawn_patches
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds, LuminanceMatrix
from lightopt.design.responses._pairs import Words
from lightopt.design.search._exact_search import search
from lightopt.lights import PanelLight

FURTHER_TESTS = 2  # combinations of cells that are tested beside the best one and that around the best candidates
TESTED_SHARE, LEAST_TESTED, MOST_TESTED = 0.1, 200, 4_000  # share and numbers of patches that represent the others
MOST_EXCESS = 0.01  # of the full score, that places inside cells may add; more causes a warning

BETWEEN_MEANING = (
    "between the candidates: levels, and the evidence of defects, are taken to lie between those of neighbouring "
    "candidates; what some places between them show beyond that is added to the bound"
)
"""What a score of positions between the candidates is."""


@dataclass(frozen=True, kw_only=True)
class BetweenSteps:
    bound: int  # score that positions within the ranges are expected not to exceed
    excess: float  # what places inside cells add to it, as a share of the full score, or of the bound

    @classmethod
    def of(
        cls, bound: int, excess: float, *, full: int | None, best: int, postures: Sequence[Posture]
    ) -> "BetweenSteps":
        """From a bound by the corners, and what places inside add as a share of a full score, or of the bound.

        Raises LightoptError: The best candidates, which are corners, exceed the bound: an error of the program.
        """
        if bound < best:
            where = ", ".join(map(str, postures))
            raise LightoptError(f"internal error: {where}: bound {bound:,} of all positions below the best, {best:,}")
        whole = bound if full is None else full
        raised = bound + math.ceil(excess * whole)
        return cls(bound=raised if full is None else min(full, raised), excess=excess)

    def warnings(self, postures: Sequence[Posture]) -> tuple[str, ...]:
        """That steps are too large for a bound; none where they are not."""
        if self.excess <= MOST_EXCESS:
            return ()
        text = (
            f"{', '.join(map(str, postures))}: between candidate positions up to {percent(self.excess, 0)} of the "
            "score was found that none of them shows: the bound for positions between them is uncertain. Lower option "
            "'step_deg', or distance_step_mm of the light"
        )
        return (text,)


@dataclass(frozen=True)
class CellBound:
    score: int  # that no combination of cells exceeds
    cells: tuple[int, ...]  # of each light, in the best combination


def cell_levels(
    layer: Levels, corners: Sequence[Int64], thresholds: LevelThresholds, beyond: Levels | None = None
) -> Levels:
    """The best levels that the corners of each cell allow, shape (cells, p).

    layer: Those of the candidates, shape (candidates, p).
    beyond: Those of corners that are excluded as positions, which follow the candidates.
    """
    best = np.empty((len(corners), layer.shape[1]), layer.dtype)
    usable = min(thresholds.saturation - 1, int(np.iinfo(layer.dtype).max))
    for row, some in zip(best, corners, strict=True):
        own = corner_rows(layer, beyond, some)
        least, greatest = own.min(axis=0), own.max(axis=0)
        row[:] = np.where(least <= usable, np.minimum(greatest, usable), greatest)
    return best


def corner_rows(layer: NDArray[Any], beyond: NDArray[Any] | None, corners: Int64) -> NDArray[Any]:
    """The rows of some corners: of candidates, and of what is beyond them."""
    count = len(layer)
    if beyond is None or corners[-1] < count:
        return layer[corners]
    return np.concatenate([layer[corners[corners < count]], beyond[corners[corners >= count] - count]])


def cell_flags(flags: Words, corners: Int64, beyond: Words | None = None) -> Words:
    """The most units of evidence of the corners of a cell, shape (units, p, words); `flags` has all candidates'."""
    return np.bitwise_or.reduce(corner_rows(flags, beyond, corners), axis=0)


def cell_matrix(
    matrix: LuminanceMatrix,
    corners: Sequence[Sequence[Int64]],
    thresholds: LevelThresholds,
    beyond: LuminanceMatrix | None = None,
) -> LuminanceMatrix:
    """The luminance matrix of cells instead of candidates; `corners` of each light's cells, as in :class:`Cells`."""
    lights = range(len(corners))
    levels = [
        cell_levels(matrix.levels[i], corners[i], thresholds, None if beyond is None else beyond.levels[i])
        for i in lights
    ]
    seen = matrix.visibility
    if seen is not None:
        more = [None if beyond is None else _words(beyond)[i] for i in lights]
        words = (np.array([cell_flags(seen.words[i], some, more[i]) for some in corners[i]]) for i in lights)
        seen = replace(seen, words=tuple(words))
    return replace(matrix, levels=tuple(levels), visibility=seen)


def bound_between(
    matrices: Sequence[LuminanceMatrix],
    beyond: Sequence[LuminanceMatrix],
    objective: Objective,
    thresholds: LevelThresholds,
    cells: Cells,
    *,
    limit: int,
    threads: int | None = None,
    progress: Share = ignore,
) -> CellBound | None:
    """What no combination of cells exceeds; None where memory does not suffice, or the search reaches its limit.

    matrices: Of the candidates, as for :func:`search`; also `limit`, `threads` and `progress` are as there.
    beyond: Of the corners that are excluded as positions.
    """
    layers = [layer for matrix in matrices for layer in (*matrix.levels, *_words(matrix))]
    if 2 * sum(layer.nbytes for layer in layers) > MOST_BYTES:
        return None
    corners = [own.corners for own in cells.of_lights]
    best = [cell_matrix(own, corners, thresholds, more) for own, more in zip(matrices, beyond, strict=True)]
    space = cells.space
    found = search(best, objective, thresholds, space=space, keep=2, limit=limit, threads=threads, progress=progress)
    return CellBound(found.bound, found.best.candidates) if found.complete else None


def _words(matrix: LuminanceMatrix) -> tuple[Words, ...]:
    return () if matrix.visibility is None else matrix.visibility.words


def tested_patches(evaluator: ImageEvaluator, postures: int) -> ImageEvaluator:
    """The evaluator of patches that represent the others where cells are tested."""
    few = max(LEAST_TESTED, min(MOST_TESTED // postures, round(TESTED_SHARE * len(evaluator.patches))))
    return replace(evaluator, table=drawn_patches(evaluator.table, few), images=None, pool=None)


@dataclass(frozen=True, eq=False)
class ProbedCells:
    """Combinations of cells that are evaluated inside, too."""

    panels: tuple[tuple[PanelLight, ...], ...]  # of each light: of each combination the corners, then places inside
    corners: tuple[tuple[Int64, ...], ...]  # of each light and combination, indices of these corners
    inside: tuple[tuple[Int64, ...], ...]  # and of these places

    @classmethod
    def around(
        cls,
        rig: RigConfig,
        candidates: Candidates,
        options: OptimizeOptions,
        best: Sequence[int] | None,
        found: Sequence[int],
    ) -> "ProbedCells":
        """The best combination of cells, cells around the best candidates, and others, evenly spread."""
        lights = candidates.cells.of_lights
        panels: list[tuple[PanelLight, ...]] = []
        corners: list[tuple[Int64, ...]] = []
        inside: list[tuple[Int64, ...]] = []
        for light, own in enumerate(lights):
            here = found[light] if best is None else next(k for k, c in enumerate(own.corners) if best[light] in c)
            spread = (round((k + 1) * (len(own.cells) - 1) / (FURTHER_TESTS + 1)) for k in range(FURTHER_TESTS))
            tested = [found[light], here, *spread]
            there, mine = (*candidates.panels[light], *own.beyond), list[PanelLight]()
            rows: dict[int, tuple[Int64, Int64]] = {}
            for k in dict.fromkeys(tested):
                ends = [len(mine)]
                mine += [there[c] for c in own.corners[k]]
                ends.append(len(mine))
                if own.moves:
                    mine += panels_of(rig, light, places_inside(own.cells[k]), options.points)
                ends.append(len(mine))
                rows[k] = np.arange(ends[0], ends[1]), np.arange(ends[1], ends[2])
            panels.append(tuple(mine))
            corners.append(tuple(rows[k][0] for k in tested))
            inside.append(tuple(rows[k][1] for k in tested))
        return cls(tuple(panels), tuple(corners), tuple(inside))

    def excess(self, score: Callable[[Sequence[Int64]], float]) -> float:
        """What places inside add to the score of one of the combinations, at most.

        score: Of the best of some rows of each light's panels.
        """
        pairs = zip(zip(*self.corners, strict=True), zip(*self.inside, strict=True), strict=True)
        return max(
            0.0, *(score([np.append(*own) for own in zip(*pair, strict=True)]) - score(pair[0]) for pair in pairs)
        )


def excess_of_levels(
    tested: ProbedCells, matrices: Sequence[LuminanceMatrix], objective: Objective, thresholds: LevelThresholds
) -> float:
    """What places inside tested cells add to an objective's score, as a share of the full score, or of the score.

    matrices: Of the tested panels, one of each posture.
    """
    areas = np.concatenate([matrix.areas for matrix in matrices])
    whole = objective.full_score(int(objective.weights(areas).sum()))

    def score(rows: Sequence[Int64]) -> float:
        best = (cell_matrix(matrix, [[own] for own in rows], thresholds) for matrix in matrices)
        return float(sum(objective.score(one, objective.weights(one.areas), thresholds) for one in best))

    if whole is None:
        whole = max(1.0, *(score(rows) for rows in zip(*tested.corners, strict=True)))
    return tested.excess(score) / max(1.0, whole)
