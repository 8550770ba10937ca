"""The exact search: all combinations scored, or shown by a bound to be no better.

Combinations are taken in boxes, some candidates of every light. A box that is small enough is enumerated: the objective
scores all of it at once. A larger one is halved along the light with the most candidates, and the half that promises
more by the objective's bound is looked into first. A box whose bound is below the last combination of the ranking holds
none of those that are asked for, nor a tie of the best, and is left out. So the answer is the global optimum, unless
the search comes to its limit on how many combinations to score: then the largest bound of what is left is part of the
answer.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.optimize._matrix import LuminanceMatrix, Thresholds, usable_sums
from lightopt.optimize._objective import Objective
from lightopt.optimize._ranking import Ranked, Ranking, rank
from lightopt.optimize._space import Rows, Space, allowed_mask
from lightopt.rendering import available_processors

__all__ = ["DEFAULT_LIMIT", "Found", "search"]

Int64 = NDArray[np.int64]

TABLE_CELLS = 1 << 24
"""Most combinations that are enumerated at once: 128 MiB of scores."""

BOX_COST = 20_000
"""Combinations that take about as long to score as a box takes to halve; counts against the limit."""

DEFAULT_LIMIT = 200_000_000
"""Combinations that are scored unless asked otherwise, before the search stops with a bound."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a search found.

    Attributes
    ----------
    ranking
        The best combinations in order, the first being the optimum.
    ties
        Number of combinations with the optimum's score; a lower limit of it where the search was not finished.
    scored
        Combinations that were enumerated.
    excluded
        Combinations that a bound shows to be worse than all of the ranking.
    left
        Combinations not looked at, since the limit was reached.
    clashing
        Combinations whose panels would collide.
    bound
        A score that no allowed combination exceeds: that of the optimum where it is proven.
    """

    ranking: tuple[Ranked, ...]
    ties: int
    scored: int
    excluded: int
    left: int
    clashing: int
    bound: int

    @property
    def best(self) -> Ranked:
        """The best combination."""
        return self.ranking[0]

    @property
    def runner_up(self) -> Ranked | None:
        """The second best, which may have the same score; None where there is only one combination."""
        return self.ranking[1] if len(self.ranking) > 1 else None

    @property
    def gap(self) -> int | None:
        """How much the runner-up's score is below the best."""
        return None if self.runner_up is None else self.best.score - self.runner_up.score

    @property
    def proven(self) -> bool:
        """Whether no combination has a higher score."""
        return self.bound <= self.best.score


def search(
    matrices: Sequence[LuminanceMatrix],
    objective: Objective,
    thresholds: Thresholds,
    *,
    space: Space | None = None,
    keep: int = 100,
    limit: int = DEFAULT_LIMIT,
    table_cells: int = TABLE_CELLS,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Found:
    """Find the best combination of light positions.

    Parameters
    ----------
    matrices
        One, or one per posture where the lights stand the same for all: then the sum over the postures decides.
    objective
        What is scored.
    thresholds
        Which levels are usable.
    space
        Which combinations are allowed; all by default.
    keep
        How many of the best to return, at least 2.
    limit
        Most combinations to score.
    table_cells
        Most combinations to enumerate at once.
    threads
        All the machine's by default. The answer does not depend on it.
    progress
        Called with the share of combinations that is scored or excluded.

    Raises
    ------
    InputError
        No visible patch, an objective that says nothing of this number of lights, no allowed combination.
    """
    space = space or Space.of(matrices[0].shape)
    posed = _Posed(matrices, objective, thresholds, threads or available_processors())
    _check(posed, space)
    boxes = _Boxes(posed, space.groups, table_cells)
    total = boxes.cells
    keep = max(2, keep)
    ranking = Ranking()
    excluded = clashing = 0
    while boxes:
        if len(ranking.best) == keep and boxes.bound < ranking.best[-1].score:
            excluded += boxes.cells
            boxes.clear()
            break
        if ranking.best and ranking.count + BOX_COST * boxes.halved >= limit:
            break
        bound, rows = boxes.take()
        if len(ranking.best) == keep and bound < ranking.best[-1].score:
            excluded += _cells(rows)
            continue
        allowed = allowed_mask(space, rows)
        ranking = ranking.merged(
            rank(posed.scores(rows), rows, posed.usable, allowed=allowed, limit=keep), keep
        )
        clashing += 0 if allowed is None else int(allowed.size - np.count_nonzero(allowed))
        if progress is not None:
            progress((ranking.count + clashing) / total)
    if not ranking.best:
        raise InputError(
            "no combination of the lights' positions is left: in each, panels collide; widen their ranges or take "
            "smaller panels"
        )
    return Found(
        ranking=ranking.best,
        ties=ranking.ties,
        scored=ranking.count,
        excluded=excluded,
        left=boxes.cells,
        clashing=clashing,
        bound=ranking.best[0].score if not boxes.cells else max(ranking.best[0].score, boxes.bound),
    )


class _Boxes:
    """The boxes that are left, the one that promises most first."""

    def __init__(self, posed: _Posed, groups: Sequence[Rows], table_cells: int) -> None:
        self._posed = posed
        self._table_cells = table_cells
        self._serial = itertools.count()
        self._heap: list[tuple[int, int, Rows]] = []
        self.halved = 0
        self.cells = 0
        for rows in groups:
            # a single box that is enumerated anyway needs no bound
            self._push(rows, 0 if len(groups) == 1 and _cells(rows) <= table_cells else posed.bound(rows))

    def __bool__(self) -> bool:
        return bool(self._heap)

    @property
    def bound(self) -> int:
        """A score that nothing in the boxes exceeds."""
        return -self._heap[0][0]

    def take(self) -> tuple[int, Rows]:
        """Take out a box to enumerate, with its bound: of the most promising one the more promising half, and so on."""
        negative, _, rows = heapq.heappop(self._heap)
        bound = -negative
        self.cells -= _cells(rows)
        while _cells(rows) > self._table_cells:
            self.halved += 1
            # a half's bound is no looser than that of the whole
            low, high = ((min(bound, self._posed.bound(half)), half) for half in _halves(rows))
            (bound, rows), (worse, rest) = (low, high) if low[0] >= high[0] else (high, low)
            self._push(rest, worse)
        return bound, rows

    def clear(self) -> None:
        """Take all out."""
        self._heap.clear()
        self.cells = 0

    def _push(self, rows: Rows, bound: int) -> None:
        heapq.heappush(self._heap, (-bound, next(self._serial), rows))
        self.cells += _cells(rows)


class _Posed:
    """The matrices of the postures together, as the objective sees them."""

    def __init__(
        self, matrices: Sequence[LuminanceMatrix], objective: Objective, thresholds: Thresholds, threads: int
    ) -> None:
        self.matrices = matrices
        self.objective = objective
        self.thresholds = thresholds
        self.threads = threads
        self.weights = [objective.weights(matrix.areas) for matrix in matrices]
        self.usable = [
            sum(
                (
                    usable_sums(matrix.levels[light], weights, thresholds)
                    for matrix, weights in zip(matrices, self.weights, strict=True)
                ),
                start=np.zeros(size, np.int64),
            )
            for light, size in enumerate(matrices[0].shape)
        ]

    def scores(self, rows: Rows) -> Int64:
        """Scores of the combinations of `rows`, one axis per light."""
        total = np.zeros(tuple(len(row) for row in rows), np.int64)
        for matrix, weights in zip(self.matrices, self.weights, strict=True):
            total += self.objective.scores(matrix.rows(rows), weights, self.thresholds, threads=self.threads)
        return total

    def bound(self, rows: Rows) -> int:
        """A score that no combination of `rows` exceeds."""
        return sum(
            self.objective.bound(matrix.rows(rows), weights, self.thresholds)
            for matrix, weights in zip(self.matrices, self.weights, strict=True)
        )


def _check(posed: _Posed, space: Space) -> None:
    lights = len(space.sizes)
    if reason := posed.objective.refusal(lights):
        raise InputError(reason)
    for matrix in posed.matrices:
        if matrix.shape != space.sizes:
            raise InputError(
                f"search: expected candidates {space.sizes} in every posture, found {matrix.shape}"
            )
        if not len(matrix.areas):
            raise InputError(
                "no patch is visible to the camera, so that no position of the lights is better than another; check "
                "the part's placement and posture"
            )


def _cells(rows: Rows) -> int:
    return math.prod(len(row) for row in rows)


def _halves(rows: Rows) -> tuple[Rows, Rows]:
    widest = max(range(len(rows)), key=lambda i: len(rows[i]))
    middle = len(rows[widest]) // 2
    low, high = list(rows), list(rows)
    low[widest], high[widest] = rows[widest][:middle], rows[widest][middle:]
    return tuple(low), tuple(high)
