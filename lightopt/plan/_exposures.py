"""Further exposures of chosen postures: planned where they show enough more, and nowhere else.

Offered are the postures' images at other exposures, all lights together; the one that shows most pairs more is planned,
then the next, as long as it shows enough more, or the target takes it. A light's exposures in a posture are one image:
a pair that two of them show has not been confirmed by another light or from another side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.errors import InputError
from lightopt.plan._counts import Counts, PairWeights, Words, added, counts_of_images, no_counts, reached
from lightopt.plan._survey import Survey, scattered_flags
from lightopt.scene import PanelLight
from lightopt.transforms import Posture

__all__ = [
    "DEFAULT_EXPOSURE_GAIN",
    "Brackets",
    "Images",
    "Offer",
    "Shot",
    "check_exposures",
    "images_of",
    "pick_shots",
    "plan_exposures",
]

Images = Words
"""Flags of the pairs that the images of a posture show, shape (lights, p, words); where one image is enough, of all
together, shape (1, p, words)."""

DEFAULT_EXPOSURE_GAIN = 1.0
"""Points (hundredths of the pairs) that a further exposure of a posture has to add, unless asked otherwise."""


MOST_IMAGE_BYTES = 1_500_000_000
"""Of what all postures' images show at all exposures, which is held at a time."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """A further exposure of a posture, all lights.

    Attributes
    ----------
    posture
        The posture.
    exposure
        Relative to exposure 1.
    gain
        Share of the pairs that it adds: to what is planned before it where it is planned, else to the whole plan.
    planned
        Whether the gain is enough.
    """

    posture: Posture
    exposure: float
    gain: float
    planned: bool


@dataclass(frozen=True, kw_only=True)
class Brackets:
    """The further exposures that were looked at.

    Attributes
    ----------
    before, after
        Share of the pairs that is seen without them and with those that are planned.
    shots
        The planned ones in the order in which they were chosen, then the others.
    least_gain
        Share that one has to add.
    """

    before: float
    after: float
    shots: tuple[Shot, ...]
    least_gain: float

    def of(self, posture: Posture) -> tuple[float, ...]:
        """Exposures of a posture in the plan, the longest first."""
        further = [shot.exposure for shot in self.shots if shot.planned and shot.posture == posture]
        return tuple(sorted([1.0, *further], reverse=True))


def check_exposures(offered: Sequence[float], gain_points: float) -> list[str]:
    """What is wrong with exposures and the gain that is asked of them."""
    problems = [
        f"--exposures: expected numbers above 0, such as 1,1/4,1/16, found {exposure:g}"
        for exposure in offered
        if not (math.isfinite(exposure) and exposure > 0.0)
    ]
    if len(set(offered)) < len(offered):
        problems.append("--exposures: the same exposure was given twice")
    if not (math.isfinite(gain_points) and 0.0 <= gain_points <= 100.0):
        problems.append(f"--exposure-gain: expected points from 0 to 100, found {gain_points:g}")
    return problems


@dataclass(frozen=True, eq=False, kw_only=True)
class Offer:
    """A further exposure of a posture that may be planned.

    Attributes
    ----------
    posture
        Index of the posture.
    exposure
        Relative to exposure 1.
    images
        Flags of the pairs that it shows, from :func:`images_of`.
    """

    posture: int
    exposure: float
    images: Images


def plan_exposures(
    survey: Survey,
    postures: Sequence[Posture],
    lights: Sequence[Sequence[PanelLight]],
    offered: Sequence[float],
    *,
    least: int,
    gain_points: float = DEFAULT_EXPOSURE_GAIN,
    target: float | None = None,
    tell: Callable[[float], None] | None = None,
) -> Brackets:
    """Plan a further exposure only where it shows more by at least a given gain, or where the target takes it.

    Parameters
    ----------
    survey
        The part.
    postures
        In the plan.
    lights
        Where they stand, posture by posture, world frame.
    offered
        Exposures; 1 is taken anyway.
    least
        Images that must show a pair, of all postures together.
    gain_points
        The least gain [hundredths of the pairs].
    target
        Share of the pairs that is to be shown; None for no matter.
    tell
        Called with the share that is done.

    Raises
    ------
    InputError
        More images than memory is meant for.
    """
    further = [exposure for exposure in offered if exposure != 1.0]
    kept = 1 if least == 1 else max(map(len, lights))
    size = len(postures) * (1 + len(further)) * kept * len(survey.patches) * survey.weights.masks.shape[1] * 8
    if size > MOST_IMAGE_BYTES:
        raise InputError(
            f"--exposures: {len(postures)} postures × {1 + len(further)} exposures × {kept} lights × "
            f"{len(survey.patches):,} patches are {size / 1e9:.2f} GB, and there is room for "
            f"{MOST_IMAGE_BYTES / 1e9:.2f} GB; offer fewer exposures, or take fewer --patches"
        )
    now: list[Images] = []
    offers: list[Offer] = []
    for index, (posture, panels) in enumerate(zip(postures, lights, strict=True)):
        matrices = survey.matrices(posture, [[panel] for panel in panels], exposures=(1.0, *further))
        first, *rest = (
            images_of(
                [
                    scattered_flags([matrix], survey.patches, light=light, place=0)
                    for light in range(len(panels))
                ],
                least,
            )
            for matrix in matrices
        )
        now.append(first)
        offers += [
            Offer(posture=index, exposure=exposure, images=images)
            for exposure, images in zip(further, rest, strict=True)
        ]
        if tell is not None:
            tell((index + 1) / len(postures))
    return pick_shots(
        postures, now, offers, survey.weights, least=least, least_gain=gain_points / 100.0, target=target
    )


def images_of(flags: Sequence[Words], least: int) -> Images:
    """The images of a posture's lights; where one image is enough, what they show together is all that matters."""
    return np.bitwise_or.reduce(flags, axis=0)[None] if least == 1 else np.stack(flags)


def pick_shots(
    postures: Sequence[Posture],
    now: Sequence[Images],
    offers: Sequence[Offer],
    weights: PairWeights,
    *,
    least: int,
    least_gain: float,
    target: float | None = None,
) -> Brackets:
    """Take the exposure that adds most to what is seen, the first of equals, as long as it adds enough and anything.

    Parameters
    ----------
    postures
        Of the plan.
    now
        What the images of each show at exposure 1, from :func:`images_of`.
    offers
        Further exposures.
    weights
        Of the pairs.
    least
        Images that must show a pair.
    least_gain
        Share of the pairs.
    target
        Share of the pairs: below it, whatever adds anything is taken.
    """
    total = max(1, weights.total)
    taken = _Taken(now, weights, least)
    before = taken.seen
    left = list(offers)
    planned: list[Shot] = []
    while True:
        gains = taken.gains(left)
        best = max(range(len(left)), key=lambda i: gains[i], default=None)
        if best is None or gains[best] == 0:
            break
        short = target is not None and taken.seen < target * total
        if gains[best] < least_gain * total and not short:
            break
        offer = left.pop(best)
        planned.append(_shot(postures, offer, gains.pop(best) / total, planned=True))
        taken.take(offer)
    rest = [
        _shot(postures, offer, gain / total, planned=False) for offer, gain in zip(left, gains, strict=True)
    ]
    return Brackets(
        before=before / total, after=taken.seen / total, shots=(*planned, *rest), least_gain=least_gain
    )


def _shot(postures: Sequence[Posture], offer: Offer, gain: float, *, planned: bool) -> Shot:
    return Shot(posture=postures[offer.posture], exposure=offer.exposure, gain=gain, planned=planned)


class _Taken:
    """What the planned images show; an image taken with several exposures is one that shows what any of them shows."""

    def __init__(self, images: Sequence[Images], weights: PairWeights, least: int) -> None:
        self._images, self._weights, self._least = list(images), weights, least
        self.seen = reached(self._together(range(len(images))), weights)

    def gains(self, offers: Sequence[Offer]) -> list[int]:
        """By how much each offer would add to the weight of the pairs that are seen."""
        others: dict[int, Counts] = {}
        gains: list[int] = []
        for offer in offers:
            at = offer.posture
            if at not in others:
                others[at] = self._together([i for i in range(len(self._images)) if i != at])
            own = counts_of_images(list(self._images[at] | offer.images), self._least)
            gains.append(reached(added(others[at], own), self._weights) - self.seen)
        return gains

    def take(self, offer: Offer) -> None:
        """Plan it."""
        self._images[offer.posture] = self._images[offer.posture] | offer.images
        self.seen = reached(self._together(range(len(self._images))), self._weights)

    def _together(self, postures: Sequence[int]) -> Counts:
        total = no_counts(self._weights, self._least)
        for i in postures:
            total = added(total, counts_of_images(list(self._images[i]), self._least))
        return total
