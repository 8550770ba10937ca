"""The exact search: every combination is scored, or excluded by a bound.

Branch and bound: combinations are taken in boxes, some candidates of every light. A box that is small enough is
enumerated: the objective scores all of it at once. A larger one is halved along the light with the most candidates, and
the half with the larger bound is searched first. A box whose bound is below the last combination of the ranking holds
none of the requested combinations, nor a tie of the best, and is excluded. So the answer is the global optimum, unless
the search reaches its limit on scored combinations: then the largest bound of what is left is part of the answer.
"""

import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Int64
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, ignore, part_of
from lightopt.core.threads import available_processors
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix, area_units, usable_sums

Rows = tuple[Int64, ...]  # candidates of each light, ascending: all their combinations are meant


@dataclass(frozen=True, kw_only=True)
class CombinationSpace:
    sizes: tuple[int, ...]  # number of candidates per light
    groups: tuple[Rows, ...]  # disjoint sets that make up the space: one where lights move independently
    # for pairs of lights (i, j), i < j: which of their candidates collide, shape (sizes[i], sizes[j])
    clashes: Mapping[tuple[int, int], Bool] = field(default_factory=dict[tuple[int, int], Bool])

    @staticmethod
    def of(sizes: Sequence[int]) -> "CombinationSpace":
        return CombinationSpace(sizes=tuple(sizes), groups=(tuple(np.arange(n) for n in sizes),))


def is_allowed(space: CombinationSpace, combination: Sequence[int]) -> bool:
    """Whether one combination, a candidate of each light, belongs to the space."""
    if any(clash[combination[i], combination[j]] for (i, j), clash in space.clashes.items()):
        return False
    return any(all(k in row for k, row in zip(combination, rows, strict=True)) for rows in space.groups)


def allowed_mask(space: CombinationSpace, rows: Rows) -> Bool | None:
    """Which combinations of `rows` have no clash, the last light's varying fastest; None where all are allowed."""
    mask: Bool | None = None
    sizes = [len(r) for r in rows]
    for (i, j), clash in space.clashes.items():
        some = clash[np.ix_(rows[i], rows[j])]
        if some.any():
            if mask is None:
                mask = np.ones(math.prod(sizes), np.bool_)
            between, after = math.prod(sizes[i + 1 : j]), math.prod(sizes[j + 1 :])
            pairs = mask.reshape(-1, sizes[i], between, sizes[j], after)
            pairs &= ~some[:, None, :, None]
    return mask


MOST_NEAR = 1 << 24  # scores near the best that are held at a time: 128 MiB


@dataclass(frozen=True)
class Ranked:
    score: int
    usable: int  # sum of the usable levels of all images, each times its patch's weight
    candidates: tuple[int, ...]  # one per light, in the rig's order; candidates ascend by elevation, then azimuth

    @property
    def sort_key(self) -> tuple[int, int, tuple[int, ...]]:
        return -self.score, -self.usable, self.candidates


@dataclass(frozen=True)
class Ranking:
    """The first of some combinations, and how many share the best score."""

    best: tuple[Ranked, ...] = ()  # ordered; as many as were requested or there are
    ties: int = 0  # number of combinations with the best score
    count: int = 0  # number of combinations evaluated

    def merged(self, other: "Ranking", limit: int) -> "Ranking":
        best = tuple(sorted((*self.best, *other.best), key=attrgetter("sort_key"))[:limit])
        score = best[0].score if best else 0
        ties = sum(r.ties for r in (self, other) if r.best and r.best[0].score == score)
        return Ranking(best, ties, self.count + other.count)


class NearBest:
    """Counts the scores near the best, table after table, while the best may still rise.

    margin: How far a score may be below a given best and still be near. Best less margin never falls as the best
        rises.
    most: Scores that are held at a time; of more, the lower half is dropped, and the count may be too low.
    """

    def __init__(self, margin: Callable[[int], int], *, most: int = MOST_NEAR) -> None:
        self._margin, self._most = margin, most
        self._held: list[Int64] = []
        self._best = self._lost_below = 0

    @property
    def least(self) -> int:
        return self._best - self._margin(self._best)

    @property
    def exact(self) -> bool:
        return self._lost_below <= self.least

    @property
    def count(self) -> int:
        return sum(int(np.count_nonzero(scores >= self.least)) for scores in self._held)

    def add(self, scores: Int64) -> None:
        """More scores, none below 0."""
        if not len(scores):
            return
        self._best = max(self._best, int(scores.max()))
        self._held.append(scores[scores >= self.least])
        if sum(map(len, self._held)) > self._most:
            held = np.concatenate(self._held)
            held = held[held >= self.least]
            if len(held) > self._most:
                held = np.partition(held, len(held) // 2)[len(held) // 2 :]
                self._lost_below = int(held.min()) + 1
            self._held = [held]


def rank(table: Int64, rows: Rows, usable: Sequence[Int64], *, allowed: Bool | None, limit: int) -> Ranking:
    """Rank by score, then by the sum of usable levels, then by lower candidates in the order of the lights.

    table: Scores, one per combination of `rows`, the last light's varying fastest.
    usable: Sum of usable levels of each candidate of each light, whatever the table's rows.
    allowed: Of the same combinations; None for all.
    """
    scores = table if allowed is None else table[allowed]
    if not len(scores):
        return Ranking()
    keep = min(limit, len(scores))
    least = int(np.partition(scores, len(scores) - keep)[len(scores) - keep])
    some = np.flatnonzero(table >= least if allowed is None else allowed & (table >= least))
    sums = sum(
        (own[row][i] for row, own, i in zip(rows, usable, digits(some, rows), strict=True)),
        start=np.zeros(len(some), np.int64),
    )
    # the sort is stable: of equals those with lower candidates stay first
    order = np.lexsort((-sums, -table[some]))[:keep]
    places = some[order]
    candidates = np.stack([row[i] for row, i in zip(rows, digits(places, rows), strict=True)], axis=1).tolist()
    facts = zip(table[places].tolist(), sums[order].tolist(), map(tuple, candidates), strict=True)
    best = tuple(Ranked(score, total, combination) for score, total, combination in facts)
    return Ranking(best, int(np.count_nonzero(scores == best[0].score)), len(scores))


def digits(places: Int64 | int, rows: Sequence[Int64]) -> Iterator[Any]:
    """Which of its rows each light has at places of a table."""
    # NumPy's own way is for a few dozen lights only
    stride = math.prod(len(row) for row in rows)
    for row in rows:
        stride //= len(row)
        yield places // stride % len(row)


TABLE_CELLS = 1 << 22  # most combinations that are enumerated at once: 32 MiB of scores
MOST_COMBINATIONS = 10**300  # larger spaces are refused: a light or two fewer would not help either
BOX_COST = 20_000  # combinations that take about as long to score as a box takes to halve; counts against the limit

# default number of combinations to score before the search stops with a bound; bounds count, too
DEFAULT_LIMIT = 200_000_000

NO_COMBINATION = "no combination of the lights' positions is left: in each, panels collide; widen their ranges"


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    ranking: tuple[Ranked, ...]  # the best in order, from the optimum on; of those evaluated where some are left
    ties: int  # number of other combinations with the optimum's score; of those evaluated where some are left
    near: int  # number of other combinations whose score is near the optimum's, ties among them
    near_exact: bool  # whether `near` is complete: none was left, excluded by a bound, or dropped for memory
    scored: int  # combinations that were enumerated
    excluded: int  # combinations that a bound shows to be worse than all of the ranking
    left: int  # combinations not evaluated, since the limit was reached
    clashing: int  # combinations whose panels would collide
    bound: int  # a score that no allowed combination exceeds: that of the optimum where it is proven

    @property
    def best(self) -> Ranked:
        return self.ranking[0]

    @property
    def runner_up(self) -> Ranked | None:
        """The second best, which may have the same score; None where there is only one combination."""
        return self.ranking[1] if len(self.ranking) > 1 else None

    @property
    def gap(self) -> int | None:
        """How far the runner-up's score is below the best; no more than this where combinations are left."""
        return None if self.runner_up is None else self.best.score - self.runner_up.score

    @property
    def proven(self) -> bool:
        """Whether no combination has a higher score; one that is left may have the same and win the tie."""
        return self.bound <= self.best.score

    @property
    def complete(self) -> bool:
        """Whether no combination is left: then ties, tie-break, runner-up and gap are those of the whole space."""
        return self.left == 0


def search(
    matrices: Sequence[LuminanceMatrix],
    objective: Objective,
    thresholds: LevelThresholds,
    *,
    space: CombinationSpace | None = None,
    keep: int = 100,
    limit: int = DEFAULT_LIMIT,
    table_cells: int = TABLE_CELLS,
    threads: int | None = None,
    progress: Share = ignore,
) -> SearchResult:
    """Find the best combination of light positions.

    matrices: One, or one per posture that share the lights: then the sum over the postures decides.
    space: Which combinations are allowed; all by default.
    keep: How many of the best to return, at least 2.
    limit: About how many combinations to score before the search stops with a bound; a box that is halved counts as
        :data:`BOX_COST` of them.
    table_cells: Most combinations to enumerate at once; no more than `limit`.
    progress: Called often with the share of combinations, or of the limit, that is done; an upper estimate of what is
        left. An exception that it raises ends the search soon.
    Raises InputError: No visible patch, an objective that is undefined for this number of lights, no allowed
        combination, too many combinations.
    """
    space = space or CombinationSpace.of(matrices[0].shape)
    scorer = _BoxScorer(matrices, objective, thresholds, threads or available_processors())
    _check(scorer, space)
    total = sum(map(_cells, space.groups))

    def report(more: float = 0.0) -> None:
        seen = ranking.count + clashing
        counted = seen + BOX_COST * boxes.halved
        progress(min(1.0, max((seen + excluded + more) / total, (counted + more) / limit)))

    keep = max(2, keep)
    ranking = Ranking()
    near = NearBest(lambda best: objective.near_margin(best, scorer.area))
    excluded = clashing = 0
    excluded_bound = -1
    boxes = _Boxes(scorer, space.groups, max(1, min(table_cells, limit)))
    while boxes:
        if len(ranking.best) == keep and boxes.bound < ranking.best[-1].score:
            excluded += boxes.cells
            excluded_bound = max(excluded_bound, boxes.bound)
            boxes.clear()
            break
        if ranking.best and ranking.count + clashing + BOX_COST * boxes.halved >= limit:
            break
        bound, rows = boxes.take(report)
        if len(ranking.best) == keep and bound < ranking.best[-1].score:
            excluded += _cells(rows)
            excluded_bound = max(excluded_bound, bound)
            continue
        cells = _cells(rows)
        scores = scorer.scores(rows, lambda share, cells=cells: report(share * cells))
        allowed = allowed_mask(space, rows)
        near.add(scores if allowed is None else scores[allowed])
        ranking = ranking.merged(rank(scores, rows, scorer.usable, allowed=allowed, limit=keep), keep)
        clashing += 0 if allowed is None else int(allowed.size - np.count_nonzero(allowed))
        report()
    if not ranking.best:
        raise InputError(NO_COMBINATION)
    return SearchResult(
        ranking=ranking.best,
        ties=ranking.ties - 1,
        near=near.count - 1,
        near_exact=near.exact and excluded_bound < near.least and not boxes.cells,
        scored=ranking.count,
        excluded=excluded,
        left=boxes.cells,
        clashing=clashing,
        bound=ranking.best[0].score if not boxes.cells else max(ranking.best[0].score, boxes.bound),
    )


class _Boxes:
    """The boxes that are left, ordered by bound."""

    def __init__(self, scorer: "_BoxScorer", groups: Sequence[Rows], table_cells: int) -> None:
        self._scorer, self._table_cells, self._serial = scorer, table_cells, itertools.count()
        self._heap: list[tuple[int, int, Rows]] = []
        self.halved = self.cells = 0
        for rows in groups:
            # a single box that is enumerated anyway needs no bound
            self._push(rows, 0 if len(groups) == 1 and _cells(rows) <= table_cells else scorer.bound(rows))

    def __bool__(self) -> bool:
        return bool(self._heap)

    @property
    def bound(self) -> int:
        return -self._heap[0][0]

    def take(self, report: Callable[[], None]) -> tuple[int, Rows]:
        """Take out a box to enumerate, with its bound: the box with the largest bound, halved until it is small enough.

        `report` is called whenever a box was halved.
        """
        negative, _, rows = heapq.heappop(self._heap)
        bound = -negative
        self.cells -= _cells(rows)
        while _cells(rows) > self._table_cells:
            self.halved += 1
            # a half's bound is no looser than that of the whole
            low, high = ((min(bound, self._scorer.bound(half)), half) for half in _halves(rows))
            (bound, rows), (worse, rest) = (low, high) if low[0] >= high[0] else (high, low)
            self._push(rest, worse)
            report()
        return bound, rows

    def clear(self) -> None:
        self._heap.clear()
        self.cells = 0

    def _push(self, rows: Rows, bound: int) -> None:
        heapq.heappush(self._heap, (-bound, next(self._serial), rows))
        self.cells += _cells(rows)


@dataclass(eq=False)
class _BoxScorer:
    """The matrices of the postures together, as the objective sees them."""

    matrices: Sequence[LuminanceMatrix]
    objective: Objective
    thresholds: LevelThresholds
    threads: int

    def __post_init__(self) -> None:
        self.weights = [self.objective.weights(matrix.areas) for matrix in self.matrices]
        self.area = sum(int(area_units(matrix.areas).sum()) for matrix in self.matrices)
        layers = zip(*(matrix.levels for matrix in self.matrices), strict=True)
        self.usable = [
            np.sum([usable_sums(*own, self.thresholds) for own in zip(of_light, self.weights, strict=True)], axis=0)
            for of_light in layers
        ]

    def scores(self, rows: Rows, progress: Share) -> Int64:
        """Scores of the combinations of `rows`, the last light's varying fastest."""
        total = np.zeros(_cells(rows), np.int64)
        patches = [len(weights) for weights in self.weights]
        for i, (matrix, weights) in enumerate(zip(self.matrices, self.weights, strict=True)):
            done = [sum(patches[:k]) / sum(patches) for k in (i, i + 1)]
            part = part_of(progress, done[0], done[1])
            total += self.objective.scores(matrix.rows(rows), weights, self.thresholds, self.threads, part)
        return total

    def bound(self, rows: Rows) -> int:
        return sum(
            self.objective.bound(matrix.rows(rows), weights, self.thresholds)
            for matrix, weights in zip(self.matrices, self.weights, strict=True)
        )


def _check(scorer: _BoxScorer, space: CombinationSpace) -> None:
    lights = len(space.sizes)
    if reason := scorer.objective.refusal(lights):
        raise InputError(reason)
    if sum(map(_cells, space.groups)) > MOST_COMBINATIONS:
        number = f"{lights} lights of up to {max(space.sizes):,} positions make more than 10^300 combinations"
        raise InputError(f"search: {number}; raise option 'step_deg', or give a range to fewer lights")
    for matrix in scorer.matrices:
        if not len(matrix.areas):
            raise InputError("no patch is inspectable; check the part's placement and posture")


def _cells(rows: Rows) -> int:
    return math.prod(len(row) for row in rows)


def _halves(rows: Rows) -> tuple[Rows, Rows]:
    widest = max(range(len(rows)), key=lambda i: len(rows[i]))
    middle = len(rows[widest]) // 2
    low, high = list(rows), list(rows)
    low[widest], high[widest] = (rows[widest][:middle], rows[widest][middle:])
    return tuple(low), tuple(high)
