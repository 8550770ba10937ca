"""Further exposures of chosen postures: those that show enough more are planned.

Candidates are the postures' images at other exposures, all lights together; the one that shows most pairs more is
planned, then the next, as long as it shows enough more, or the target needs it. Since evidence adds up, two exposures
may add together what neither adds alone: where no single one shows enough more, two are planned that together show
twice as much. A light's exposures in a posture are one image, of which the best counts for each pair.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.errors import counted
from lightopt.core.run_context import Share, ignore
from lightopt.core.transforms import Posture
from lightopt.design.responses._evidence import UNITS_OF_IMAGE
from lightopt.design.responses._image_evaluator import ImageEvaluator, scattered_flags
from lightopt.design.responses._pairs import Counts, PairWeights, Words, add_counts, refuse_memory, unpack_flags
from lightopt.lights import PanelLight

DEFAULT_EXPOSURE_GAIN = 1.0
"""Points (hundredths of the pairs) that a further exposure of a posture has to add by default."""

MOST_IMAGE_BYTES = 1_500_000_000  # of what all postures' images show at all exposures, which is held at a time

# a further exposure is planned: it adds as much as one has to; it does with another, the two twice as much; or less,
# and the target was not reached without it
Reason = Literal["gain", "pair", "target"]

# what a candidate adds alone to the weight of the pairs that are seen in enough images; and at most this weight of the
# other pairs is then seen in more images than before
_Gain = tuple[int, int]

Images = Words  # units of evidence by the image of each light of a posture, shape (lights, units, p, words)


@dataclass(frozen=True, kw_only=True)
class FurtherExposure:
    posture: Posture
    exposure: float  # relative to exposure 1
    gain: float  # share of the pairs that it adds to what is planned before it, or else to the whole plan
    reason: Reason | None  # why it is planned: see :data:`Reason`; None where it is not


@dataclass(frozen=True, kw_only=True)
class Brackets:
    before: float  # share of the pairs that is seen without them
    after: float  # share that is seen with those that are planned
    further: tuple[FurtherExposure, ...]  # the planned ones in the order in which they were chosen, then the others
    least_gain: float  # share that one has to add
    grain: float = 0.0  # how far the shares may be off since a patch counts as its middle does
    found: tuple[int, ...] = ()  # area on which the planned images show each defect [µm²]

    def of(self, posture: Posture) -> tuple[float, ...]:
        """Exposures of a posture in the plan, the longest first."""
        further = [shot.exposure for shot in self.further if shot.reason and shot.posture == posture]
        return tuple(sorted([1.0, *further], reverse=True))


@dataclass(frozen=True, eq=False)
class CandidateExposure:
    posture: int  # index of the posture
    exposure: float  # relative to exposure 1
    images: Images  # its units of evidence, shape (lights, units, p, words)


def select_exposures(
    postures: Sequence[Posture],
    now: Sequence[Images],  # of each posture at exposure 1
    candidates: Sequence[CandidateExposure],
    weights: PairWeights,
    *,
    needed: int,  # units of a pair that is found
    least_gain: float,  # share of the pairs
    target: float | None = None,  # share of the pairs; below it, whatever adds anything is planned
) -> Brackets:
    """Plan exposures as the module's text says, the first of equals, as long as they add anything."""
    total, planned, left = max(1, weights.total), _PlannedImages(now, weights, needed), list(candidates)
    before, further = planned.covered, list[FurtherExposure]()

    def considered(one: CandidateExposure, gain: int, reason: Reason | None) -> FurtherExposure:
        return FurtherExposure(posture=postures[one.posture], exposure=one.exposure, gain=gain / total, reason=reason)

    while True:
        gains = planned.gains(left)
        short = target is not None and planned.covered < target * total
        chosen, reason = planned.next(left, gains, least_gain * total, short)
        if not chosen:
            break
        # of two the one first that adds more alone
        for candidate in [left[i] for i in chosen]:
            covered = planned.covered
            planned.add(candidate)
            further.append(considered(candidate, planned.covered - covered, reason))
        left = [candidate for i, candidate in enumerate(left) if i not in chosen]
    further += [considered(one, gain, None) for one, (gain, _) in zip(left, gains, strict=True)]
    shares = {"before": before / total, "after": planned.covered / total}
    return Brackets(**shares, further=tuple(further), least_gain=least_gain, found=tuple(planned.found().tolist()))


class _PlannedImages:
    """What the planned images show; an image taken with several exposures shows what any of them shows."""

    def __init__(self, images: Sequence[Images], weights: PairWeights, needed: int) -> None:
        self._images, self._weights, self._needed = list(images), weights, needed
        self._own = [self._counts(flags) for flags in images]
        self._update()

    def gains(self, candidates: Sequence[CandidateExposure]) -> list[_Gain]:
        others: dict[int, Counts] = {}
        gains: list[_Gain] = []
        for candidate in candidates:
            at = candidate.posture
            if at not in others:
                others = {at: self._without({at})}
            now = add_counts(others[at], self._counts(self._images[at] | candidate.images))
            covered, benefit = self._weights.merit(now)
            more = covered - self.covered
            # the benefit of a pair that is now found has grown by a unit at least; the others have some units more
            gains.append((more, benefit - self._benefit - more))
        return gains

    def next(
        self, candidates: Sequence[CandidateExposure], gains: Sequence[_Gain], least: float, short: bool
    ) -> tuple[tuple[int, ...], Reason]:
        """Indices of what to plan next, and why; none where nothing is enough and the target is met or out of reach."""
        if not candidates:
            return (), "gain"
        best = max(range(len(candidates)), key=lambda i: gains[i][0])
        alone = gains[best][0]
        if alone >= max(1.0, least):
            return (best,), "gain"
        # in vain where two do not add twice as much; with the target out of reach alone, any gain will do
        enough = 1 if short and alone == 0 else max(1, math.ceil(2.0 * least))
        if (pair := self._best_pair(candidates, gains, enough)) is not None:
            return pair[1], "pair" if pair[0] >= 2.0 * least else "target"
        return ((best,), "target") if short and alone > 0 else ((), "gain")

    def _best_pair(
        self, candidates: Sequence[CandidateExposure], gains: Sequence[_Gain], at_least: int
    ) -> tuple[int, tuple[int, int]] | None:
        # The two candidates that add most together, the first of equals: how much, and their indices, first of that
        # which adds more alone. What both are needed for is nearer with either
        most = {
            (i, j): gains[i][0] + gains[j][0] + min(gains[i][1], gains[j][1])
            for i, j in combinations(range(len(candidates)), 2)
        }
        best: tuple[int, tuple[int, int]] | None = None
        for i, j in sorted(most, key=lambda two: (-most[two], two)):
            if most[i, j] < at_least:
                break
            gain = self._gain_of(candidates[i], candidates[j])
            if gain >= at_least:
                best, at_least = (gain, (j, i) if gains[j][0] > gains[i][0] else (i, j)), gain + 1
        return best

    def add(self, candidate: CandidateExposure) -> None:
        at = candidate.posture
        self._images[at] = self._images[at] | candidate.images
        self._own[at] = self._counts(self._images[at])
        self._update()

    def found(self) -> Int64:
        """Area on which each defect is found, shape (t,); some defects that do not exist come last."""
        counts = self._without(set())
        return self._weights.areas @ unpack_flags(counts[-1], 64 * counts.shape[-1])

    def _gain_of(self, one: CandidateExposure, other: CandidateExposure) -> int:
        at = {one.posture, other.posture}
        total = self._without(at)
        for posture in at:
            images = [some.images for some in (one, other) if some.posture == posture]
            total = add_counts(total, self._counts(np.bitwise_or.reduce([self._images[posture], *images])))
        return self._weights.covered(total) - self.covered

    def _update(self) -> None:
        self.covered, self._benefit = self._weights.merit(self._without(set()))

    def _without(self, postures: set[int]) -> Counts:
        rest = (own for i, own in enumerate(self._own) if i not in postures)
        return self._weights.sum_counts(rest, self._needed)

    def _counts(self, images: Images) -> Counts:
        return self._weights.sum_counts(images, self._needed)


def plan_exposures(
    evaluator: ImageEvaluator,
    postures: Sequence[Posture],
    lights: Sequence[Sequence[PanelLight]],  # the panels posture by posture, world frame
    exposures: Sequence[float],  # further exposures to choose from; 1 is taken anyway
    gain_points: float = DEFAULT_EXPOSURE_GAIN,  # the least gain [hundredths of the pairs]
    target: float | None = None,  # share of the pairs that is to be shown
    progress: Share = ignore,
) -> Brackets:
    """Plan a further exposure only where it shows more by at least a given gain, or where the target needs it."""
    further = [exposure for exposure in exposures if exposure != 1.0]
    most = max(map(len, lights))
    image_bytes = UNITS_OF_IMAGE * len(evaluator.patches) * evaluator.weights.masks.shape[1] * 8
    images = len(postures) * (1 + len(further)) * most
    what = f"option 'exposures': {counted(images, 'image')} × {len(evaluator.patches):,} patches"
    refuse_memory(what, images * image_bytes, MOST_IMAGE_BYTES, "choose from fewer exposures")
    now: list[Images] = []
    candidates: list[CandidateExposure] = []
    for index, (posture, panels) in enumerate(zip(postures, lights, strict=True)):
        matrices = evaluator.matrices(posture, [[panel] for panel in panels], exposures=(1.0, *further))
        first, *rest = (
            np.stack([scattered_flags([one], evaluator.patches, light=light, place=0) for light in range(len(panels))])
            for one in matrices
        )
        now.append(first)
        candidates += [CandidateExposure(index, *pair) for pair in zip(further, rest, strict=True)]
        progress((index + 1) / len(postures))
    weights, needed, least = evaluator.weights, evaluator.needed, gain_points / 100.0
    found = select_exposures(postures, now, candidates, weights, needed=needed, least_gain=least, target=target)
    return replace(found, grain=evaluator.table.grain)
