"""Greedy cover with counts: which few of many candidates cover most, with a bound on the optimum.

Each candidate (a posture, or a posture at a further exposure) shows each pair in some number of images. The benefit of
a set S is Σ weight · min(k, Σ counts of its members): monotone and submodular, what one more candidate adds never grows
with the set. So, after any steps of the greedy choice with set S' and remaining gains g, no N candidates have more
benefit than benefit(S') + the sum of the N largest g; and N greedy steps reach at least the share 1 − (1 − 1/N)^N >
1 − 1/e of the best (Nemhauser, Wolsey, Fisher 1978, doi:10.1007/BF01588971). The least of the first is used; it is
never looser than the second.

A greedy choice is never revised. :func:`improve_by_exchange` then tries each chosen candidate against every other one
and makes the best exchange, until no single exchange covers more; the set is not proven to be the best of its size.
"""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import replace

from lightopt.core.errors import InputError
from lightopt.core.threads import available_processors
from lightopt.design.postures._choice import Cover, cover_steps
from lightopt.design.postures._counts import (
    Counts,
    PairWeights,
    add_counts,
    all_marginal_gains,
    covered_weight,
    marginal_benefit,
    sum_counts,
    total_benefit,
    zero_counts,
)


def greedy_cover(
    candidates: Sequence[Counts],
    weights: PairWeights,
    *,
    count: int | None = None,
    target: float | None = None,
    among: Sequence[int] | None = None,
) -> Cover:
    """Choose candidates one after the other, each time the one that adds most; the earlier one where two add the same.

    Stops after `count`, when the share `target` of the weight is seen in k images, or when nothing adds anything.
    Candidates that later ones make redundant are dropped, and the choice continues as far as it may.

    candidates: Counts of each, shape (k, p, words), all of one k.
    count: Most candidates to choose; as many as are needed by default.
    target: Share of all pairs to be seen in k images or more, above 0 and up to 1.
    among: Only these may be chosen; the bound is that of all.
    Raises InputError: No candidate, a count below 1, a target out of range.
    """
    if not candidates:
        raise InputError("cover: expected at least one candidate, found none")
    if count is not None and count < 1:
        raise InputError(f"cover: expected a count of 1 or more, found {count}")
    if target is not None and not 0.0 < target <= 1.0:
        raise InputError(f"cover: expected a target above 0 and up to 1, found {target:g}")
    return _Greedy(candidates, weights, count, target, among).cover()


def greedy_order(candidates: Mapping[int, Counts], weights: PairWeights) -> tuple[int, ...]:
    """All of some candidates, each time the one that adds most to those before it; the first of equals."""
    left = dict(candidates)
    ordered: list[int] = []
    now: Counts | None = None
    while left:
        before = zero_counts(weights, len(next(iter(left.values())))) if now is None else now
        best = max(left, key=lambda i, before=before: marginal_benefit(before, left[i], weights))
        now = add_counts(before, left.pop(best))
        ordered.append(best)
    return tuple(ordered)


class _Greedy:
    def __init__(
        self,
        candidates: Sequence[Counts],
        weights: PairWeights,
        count: int | None,
        target: float | None,
        among: Sequence[int] | None,
    ) -> None:
        self.candidates, self.weights = candidates, weights
        self.k = len(candidates[0])
        self.allowed = range(len(candidates)) if among is None else sorted(among)
        self.most = min(len(candidates), count or len(candidates))
        self.total = weights.total
        self.target = target
        self.goal = None if target is None else target * self.total
        self.chosen: list[int] = []
        self.dropped: list[int] = []
        # benefit before a step and the gains then left, largest first: from these bounds are computed
        self.seen: list[tuple[int, list[int]]] = []

    def cover(self) -> Cover:
        everything = self._together(range(len(self.candidates)))
        all_benefit, all_covered = (total_benefit(everything, self.weights), covered_weight(everything, self.weights))
        while True:
            self._choose()
            redundant = self._redundant()
            if redundant is None:
                break
            self.chosen.remove(redundant)
            self.dropped.append(redundant)
        cover = Cover(
            steps=cover_steps([(i, self.candidates[i]) for i in self.chosen], self.weights),
            dropped=tuple(one for one in self.dropped if one not in self.chosen),
            k=self.k,
            total=self.total,
            bounds=tuple(min(all_benefit, self._bound(size)) for size in range(len(self.chosen) + 1)),
            all_benefit=all_benefit,
            all_covered=all_covered,
            min_size=None,
        )
        return cover if self.target is None else replace(cover, min_size=cover.fewest(self.target))

    def _choose(self) -> None:
        now = self._together(self.chosen)
        while True:
            here = total_benefit(now, self.weights)
            gains = [
                0 if i in self.chosen else marginal_benefit(now, candidate, self.weights)
                for i, candidate in enumerate(self.candidates)
            ]
            self.seen.append((here, sorted(gains, reverse=True)))
            best = max(self.allowed, key=lambda i: gains[i], default=None)
            met = self.goal is not None and covered_weight(now, self.weights) >= self.goal
            if met or len(self.chosen) >= self.most or best is None or gains[best] == 0:
                return
            self.chosen.append(best)
            now = add_counts(now, self.candidates[best])

    def _redundant(self) -> int | None:
        # the one whose loss costs least, the latest of those: nothing at all, or what the target can spare
        whole = total_benefit(self._together(self.chosen), self.weights)
        spare: list[tuple[int, int, int]] = []
        for place, one in enumerate(self.chosen):
            rest = self._together([other for other in self.chosen if other != one])
            loss = whole - total_benefit(rest, self.weights)
            enough = self.goal is not None and covered_weight(rest, self.weights) >= self.goal
            if loss == 0 or enough:
                spare.append((loss, -place, one))
        return min(spare)[2] if spare else None

    def _together(self, some: Sequence[int]) -> Counts:
        return sum_counts((self.candidates[one] for one in some), self.weights, self.k)

    def _bound(self, size: int) -> int:
        return min(here + sum(heapq.nlargest(size, gains)) for here, gains in self.seen)


Merit = tuple[int, int]  # covered weight, benefit: see `lightopt.design.postures._counts`


def improve_by_exchange(
    candidates: Sequence[Counts], weights: PairWeights, chosen: Sequence[int], *, threads: int | None = None
) -> tuple[int, ...]:
    """As many candidates that cover as much or more, and that no single exchange improves.

    The best exchange is made first; of equals the one that replaces the earliest chosen by the first candidate.
    """
    now = list(chosen)
    if not now:
        return ()
    k = len(candidates[0])
    merit = _merit(sum_counts((candidates[i] for i in now), weights, k), weights)
    while True:
        best: tuple[Merit, int, int] | None = None
        others = [i for i in range(len(candidates)) if i not in now]
        for place in range(len(now)):
            rest = sum_counts((candidates[i] for i in [*now[:place], *now[place + 1 :]]), weights, k)
            covered, benefit = _merit(rest, weights)
            gains = all_marginal_gains(
                rest, [candidates[i] for i in others], weights, threads=threads or available_processors()
            )
            for i, gain in zip(others, gains, strict=True):
                other = covered + gain[0], benefit + gain[1]
                if other > (merit if best is None else best[0]):
                    best = other, place, i
        if best is None:
            return tuple(now)
        merit, place, i = best
        now[place] = i


def _merit(counts: Counts, weights: PairWeights) -> Merit:
    return covered_weight(counts, weights), total_benefit(counts, weights)
