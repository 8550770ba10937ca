"""Combinations of candidate positions: which are allowed, and which are the best of a table, ties in a fixed order."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Int64

Rows = tuple[Int64, ...]  # candidates of each light, ascending: all their combinations are meant


@dataclass(frozen=True, kw_only=True)
class CombinationSpace:
    """The combinations to search."""

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
    """A combination with its score."""

    score: int
    usable: int  # sum of the usable levels of all images, each times its patch's weight
    candidates: tuple[int, ...]  # one per light, in the rig's order; candidates ascend by elevation, then azimuth

    @property
    def sort_key(self) -> tuple[int, int, tuple[int, ...]]:
        """Smaller comes first."""
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
        """The least score that is near the best."""
        return self._best - self._margin(self._best)

    @property
    def exact(self) -> bool:
        """Whether no score that is near was dropped."""
        return self._lost_below <= self.least

    @property
    def count(self) -> int:
        """Scores near the best, the best one among them."""
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
