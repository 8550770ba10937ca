"""The best of all sets of so many candidates, by branch and bound.

Worth is submodular (:mod:`lightopt.design.postures._greedy_cover`): what a candidate adds to a set never exceeds what
it added to a part of that set. So no set that goes on from S with r more candidates of those left is worth more than
worth(S) + the r largest gains left, and none reaches more than a k-th of that. Sets are visited from the most
promising on; a branch whose bound is no more than what the best known set reaches is left out. At a limit of work the
search ends without a proof.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lightopt.core.threads import available_processors, run_all
from lightopt.design.postures._counts import (
    Counts,
    PairWeights,
    added,
    gains_of,
    no_counts,
    reached,
    together,
)

MOST_WORK = 2_000_000_000
"""Of one search: words of flags that are looked at, 10,000 gains of 200,000 patches; some ten seconds of two
processors."""

BATCH = 16
"""Candidates whose gains are worked out at once, whatever the number of threads."""


def best_set(
    candidates: Sequence[Counts],
    weights: PairWeights,
    chosen: Sequence[int],
    size: int,
    *,
    most_work: int = MOST_WORK,
    threads: int | None = None,
) -> tuple[tuple[int, ...], int, int | None]:
    """The set of so many candidates that reaches most, and how many sets that is proven of.

    Parameters
    ----------
    candidates
        Counts of each, shape (k, p, words), all of one k.
    weights
        Of the pairs.
    chosen
        The best set that is known; it is kept where no other reaches more.
    size
        Of the sets, at most the number of candidates.
    most_work
        Words of flags to look at before the search ends without a proof.
    threads
        All the machine's by default; the answer does not depend on it.

    Returns
    -------
    chosen, most_reached, sets
        The best set that was found, the weight that it reaches, and the number of all sets of that size; None where it
        is not proven that none reaches more.
    """
    search = _Search(candidates, weights, chosen, most_work, threads or available_processors())
    try:
        search.visit(no_counts(weights, search.k), (), 0, 0, list(range(len(candidates))), None, size)
    except _TooMuch:
        return search.best, search.best_reached, None
    return search.best, search.best_reached, math.comb(len(candidates), size)


class _TooMuch(Exception):  # noqa: N818  (ends the search, and no error)
    """The limit of work is reached."""


class _Search:
    def __init__(
        self,
        candidates: Sequence[Counts],
        weights: PairWeights,
        chosen: Sequence[int],
        most_work: int,
        threads: int,
    ) -> None:
        self.candidates, self.weights, self.threads = candidates, weights, threads
        self.k = len(candidates[0])
        self.best = tuple(chosen)
        self.best_reached = reached(together((candidates[i] for i in chosen), weights, self.k), weights)
        self._each = max(1, candidates[0].size)
        self._left = most_work

    def visit(
        self,
        now: Counts,
        some: tuple[int, ...],
        top: int,
        whole: int,
        rest: Sequence[int],
        most: Sequence[int] | None,
        more: int,
    ) -> None:
        """All sets of the candidates `some`, seen by counts `now` of so much reached and worth, and `more` of `rest`.

        `most` is how much each of the rest adds to the worth at most, descending; None where nothing is known.
        """
        if more == 1 and most is not None:
            for start in range(0, len(rest), BATCH):
                if self._hopeless(whole + most[start]):
                    return
                batch = rest[start : start + BATCH]
                for i, (gain, _) in zip(batch, self._gains(now, batch), strict=True):
                    self._better((*some, i), top + gain)
            return
        gains = self._gains(now, rest)
        order = sorted(range(len(rest)), key=lambda at: (-gains[at][1], rest[at]))
        rest = [rest[at] for at in order]
        tops, wholes = ([gains[at][which] for at in order] for which in (0, 1))
        for at in range(len(rest) - more + 1):
            if self._hopeless(whole + sum(wholes[at : at + more])):
                return
            one = (*some, rest[at])
            if more == 1:
                self._better(one, top + tops[at])
                continue
            self.visit(
                added(now, self.candidates[rest[at]]),
                one,
                top + tops[at],
                whole + wholes[at],
                rest[at + 1 :],
                wholes[at + 1 :],
                more - 1,
            )

    def _hopeless(self, worth: int) -> bool:
        # [count ≥ k] ≤ min(k, count) / k
        return worth // self.k <= self.best_reached

    def _better(self, some: tuple[int, ...], value: int) -> None:
        if value > self.best_reached:
            self.best, self.best_reached = some, value

    def _gains(self, now: Counts, some: Sequence[int]) -> list[tuple[int, int]]:
        self._left -= self._each * len(some)
        if self._left < 0:
            raise _TooMuch
        found: list[tuple[int, int]] = [(0, 0)] * len(some)

        def add(at: int) -> None:
            found[at] = gains_of(now, self.candidates[some[at]], self.weights)

        run_all(((add, (at,)) for at in range(len(some))), threads=self.threads)
        return found
