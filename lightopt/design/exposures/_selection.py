"""Which of the candidate exposures are planned: those that show enough more.

Candidates are the postures' images at other exposures, all lights together; the one that shows most pairs more is
planned, then the next, as long as it shows enough more, or the target needs it. Where two images must show a pair, two
exposures may add together what neither adds alone: where no single one shows enough more, two are planned that together
show twice as much. A light's exposures in a posture are one image: a pair that two of them show has not been confirmed
by another light or from another side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

from lightopt.core.transforms import Posture
from lightopt.design.postures._counts import (
    Counts,
    PairWeights,
    add_counts,
    counts_of_images,
    covered_weight,
    sum_counts,
    total_benefit,
)
from lightopt.design.responses._packed_bits import Words

# a further exposure is planned: it adds as much as one has to; it does with another, the two twice as much; or less,
# and the target was not reached without it
Reason = Literal["gain", "pair", "target"]


@dataclass(frozen=True, kw_only=True)
class FurtherExposure:
    """A further exposure of a posture, all lights.

    exposure: Relative to exposure 1.
    gain: Share of the pairs that it adds: to what is planned before it where it is planned, else to the whole plan.
    reason: Why it is planned: see :data:`Reason`; None where it is not.
    """

    posture: Posture
    exposure: float
    gain: float
    reason: Reason | None

    @property
    def planned(self) -> bool:
        return self.reason is not None


@dataclass(frozen=True, kw_only=True)
class Brackets:
    """The further exposures that were considered.

    before, after: Share of the pairs that is seen without them and with those that are planned.
    further: The planned ones in the order in which they were chosen, then the others.
    least_gain: Share that one has to add.
    grain: How far the shares may be off since a patch counts as its middle does.
    """

    before: float
    after: float
    further: tuple[FurtherExposure, ...]
    least_gain: float
    grain: float = 0.0

    def of(self, posture: Posture) -> tuple[float, ...]:
        """Exposures of a posture in the plan, the longest first."""
        further = [shot.exposure for shot in self.further if shot.planned and shot.posture == posture]
        return tuple(sorted([1.0, *further], reverse=True))


# flags of the pairs that the images of a posture show, shape (lights, p, words); where one image is enough, of all
# together, shape (1, p, words)
Images = Words


@dataclass(frozen=True, eq=False, kw_only=True)
class CandidateExposure:
    """A further exposure of a posture that may be planned.

    posture: Index of the posture.
    exposure: Relative to exposure 1.
    images: Flags of the pairs that it shows, from :func:`lightopt.design.exposures._plan_exposures.images_of`.
    """

    posture: int
    exposure: float
    images: Images


def select_exposures(
    postures: Sequence[Posture],
    now: Sequence[Images],
    candidates: Sequence[CandidateExposure],
    weights: PairWeights,
    *,
    min_images: int,
    least_gain: float,
    target: float | None = None,
) -> Brackets:
    """Take the exposure that adds most to what is seen, the first of equals, as long as it adds enough and anything.

    Where none does, the two that add most together, as long as that is twice as much and anything. Below `target`, a
    share of the pairs, whatever adds anything is taken.

    now: What the images of each posture show at exposure 1, from
        :func:`lightopt.design.exposures._plan_exposures.images_of`.
    min_images: Images that must show a pair.
    least_gain: Share of the pairs.
    """
    total = max(1, weights.total)
    planned = _PlannedImages(now, weights, min_images)
    before = planned.covered
    left = list(candidates)
    further: list[FurtherExposure] = []

    def considered(candidate: CandidateExposure, gain: int, reason: Reason | None) -> FurtherExposure:
        posture = postures[candidate.posture]
        return FurtherExposure(posture=posture, exposure=candidate.exposure, gain=gain / total, reason=reason)

    while True:
        gains = planned.gains(left)
        short = target is not None and planned.covered < target * total
        chosen, reason = _next(planned, left, gains, least_gain * total, short)
        if not chosen:
            break
        # of two the one first that adds more alone
        for candidate in [left[i] for i in chosen]:
            covered = planned.covered
            planned.add(candidate)
            further.append(considered(candidate, planned.covered - covered, reason))
        left = [candidate for i, candidate in enumerate(left) if i not in chosen]
    further += [considered(one, gain.covered, None) for one, gain in zip(left, gains, strict=True)]
    return Brackets(before=before / total, after=planned.covered / total, further=tuple(further), least_gain=least_gain)


def _next(
    planned: _PlannedImages, candidates: Sequence[CandidateExposure], gains: Sequence[_Gain], least: float, short: bool
) -> tuple[tuple[int, ...], Reason]:
    """Indices of what to plan next, and why; none where nothing is enough and the target is met or out of reach."""
    best = max(range(len(candidates)), key=lambda i: gains[i].covered, default=None)
    if best is None:
        return (), "gain"
    alone = gains[best].covered
    if alone >= max(1.0, least):
        return (best,), "gain"
    # in vain where two do not add twice as much; with the target out of reach alone, any gain will do
    enough = 1 if short and alone == 0 else max(1, math.ceil(2.0 * least))
    pair = planned.best_pair(candidates, gains, at_least=enough)
    if pair is not None:
        return pair[1], "pair" if pair[0] >= 2.0 * least else "target"
    return ((best,), "target") if short and alone > 0 else ((), "gain")


@dataclass(frozen=True, kw_only=True)
class _Gain:
    """What a candidate adds alone.

    covered: To the weight of the pairs that are seen in enough images.
    nearer: At most this weight of the other pairs is seen in more images than before.
    """

    covered: int
    nearer: int


class _PlannedImages:
    """What the planned images show; an image taken with several exposures shows what any of them shows."""

    def __init__(self, images: Sequence[Images], weights: PairWeights, min_images: int) -> None:
        self._images, self._weights, self._seen_in = list(images), weights, min_images
        self._own = [self._counts(flags) for flags in images]
        self._update()

    def gains(self, candidates: Sequence[CandidateExposure]) -> list[_Gain]:
        """What each candidate would add."""
        others: dict[int, Counts] = {}
        gains: list[_Gain] = []
        for candidate in candidates:
            at = candidate.posture
            if at not in others:
                others = {at: self._without({at})}
            now = add_counts(others[at], self._counts(self._images[at] | candidate.images))
            more = covered_weight(now, self._weights) - self.covered
            # the benefit of a pair grows by one at least where it is now seen often enough, or only once more
            gains.append(_Gain(covered=more, nearer=total_benefit(now, self._weights) - self._benefit - more))
        return gains

    def best_pair(
        self, candidates: Sequence[CandidateExposure], gains: Sequence[_Gain], *, at_least: int
    ) -> tuple[int, tuple[int, int]] | None:
        """The two candidates that add most together, the first of equals: how much, and their indices.

        The one that adds more alone stands first. Two that add less than `at_least` are not searched for.
        """
        # what both are needed for is nearer with either
        most = {
            (i, j): gains[i].covered + gains[j].covered + min(gains[i].nearer, gains[j].nearer)
            for i, j in combinations(range(len(candidates)), 2)
        }
        best: tuple[int, tuple[int, int]] | None = None
        for i, j in sorted(most, key=lambda two: (-most[two], two)):
            if most[i, j] < (at_least if best is None else best[0] + 1):
                break
            gain = self._gain_of(candidates[i], candidates[j])
            if gain >= (at_least if best is None else best[0] + 1):
                best = gain, ((j, i) if gains[j].covered > gains[i].covered else (i, j))
        return best

    def add(self, candidate: CandidateExposure) -> None:
        """Add a candidate to the plan."""
        at = candidate.posture
        self._images[at] = self._images[at] | candidate.images
        self._own[at] = self._counts(self._images[at])
        self._update()

    def _gain_of(self, one: CandidateExposure, other: CandidateExposure) -> int:
        at = {one.posture, other.posture}
        total = self._without(at)
        for posture in at:
            images = self._images[posture]
            for candidate in (one, other):
                if candidate.posture == posture:
                    images = images | candidate.images
            total = add_counts(total, self._counts(images))
        return covered_weight(total, self._weights) - self.covered

    def _update(self) -> None:
        total = self._without(set())
        self.covered, self._benefit = (covered_weight(total, self._weights), total_benefit(total, self._weights))

    def _without(self, postures: set[int]) -> Counts:
        rest = (own for i, own in enumerate(self._own) if i not in postures)
        return sum_counts(rest, self._weights, self._seen_in)

    def _counts(self, images: Images) -> Counts:
        return counts_of_images(list(images), self._seen_in)
