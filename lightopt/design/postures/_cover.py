"""What a few of many candidates see together, what each of them adds, and how much as many could see at most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lightopt.design.postures._counts import Counts, PairWeights, added, gain_of, no_counts, reached, worth


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
    sets, most_reached
        Number of all sets of as many candidates, and what the best of them reaches; None where not all were searched.
    """

    steps: tuple[Step, ...]
    dropped: tuple[int, ...]
    k: int
    total: int
    bounds: tuple[int, ...]
    all_worth: int
    all_reached: int
    least: int | None
    sets: int | None = None
    most_reached: int | None = None

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
        if self.most_reached is not None:
            return self.most_reached / max(1, self.total)
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
        most = min(self.bound // self.k, self.all_reached) if self.most_reached is None else self.most_reached
        return self.reached >= most

    def searched(self, most_reached: int, sets: int | None) -> Cover:
        """With what the best of so many sets reaches; as it is where the search ended without a proof."""
        return self if sets is None else replace(self, sets=sets, most_reached=most_reached)


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
