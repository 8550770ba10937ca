"""Search for the few of many candidates that cover most, with bounds on the optimum.

Each candidate (a posture, or a posture at a further exposure) shows each pair in some number of images. The benefit of
a set S is Σ weight · min(k, Σ counts of its members): monotone and submodular, what one more candidate adds never grows
with the set. So, after any steps of the greedy choice with set S' and remaining gains g, no N candidates have more
benefit than benefit(S') + the sum of the N largest g; and N greedy steps reach at least the share 1 − (1 − 1/N)^N >
1 − 1/e of the best (Nemhauser, Wolsey, Fisher 1978, doi:10.1007/BF01588971). The least of the first is used; it is
never looser than the second.

:func:`best_set` finds the best set of a number of candidates by branch and bound: no set that extends S by r of the
remaining candidates has more benefit than benefit(S) + the r largest gains left, and none covers more than a k-th of
that. Sets are visited in descending order of gain; a branch whose bound is no more than what the best known set covers
is cut. At a limit of work the search ends without a proof.
"""

import heapq
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

from lightopt.design.responses._pairs import Counts, Merit, PairWeights, add_counts

# of one search: words of flags that are read, 10,000 gains of 200,000 patches; a few seconds of two processors
MOST_WORK = 2_000_000_000

BATCH = 16  # candidates whose gains are computed at once, whatever the number of threads


@dataclass(frozen=True, kw_only=True)
class CoverStep:
    candidate: int
    gain: int  # what it adds to the benefit of those before it
    benefit: int  # of those before it and itself: Σ weight · min(k, units)
    covered: int  # weight of the pairs of k units or more, which count as found


@dataclass(frozen=True, kw_only=True)
class Cover:
    steps: tuple[CoverStep, ...]  # the chosen ones, in the order in which they were chosen
    k: int  # units of evidence that a pair needs
    total: int  # weight of all pairs
    bounds: tuple[int, ...]  # on the benefit of sets of 0, 1, 2, … candidates up to as many as were chosen
    all_benefit: int  # of all candidates together
    all_covered: int  # likewise
    target: float | None = None  # share of the weight that was to be seen; None without
    sets: int | None = None  # number of all sets of as many candidates; None where not all were searched
    max_covered: int | None = None  # what the best of these sets covers; None likewise

    @property
    def chosen(self) -> tuple[int, ...]:
        return tuple(step.candidate for step in self.steps)

    @property
    def benefit(self) -> int:
        return self.steps[-1].benefit if self.steps else 0

    @property
    def covered(self) -> int:
        return self.steps[-1].covered if self.steps else 0

    @property
    def share(self) -> float:
        return self.covered / max(1, self.total)

    @property
    def bound_share(self) -> float:
        """No set of as many candidates finds more than this share."""
        if self.max_covered is not None:
            return self.max_covered / max(1, self.total)
        return self.bound_of(len(self.bounds) - 1)

    def bound_of(self, count: int) -> float:
        """No set of `count` candidates, up to as many as were chosen, finds more than this share."""
        # [units ≥ k] ≤ min(k, units) / k
        return min(self.bounds[count] / self.k, self.all_covered) / max(1, self.total)

    @property
    def min_size(self) -> int | None:
        """No set of fewer candidates reaches the target; None without one, or where all together do not reach it."""
        if self.target is None or self.all_covered < self.target * self.total:
            return None
        # a pair that is found has benefit k
        enough = [size for size, bound in enumerate(self.bounds) if bound >= self.k * self.target * self.total]
        return enough[0] if enough else len(self.steps)

    @property
    def guarantee(self) -> float:
        """Share of the best set of as many that these cover at least."""
        return self.share / self.bound_share if self.bound_share > 0.0 else 1.0

    @property
    def proven(self) -> bool:
        most = min(self.bounds[-1] // self.k, self.all_covered) if self.max_covered is None else self.max_covered
        return self.covered >= most


def greedy_cover(
    candidates: Sequence[Counts],  # of each, shape (k, p, words), all of one k; at least one
    weights: PairWeights,
    *,
    count: int | None = None,  # most candidates to choose, at least 1; as many as are needed by default
    target: float | None = None,  # share of all pairs to be seen in k images or more, above 0 and up to 1
    among: Sequence[int] | None = None,  # only these may be chosen; the bound is that of all
    threads: int | None = None,
) -> Cover:
    """Choose candidates one after the other, each time the one that adds most; the earlier one where two add the same.

    Stops after `count`, when the share `target` of the weight is seen in k images, or when nothing adds anything.
    Candidates that later ones make redundant are dropped, and the choice continues as far as it may.
    """
    allowed = range(len(candidates)) if among is None else sorted(among)
    goal = math.inf if target is None else target * weights.total
    greedy = _Greedy(candidates, weights, allowed, count or len(candidates), goal, threads)
    greedy.choose()
    everything = greedy.together(range(len(candidates)))
    all_benefit = weights.benefit(everything)
    return Cover(
        steps=cover_steps([(i, candidates[i]) for i in greedy.chosen], weights),
        k=greedy.k,
        total=weights.total,
        bounds=tuple(min(all_benefit, greedy.bound(size)) for size in range(len(greedy.chosen) + 1)),
        all_benefit=all_benefit,
        all_covered=weights.covered(everything),
        target=target,
    )


def greedy_order(candidates: Mapping[int, Counts], weights: PairWeights, k: int) -> tuple[int, ...]:
    """All of some candidates, each time the one that adds most to those before it; the first of equals."""
    left, now = dict(candidates), weights.zero_counts(k)
    ordered: list[int] = []
    while left:
        best = max(left, key=lambda i, now=now: weights.gains(now, left[i])[1])
        now = add_counts(now, left.pop(best))
        ordered.append(best)
    return tuple(ordered)


def cover_steps(ordered: Sequence[tuple[int, Counts]], weights: PairWeights) -> tuple[CoverStep, ...]:
    """What candidates add one after the other: index and counts of each."""
    sums = accumulate((counts for _, counts in ordered), add_counts)
    merits = [(0, 0), *map(weights.merit, sums)]
    return tuple(
        CoverStep(candidate=one, gain=benefit - before, benefit=benefit, covered=covered)
        for (one, _), (_, before), (covered, benefit) in zip(ordered, merits, merits[1:], strict=False)
    )


@dataclass(eq=False)
class _Greedy:
    candidates: Sequence[Counts]
    weights: PairWeights
    allowed: Sequence[int]
    most: int
    goal: float
    threads: int | None
    chosen: list[int] = field(default_factory=list[int])
    # benefit before a step and the gains then left, largest first: from these bounds are computed
    states: list[tuple[int, list[int]]] = field(default_factory=list[tuple[int, list[int]]])

    @property
    def k(self) -> int:
        return len(self.candidates[0])

    def choose(self) -> None:
        self._add_most()
        while (redundant := self._redundant()) is not None:
            self.chosen.remove(redundant)
            self._add_most()

    def _add_most(self) -> None:
        now = self.together(self.chosen)
        while True:
            merits = self.weights.all_gains(now, self.candidates, range(len(self.candidates)), threads=self.threads)
            gains = [0 if i in self.chosen else benefit for i, (_, benefit) in enumerate(merits)]
            self.states.append((self.weights.benefit(now), sorted(gains, reverse=True)))
            best = max(self.allowed, key=lambda i: gains[i], default=None)
            met = self.weights.covered(now) >= self.goal
            if met or len(self.chosen) >= self.most or best is None or gains[best] == 0:
                return
            self.chosen.append(best)
            now = add_counts(now, self.candidates[best])

    def _redundant(self) -> int | None:
        # the one whose loss costs least, the latest of those: nothing at all, or what the target can spare
        whole = self.weights.benefit(self.together(self.chosen))
        spare: list[tuple[int, int, int]] = []
        for place, one in enumerate(self.chosen):
            rest = self.together([other for other in self.chosen if other != one])
            loss = whole - self.weights.benefit(rest)
            if loss == 0 or self.weights.covered(rest) >= self.goal:
                spare.append((loss, -place, one))
        return min(spare)[2] if spare else None

    def together(self, some: Sequence[int]) -> Counts:
        return self.weights.sum_counts((self.candidates[one] for one in some), self.k)

    def bound(self, size: int) -> int:
        return min(here + sum(heapq.nlargest(size, gains)) for here, gains in self.states)


def improve_by_exchange(
    candidates: Sequence[Counts], weights: PairWeights, chosen: Sequence[int], *, threads: int | None = None
) -> tuple[int, ...]:
    """As many candidates that cover as much or more, and that no single exchange improves; no proof of the best.

    The best exchange is made first; of equals the one that replaces the earliest chosen by the first candidate.
    """
    now = list(chosen)
    if not now:
        return ()
    k = len(candidates[0])
    merit = weights.merit(weights.sum_counts((candidates[i] for i in now), k))
    while True:
        best: tuple[Merit, int, int] | None = None
        others = [i for i in range(len(candidates)) if i not in now]
        for place in range(len(now)):
            rest = weights.sum_counts((candidates[i] for i in [*now[:place], *now[place + 1 :]]), k)
            covered, benefit = weights.merit(rest)
            gains = weights.all_gains(rest, candidates, others, threads=threads)
            for i, gain in zip(others, gains, strict=True):
                other = covered + gain[0], benefit + gain[1]
                if other > (merit if best is None else best[0]):
                    best = other, place, i
        if best is None:
            return tuple(now)
        merit, place, i = best
        now[place] = i


def best_set(
    candidates: Sequence[Counts],  # of each, shape (k, p, words), all of one k
    weights: PairWeights,
    chosen: Sequence[int],  # the best known set; it is kept where no other covers more
    size: int,
    *,
    most_work: int = MOST_WORK,  # words of flags to process before the search ends without a proof
    threads: int | None = None,
) -> tuple[tuple[int, ...], int, int | None]:
    """The set of `size` candidates that covers most.

    Returns chosen, covered, sets: The best set that was found, the weight that it covers, and the number of all sets
        of that size; None where it is not proven that none covers more.
    """
    search = _Search(candidates, weights, tuple(chosen), most_work, threads)
    try:
        search.visit(weights.zero_counts(search.k), (), (0, 0), list(range(len(candidates))), None, size)
    except _WorkLimitReached:
        return search.best, search.best_covered, None
    return search.best, search.best_covered, math.comb(len(candidates), size)


class _WorkLimitReached(Exception):  # noqa: N818  (ends the search, and no error)
    """The search ends without a proof."""


@dataclass(eq=False)
class _Search:
    candidates: Sequence[Counts]
    weights: PairWeights
    best: tuple[int, ...]
    left: int
    threads: int | None

    def __post_init__(self) -> None:
        self.k = len(self.candidates[0])
        self.best_covered = self.weights.covered(
            self.weights.sum_counts((self.candidates[i] for i in self.best), self.k)
        )

    def visit(
        self, now: Counts, some: tuple[int, ...], own: Merit, rest: Sequence[int], most: Sequence[int] | None, more: int
    ) -> None:
        """All sets of the candidates `some` and `more` of `rest`.

        `some` have the counts `now` and the merit `own`. `most` are upper bounds on what each of the rest adds to the
        benefit, descending; None where none are known.
        """
        covered, benefit = own
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
            one, together = (*some, rest[at]), (covered + covers[at], benefit + benefits[at])
            if more == 1:
                self._update_best(one, together[0])
                continue
            after = add_counts(now, self.candidates[rest[at]])
            self.visit(after, one, together, rest[at + 1 :], benefits[at + 1 :], more - 1)

    def _cannot_improve(self, benefit: int) -> bool:
        # [count ≥ k] ≤ min(k, count) / k
        return benefit // self.k <= self.best_covered

    def _update_best(self, some: tuple[int, ...], value: int) -> None:
        if value > self.best_covered:
            self.best, self.best_covered = some, value

    def _gains(self, now: Counts, some: Sequence[int]) -> list[Merit]:
        self.left -= max(1, self.candidates[0].size) * len(some)
        if self.left < 0:
            raise _WorkLimitReached
        return self.weights.all_gains(now, self.candidates, some, threads=self.threads)
