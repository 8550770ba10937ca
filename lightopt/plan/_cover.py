"""Which few of many candidates see most: greedy cover with counts, and how far from the best it can be.

Each candidate (a posture, or a posture at a further exposure) sees each pair in some number of images. The worth of a
set S is Σ weight · min(k, Σ counts of its members): monotone and submodular, what one more candidate adds never grows
with the set. So, after any steps of the greedy choice with set S' and remaining gains g, no N candidates are worth more
than worth(S') + the sum of the N largest g; and N greedy steps reach at least the share 1 − (1 − 1/N)^N > 1 − 1/e of
the best (Nemhauser, Wolsey, Fisher 1978, doi:10.1007/BF01588971). The least of the first counts, and is never looser
than the second.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from lightopt.errors import InputError
from lightopt.plan._counts import Counts, PairWeights, added, gain_of, no_counts, reached, together, worth

__all__ = ["Cover", "Step", "greedy_cover", "greedy_order", "steps_of"]


@dataclass(frozen=True, kw_only=True)
class Step:
    """One candidate of a cover.

    Attributes
    ----------
    candidate
        Its index.
    gain
        What it adds to the worth of those before it.
    worth
        Of those before it and itself: Σ weight · min(k, count).
    reached
        Weight of the pairs that these see in k images or more.
    """

    candidate: int
    gain: int
    worth: int
    reached: int


@dataclass(frozen=True, kw_only=True)
class Cover:
    """A choice of candidates.

    Attributes
    ----------
    steps
        The chosen ones, in the order in which they were chosen.
    dropped
        Candidates that were chosen and proved redundant by later ones.
    k
        Images that a pair has to be seen in.
    total
        Weight of all pairs.
    bounds
        Of sets of 0, 1, 2, … candidates up to as many as were chosen: none is worth more.
    all_worth, all_reached
        Of all candidates together.
    least
        No set of fewer candidates reaches the target; None without a target, or where it cannot be reached.
    """

    steps: tuple[Step, ...]
    dropped: tuple[int, ...]
    k: int
    total: int
    bounds: tuple[int, ...]
    all_worth: int
    all_reached: int
    least: int | None

    @property
    def chosen(self) -> tuple[int, ...]:
        """Indices of the chosen candidates."""
        return tuple(step.candidate for step in self.steps)

    @property
    def worth(self) -> int:
        """Of the chosen ones together."""
        return self.steps[-1].worth if self.steps else 0

    @property
    def reached(self) -> int:
        """Weight of the pairs that the chosen ones see in k images or more."""
        return self.steps[-1].reached if self.steps else 0

    @property
    def share(self) -> float:
        """Of all pairs, by weight, those seen in k images or more."""
        return self.reached / max(1, self.total)

    @property
    def bound_share(self) -> float:
        """No set of as many candidates sees more than this share in k images or more."""
        return self.bound_of(len(self.bounds) - 1)

    def bound_of(self, count: int) -> float:
        """No set of so many candidates, up to as many as were chosen, sees more than this share in k or more."""
        # [count ≥ k] ≤ min(k, count) / k
        return min(self.bounds[count] / self.k, self.all_reached) / max(1, self.total)

    @property
    def bound(self) -> int:
        """No set of as many candidates is worth more."""
        return self.bounds[-1]

    def fewest(self, target: float) -> int | None:
        """No set of fewer candidates than that sees this share; None where all together do not."""
        if self.all_reached < target * self.total:
            return None
        # a pair seen in k images is worth k
        enough = [size for size, bound in enumerate(self.bounds) if bound >= self.k * target * self.total]
        return enough[0] if enough else len(self.steps)

    @property
    def guarantee(self) -> float:
        """Of what the best set of as many sees in k images or more, the share that these see at least."""
        # with k = 1 never less than a greedy choice has whatever the candidates, 1 − (1 − 1/N)^N
        return self.share / self.bound_share if self.bound_share > 0.0 else 1.0

    @property
    def proven(self) -> bool:
        """Whether no set of as many sees more in k images or more."""
        return self.reached >= min(self.bound // self.k, self.all_reached)


def greedy_cover(
    candidates: Sequence[Counts],
    weights: PairWeights,
    *,
    count: int | None = None,
    target: float | None = None,
    among: Sequence[int] | None = None,
) -> Cover:
    """Choose candidates one after the other, each time the one that adds most; the earlier one where two add the same.

    Stops after `count`, when the share `target` of the weight is seen in k images, or when nothing adds anything. Those
    that the later ones make redundant are dropped, and the choice goes on as far as it may.

    Parameters
    ----------
    candidates
        Counts of each, shape (k, p, words), all of one k.
    weights
        Of the pairs.
    count
        Most candidates to choose; as many as are needed by default.
    target
        Share of all pairs to be seen in k images or more, above 0 and up to 1.
    among
        Only these may be chosen; the bound is that of all.

    Raises
    ------
    InputError
        No candidate, a count below 1, a target out of range.
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
        before = no_counts(weights, len(next(iter(left.values())))) if now is None else now
        best = max(left, key=lambda i, before=before: gain_of(before, left[i], weights))
        now = added(before, left.pop(best))
        ordered.append(best)
    return tuple(ordered)


def steps_of(ordered: Sequence[tuple[int, Counts]], weights: PairWeights) -> tuple[Step, ...]:
    """What candidates add one after the other: index and counts of each."""
    steps: list[Step] = []
    now: Counts | None = None
    for one, counts in ordered:
        now = no_counts(weights, len(counts)) if now is None else now
        gain = gain_of(now, counts, weights)
        now = added(now, counts)
        steps.append(Step(candidate=one, gain=gain, worth=worth(now, weights), reached=reached(now, weights)))
    return tuple(steps)


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
        # worth before a step and the gains then left, largest first: what bounds are made of
        self.seen: list[tuple[int, list[int]]] = []

    def cover(self) -> Cover:
        everything = self._together(range(len(self.candidates)))
        all_worth, all_reached = worth(everything, self.weights), reached(everything, self.weights)
        while True:
            self._choose()
            redundant = self._redundant()
            if redundant is None:
                break
            self.chosen.remove(redundant)
            self.dropped.append(redundant)
        cover = Cover(
            steps=steps_of([(i, self.candidates[i]) for i in self.chosen], self.weights),
            dropped=tuple(one for one in self.dropped if one not in self.chosen),
            k=self.k,
            total=self.total,
            bounds=tuple(min(all_worth, self._bound(size)) for size in range(len(self.chosen) + 1)),
            all_worth=all_worth,
            all_reached=all_reached,
            least=None,
        )
        return cover if self.target is None else replace(cover, least=cover.fewest(self.target))

    def _choose(self) -> None:
        now = self._together(self.chosen)
        while True:
            here = worth(now, self.weights)
            gains = [
                0 if i in self.chosen else gain_of(now, candidate, self.weights)
                for i, candidate in enumerate(self.candidates)
            ]
            self.seen.append((here, sorted(gains, reverse=True)))
            best = max(self.allowed, key=lambda i: gains[i], default=None)
            met = self.goal is not None and reached(now, self.weights) >= self.goal
            if met or len(self.chosen) >= self.most or best is None or gains[best] == 0:
                return
            self.chosen.append(best)
            now = added(now, self.candidates[best])

    def _redundant(self) -> int | None:
        # the one whose loss costs least, the latest of those: nothing at all, or what the target can spare
        whole = worth(self._together(self.chosen), self.weights)
        spare: list[tuple[int, int, int]] = []
        for place, one in enumerate(self.chosen):
            rest = self._together([other for other in self.chosen if other != one])
            loss = whole - worth(rest, self.weights)
            enough = self.goal is not None and reached(rest, self.weights) >= self.goal
            if loss == 0 or enough:
                spare.append((loss, -place, one))
        return min(spare)[2] if spare else None

    def _together(self, some: Sequence[int]) -> Counts:
        return together((self.candidates[one] for one in some), self.weights, self.k)

    def _bound(self, size: int) -> int:
        return min(here + sum(heapq.nlargest(size, gains)) for here, gains in self.seen)
