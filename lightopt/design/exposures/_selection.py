"""Which of the offered exposures are planned: those that show enough more, and no others.

Offered are the postures' images at other exposures, all lights together; the one that shows most pairs more is planned,
then the next, as long as it shows enough more, or the target takes it. Where two images must show a pair, two exposures
may add together what neither adds alone: where no single one shows enough more, two are planned that together show
twice as much. A light's exposures in a posture are one image: a pair that two of them show has not been confirmed by
another light or from another side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from lightopt.core.transforms import Posture
from lightopt.design.exposures._brackets import Brackets, Shot, Why
from lightopt.design.postures._counts import (
    Counts,
    PairWeights,
    Words,
    added,
    counts_of_images,
    reached,
    together,
    worth,
)

Images = Words
"""Flags of the pairs that the images of a posture show, shape (lights, p, words); where one image is enough, of all
together, shape (1, p, words)."""


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
        Flags of the pairs that it shows, from :func:`lightopt.design.exposures._exposures.images_of`.
    """

    posture: int
    exposure: float
    images: Images


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
        What the images of each show at exposure 1, from :func:`lightopt.design.exposures._exposures.images_of`.
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
