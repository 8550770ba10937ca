"""Further exposures of chosen postures: planned where they show enough more, and nowhere else.

Offered are the postures' images at other exposures, all lights together; the one that shows most pairs more is planned,
then the next, as long as it shows enough more, or the target takes it. Where two images must show a pair, two exposures
may add together what neither adds alone: where no single one shows enough more, two are planned that together show
twice as much. A light's exposures in a posture are one image: a pair that two of them show has not been confirmed by
another light or from another side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from lightopt.errors import InputError
from lightopt.plan._counts import (
    Counts,
    PairWeights,
    Words,
    added,
    counts_of_images,
    reached,
    together,
    worth,
)
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

Why = Literal["gain", "pair", "target"]
"""A further exposure is planned: it adds as much as one has to; it does with another, the two twice as much; or less,
and the target was not reached without it."""

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
    why
        It is planned: its gain is enough, or that of two together, or the target takes it; None where it is not.
    """

    posture: Posture
    exposure: float
    gain: float
    why: Why | None

    @property
    def planned(self) -> bool:
        """Whether it is."""
        return self.why is not None


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
        f"--exposures: expected numbers above 0, such as 1/16,1/4,1,4,16, found {exposure:g}"
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

    Where none does, the two that add most together, as long as that is twice as much and anything.

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
        short = target is not None and taken.seen < target * total
        some, why = _best(taken, left, gains, least_gain * total, short)
        if not some:
            break
        # of two the one first that adds more alone
        for offer in [left[i] for i in some]:
            before_it = taken.seen
            taken.take(offer)
            planned.append(_shot(postures, offer, (taken.seen - before_it) / total, why))
        left = [offer for i, offer in enumerate(left) if i not in some]
    rest = [
        _shot(postures, offer, gain.reached / total, None) for offer, gain in zip(left, gains, strict=True)
    ]
    return Brackets(
        before=before / total, after=taken.seen / total, shots=(*planned, *rest), least_gain=least_gain
    )


def _best(
    taken: _Taken, offers: Sequence[Offer], gains: Sequence[_Gain], least: float, short: bool
) -> tuple[tuple[int, ...], Why]:
    """What to plan next, by index, and why; nothing where nothing pays and the target is met or beyond reach."""
    one = max(range(len(offers)), key=lambda i: gains[i].reached, default=None)
    if one is None:
        return (), "gain"
    alone = gains[one].reached
    if alone >= max(1.0, least):
        return (one,), "gain"
    # in vain where two do not add twice as much; with the target out of reach alone, anything will do
    two = taken.pair(offers, gains, at_least=1 if short and alone == 0 else max(1, math.ceil(2.0 * least)))
    if two is not None:
        return two[1], "pair" if two[0] >= 2.0 * least else "target"
    return ((one,), "target") if short and alone > 0 else ((), "gain")


def _shot(postures: Sequence[Posture], offer: Offer, gain: float, why: Why | None) -> Shot:
    return Shot(posture=postures[offer.posture], exposure=offer.exposure, gain=gain, why=why)


@dataclass(frozen=True, kw_only=True)
class _Gain:
    """What an offer adds alone.

    Attributes
    ----------
    reached
        To the weight of the pairs that are seen in enough images.
    nearer
        At most this weight of the other pairs is seen in more images than before.
    """

    reached: int
    nearer: int


class _Taken:
    """What the planned images show; an image taken with several exposures is one that shows what any of them shows."""

    def __init__(self, images: Sequence[Images], weights: PairWeights, least: int) -> None:
        self._images, self._weights, self._least = list(images), weights, least
        self._own = [self._counts(some) for some in images]
        self._set_seen()

    def gains(self, offers: Sequence[Offer]) -> list[_Gain]:
        """What each offer would add."""
        others: dict[int, Counts] = {}
        gains: list[_Gain] = []
        for offer in offers:
            at = offer.posture
            if at not in others:
                others = {at: self._without({at})}
            now = added(others[at], self._counts(self._images[at] | offer.images))
            more = reached(now, self._weights) - self.seen
            # a pair that is now seen often enough is worth one more at least, and so is one that is seen once more
            gains.append(_Gain(reached=more, nearer=worth(now, self._weights) - self._worth - more))
        return gains

    def pair(
        self, offers: Sequence[Offer], gains: Sequence[_Gain], *, at_least: int
    ) -> tuple[int, tuple[int, int]] | None:
        """The two offers that add most together, the first of equals: how much, and their indices.

        The one that adds more alone stands first.

        Parameters
        ----------
        offers, gains
            What there is, and what each adds alone.
        at_least
            Two that add less are not looked for.
        """
        # what both are needed for is nearer with either
        most = {
            (i, j): gains[i].reached + gains[j].reached + min(gains[i].nearer, gains[j].nearer)
            for i, j in combinations(range(len(offers)), 2)
        }
        best: tuple[int, tuple[int, int]] | None = None
        for i, j in sorted(most, key=lambda two: (-most[two], two)):
            if most[i, j] < (at_least if best is None else best[0] + 1):
                break
            gain = self._gain_of(offers[i], offers[j])
            if gain >= (at_least if best is None else best[0] + 1):
                best = gain, ((j, i) if gains[j].reached > gains[i].reached else (i, j))
        return best

    def take(self, offer: Offer) -> None:
        """Plan it."""
        at = offer.posture
        self._images[at] = self._images[at] | offer.images
        self._own[at] = self._counts(self._images[at])
        self._set_seen()

    def _gain_of(self, one: Offer, other: Offer) -> int:
        at = {one.posture, other.posture}
        total = self._without(at)
        for posture in at:
            images = self._images[posture]
            for offer in (one, other):
                if offer.posture == posture:
                    images = images | offer.images
            total = added(total, self._counts(images))
        return reached(total, self._weights) - self.seen

    def _set_seen(self) -> None:
        total = self._without(set())
        self.seen, self._worth = reached(total, self._weights), worth(total, self._weights)

    def _without(self, postures: set[int]) -> Counts:
        rest = (own for i, own in enumerate(self._own) if i not in postures)
        return together(rest, self._weights, self._least)

    def _counts(self, images: Images) -> Counts:
        return counts_of_images(list(images), self._least)
