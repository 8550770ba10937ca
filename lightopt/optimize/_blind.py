"""Blind spots: where defects stay invisible under a set of light positions, and why.

A patch whose trials are not all seen gets the reason that stands between it and the images that it lacks:

============  ==========================================================================================
camera        the camera sees the patch in no posture
grazing       the camera sees it at more than 80° to its normal
shadowed      light reaches it, neither nought nor saturated, in fewer images than are wanted
saturated     the same, and it would not be so were it not for a saturated light: the first of those
contrast      enough images show it well, and the defects change the level by less than noise allows for
============  ==========================================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lightopt.optimize._contrast import GRAZING_COSINE
from lightopt.optimize._matrix import Levels, Thresholds
from lightopt.optimize._packed import Words
from lightopt.optimize._visibility import Visibility

__all__ = ["Blind", "BlindSpots", "blind_codes", "blind_spots", "blind_text"]


class Blind(IntEnum):
    """Why defects on a patch are not seen; saturated by light n is ``SATURATED + n``, n from 0 in the rig's order."""

    SEEN = 0
    CAMERA = 1
    GRAZING = 2
    SHADOWED = 3
    CONTRAST = 4
    SATURATED = 5


@dataclass(frozen=True, kw_only=True)
class BlindSpots:
    """What is seen of the defects on a part's surface, over one posture or several.

    Attributes
    ----------
    codes
        Of all patches of the run: :class:`Blind`, shape (n,).
    share
        Weighted share of the trials that are seen on each patch, shape (n,).
    areas
        Of the patches [mm²], shape (n,).
    """

    codes: NDArray[np.int16]
    share: NDArray[np.float64]
    areas: NDArray[np.float64]

    @property
    def seen(self) -> float:
        """Share of the surface × trials that is seen."""
        return float((self.areas * self.share).sum() / self.areas.sum())

    def by_reason(self) -> dict[int, float]:
        """Share of the surface × trials that is not seen, by code, ascending; they add up to 1 − :attr:`seen`."""
        lost = self.areas * (1.0 - self.share) / self.areas.sum()
        found = np.unique(self.codes[self.codes != Blind.SEEN])
        return {int(code): float(lost[self.codes == code].sum()) for code in found}


def blind_text(code: int, lights: Sequence[str]) -> str:
    """A code in words.

    Parameters
    ----------
    code
        :class:`Blind`.
    lights
        Names of the rig's lights.
    """
    if code >= Blind.SATURATED:
        return f"saturated by {lights[code - Blind.SATURATED]}"
    return {
        Blind.SEEN: "seen",
        Blind.CAMERA: "never seen by the camera",
        Blind.GRAZING: "seen by the camera at a grazing angle",
        Blind.SHADOWED: "shadowed",
        Blind.CONTRAST: "contrast under noise",
    }[Blind(code)]


def blind_codes(
    visibility: Visibility,
    levels: Sequence[Levels],
    thresholds: Thresholds,
    *,
    least: int,
    candidates: Sequence[int] | None = None,
) -> tuple[NDArray[np.int16], Words]:
    """The reason at each patch that the camera sees in a posture, and which trials are seen there.

    Parameters
    ----------
    visibility
        Of the posture.
    levels
        Delivered levels of the same light positions, from its luminance matrix: one array of shape (candidates, p) per
        light.
    thresholds
        Black level and saturation.
    least
        Images that must show a defect.
    candidates
        One position of each light; None for all that the lights can do: then a trial counts as seen where `least`
        lights have a position each that shows it.

    Returns
    -------
    codes, seen
        Shapes (p,) and (p, ⌈t / 64⌉).
    """
    seen = visibility.reachable(least) if candidates is None else visibility.seen(candidates, least)
    count = len(visibility.areas)
    usable, saturated = np.zeros(count, np.int32), np.zeros(count, np.int32)
    first = np.full(count, -1, np.int16)
    for light, layer in enumerate(levels):
        rows = layer if candidates is None else layer[candidates[light]][None, :]
        bright = rows >= thresholds.saturation
        good = ((rows > thresholds.black) & ~bright).any(axis=0)
        glare = bright.any(axis=0) & ~good
        usable += good
        saturated += glare
        first[glare & (first < 0)] = light
    codes = np.full(count, Blind.CONTRAST, np.int16)
    lacking = usable < least
    codes[lacking] = Blind.SHADOWED
    glaring = lacking & (usable + saturated >= least)
    codes[glaring] = Blind.SATURATED + first[glaring]
    codes[visibility.cosines < GRAZING_COSINE] = Blind.GRAZING
    codes[visibility.weights(seen) == visibility.total_weight] = Blind.SEEN
    return codes, seen


def blind_spots(
    areas: NDArray[np.float64],
    postures: Sequence[tuple[Visibility, NDArray[np.int16], Words]],
) -> BlindSpots:
    """Blind spots of the whole surface over one posture or several: a trial is seen that one posture's images show.

    The reason at a patch is that of the posture that came nearest: contrast before saturated, shadowed, grazing, and
    what no posture's camera sees.

    Parameters
    ----------
    areas
        Of all patches of the run [mm²], shape (n,).
    postures
        Of each, its visibility and what :func:`blind_codes` found.
    """
    rank = np.zeros(len(areas), np.int32)
    codes = np.full(len(areas), Blind.CAMERA, np.int16)
    share = np.zeros(len(areas))
    width = max((seen.shape[1] for _, _, seen in postures), default=1)
    seen_anywhere = np.zeros((len(areas), width), np.uint64)
    for visibility, own, seen in postures:
        seen_anywhere[visibility.patch] |= seen
        nearness = np.where(own == Blind.CONTRAST, 4, np.where(own >= Blind.SATURATED, 3, own - 1))
        nearness = np.where(own == Blind.SEEN, 5, nearness)
        better = nearness > rank[visibility.patch]
        rank[visibility.patch[better]] = nearness[better]
        codes[visibility.patch[better]] = own[better]
    if postures:
        first = postures[0][0]
        sums = first.weights(seen_anywhere)
        share = sums / first.total_weight
        codes[sums == first.total_weight] = Blind.SEEN
    return BlindSpots(codes=codes, share=share, areas=areas)
