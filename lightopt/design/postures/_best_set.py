"""The best set of a given number of candidates, by branch and bound.

The benefit is submodular (:mod:`lightopt.design.postures._greedy_cover`): what a candidate adds to a set never exceeds
what it added to a part of that set. So no set that extends S by r of the remaining candidates has more benefit than
benefit(S) + the r largest gains left, and none covers more than a k-th of that. Sets are visited in descending order of
gain; a branch whose bound is no more than what the best known set covers is cut. At a limit of work the search ends
without a proof.
"""

import math
from collections.abc import Sequence

from lightopt.core.threads import available_processors
from lightopt.design.postures._counts import (
    Counts,
    PairWeights,
    add_counts,
    all_marginal_gains,
    covered_weight,
    sum_counts,
    zero_counts,
)

# of one search: words of flags that are read, 10,000 gains of 200,000 patches; some ten seconds of two processors
MOST_WORK = 2_000_000_000

BATCH = 16  # candidates whose gains are computed at once, whatever the number of threads


def best_set(
    candidates: Sequence[Counts],
    weights: PairWeights,
    chosen: Sequence[int],
    size: int,
    *,
    most_work: int = MOST_WORK,
    threads: int | None = None,
) -> tuple[tuple[int, ...], int, int | None]:
    """The set of `size` candidates that covers most.

    candidates: Counts of each, shape (k, p, words), all of one k.
    chosen: The best known set; it is kept where no other covers more.
    most_work: Words of flags to process before the search ends without a proof.
    Returns chosen, covered, sets: The best set that was found, the weight that it covers, and the number of all sets
        of that size; None where it is not proven that none covers more.
    """
    search = _Search(candidates, weights, chosen, most_work, threads or available_processors())
    try:
        search.visit(zero_counts(weights, search.k), (), 0, 0, list(range(len(candidates))), None, size)
    except _WorkLimitReached:
        return search.best, search.best_covered, None
    return search.best, search.best_covered, math.comb(len(candidates), size)


class _WorkLimitReached(Exception):  # noqa: N818  (ends the search, and no error)
    """The search ends without a proof."""


class _Search:
    def __init__(
        self, candidates: Sequence[Counts], weights: PairWeights, chosen: Sequence[int], most_work: int, threads: int
    ) -> None:
        self.candidates, self.weights, self.threads = candidates, weights, threads
        self.k = len(candidates[0])
        self.best = tuple(chosen)
        self.best_covered = covered_weight(sum_counts((candidates[i] for i in chosen), weights, self.k), weights)
        self._each = max(1, candidates[0].size)
        self._left = most_work

    def visit(
        self,
        now: Counts,
        some: tuple[int, ...],
        covered: int,
        benefit: int,
        rest: Sequence[int],
        most: Sequence[int] | None,
        more: int,
    ) -> None:
        """All sets of the candidates `some` and `more` of `rest`.

        `some` have the counts `now`, which cover `covered` and have the benefit `benefit`. `most` are upper bounds on
        what each of the rest adds to the benefit, descending; None where none are known.
        """
        if more == 1 and most is not None:
            for start in range(0, len(rest), BATCH):
                if self._cannot_improve(benefit + most[start]):
                    return
                batch = rest[start : start + BATCH]
                for i, (gain, _) in zip(batch, self._gains(now, batch), strict=True):
                    self._update_best((*some, i), covered + gain)
            return
        gains = self._gains(now, rest)
        order = sorted(range(len(rest)), key=lambda at: (-gains[at][1], rest[at]))
        rest = [rest[at] for at in order]
        covers, benefits = ([gains[at][which] for at in order] for which in (0, 1))
        for at in range(len(rest) - more + 1):
            if self._cannot_improve(benefit + sum(benefits[at : at + more])):
                return
            one = (*some, rest[at])
            if more == 1:
                self._update_best(one, covered + covers[at])
                continue
            self.visit(
                add_counts(now, self.candidates[rest[at]]),
                one,
                covered + covers[at],
                benefit + benefits[at],
                rest[at + 1 :],
                benefits[at + 1 :],
                more - 1,
            )

    def _cannot_improve(self, benefit: int) -> bool:
        # [count ≥ k] ≤ min(k, count) / k
        return benefit // self.k <= self.best_covered

    def _update_best(self, some: tuple[int, ...], value: int) -> None:
        if value > self.best_covered:
            self.best, self.best_covered = some, value

    def _gains(self, now: Counts, some: Sequence[int]) -> list[tuple[int, int]]:
        self._left -= self._each * len(some)
        if self._left < 0:
            raise _WorkLimitReached
        return all_marginal_gains(now, [self.candidates[i] for i in some], self.weights, threads=self.threads)
