"""Blind spots: where defects stay invisible under a set of light positions, and why.

A trial is seen where as many images as are wanted show it, whichever postures they are of; what several exposures of a
light show is one image's. A patch whose trials are not all seen gets the reason that stands between it and the images
that it lacks:

============  ==========================================================================================
camera        the camera sees the patch in no posture
grazing       the camera sees it at a grazing angle only (:data:`lightopt.rendering.GRAZING_DEG`)
shadowed      light reaches it, neither nought nor saturated, in fewer images than are wanted
saturated     the same, and it would not be so were it not for a saturated light: the first of those
contrast      enough images show it well, and the defects change the level by less than noise allows for
============  ==========================================================================================

What is seen at a grazing angle only counts neither as seen nor as blind: shares are of the rest of the surface, and the
share left out stands beside them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix
from lightopt.design.responses._packed_bits import Words, add_counts, add_image
from lightopt.design.responses._visibility import Visibility
from lightopt.rendering import grain_of


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
        """Share of the surface × trials that is seen, of what is not left out."""
        return float((self.areas * self.share).sum() / self.counted)

    @property
    def counted(self) -> float:
        """Area that shares are of: all but what is seen at a grazing angle only [mm²]."""
        return max(float(self.areas[self.codes != Blind.GRAZING].sum()), 1e-300)

    @property
    def grain(self) -> float:
        """How far these shares may be off: see :func:`lightopt.rendering.grain_of`."""
        return grain_of(self.areas[self.codes != Blind.GRAZING])

    @property
    def left_out(self) -> float:
        """Of the whole surface, the share that is seen at a grazing angle only."""
        return float(self.areas[self.codes == Blind.GRAZING].sum() / self.areas.sum())

    def by_reason(self) -> dict[int, float]:
        """Share of the surface × trials that is not seen, by code, ascending; they add up to 1 − :attr:`seen`.

        Of what is not left out: :attr:`Blind.GRAZING` is not among them.
        """
        lost = self.areas * (1.0 - self.share) / self.counted
        found = np.unique(self.codes[(self.codes != Blind.SEEN) & (self.codes != Blind.GRAZING)])
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
        Blind.GRAZING: "left out: seen at a grazing angle",
        Blind.SHADOWED: "shadowed",
        Blind.CONTRAST: "contrast under noise",
    }[Blind(code)]


@dataclass(frozen=True, eq=False, kw_only=True)
class Shown:
    """What the images of a posture show of the patches that the camera sees there.

    Attributes
    ----------
    visibility
        The patches; without positions of lights.
    counts
        Flag l of a trial says that l + 1 images or more show it, shape (k, p, ⌈t / 64⌉).
    usable
        Images with a level that is neither dark nor saturated, shape (p,).
    saturated
        Images with a saturated level and no usable one, shape (p,).
    first
        The first light whose image is one of these; −1 where none is; shape (p,).
    """

    visibility: Visibility
    counts: Words
    usable: NDArray[np.int32]
    saturated: NDArray[np.int32]
    first: NDArray[np.int16]


def shown_by(
    matrices: Iterable[LuminanceMatrix],
    thresholds: LevelThresholds,
    *,
    least: int,
    candidates: Sequence[int] | None = None,
    first_light: int = 0,
) -> Shown:
    """What the images of a posture's lights show; exposures of the same light are one image, not two.

    Parameters
    ----------
    matrices
        Of the posture and of the same lights, one for each exposure, with their visibility; or of some of the lights'
        positions each, of which only one is held at a time where they are made as they are asked for.
    thresholds
        Black level and saturation.
    least
        Images that must show a defect.
    candidates
        One position of each light; None for all that the lights can do: then an image shows what one of the light's
        positions shows.
    first_light
        The matrices' first light, in the rig's order.
    """
    shown: Shown | None = None
    images: list[tuple[Words, NDArray[np.bool_], NDArray[np.bool_]]] = []
    for matrix in matrices:
        visibility = matrix.visibility
        assert visibility is not None
        if shown is None:
            shown = _nothing_shown(visibility, least)
            images = [_nothing_seen(shown) for _ in visibility.words]
        for light, (seen, good, bright) in enumerate(images):
            rows = slice(None) if candidates is None else slice(candidates[light], candidates[light] + 1)
            levels = matrix.levels[light][rows]
            saturated = levels >= thresholds.saturation
            seen |= np.bitwise_or.reduce(visibility.words[light][rows], axis=0)
            good |= ((levels > thresholds.black) & ~saturated).any(axis=0)
            bright |= saturated.any(axis=0)
    assert shown is not None
    for light, (seen, good, bright) in enumerate(images):
        add_image(shown.counts, seen)
        glare = bright & ~good
        shown.usable[:] += good
        shown.saturated[:] += glare
        shown.first[glare & (shown.first < 0)] = first_light + light
    return shown


def _nothing_shown(visibility: Visibility, least: int) -> Shown:
    """The patches of a posture before any image is looked at."""
    count = len(visibility.areas)
    return Shown(
        visibility=visibility.rows([np.zeros(0, np.int64)] * len(visibility.words)),
        counts=np.zeros((least, count, -(-len(visibility.hypotheses) // 64)), np.uint64),
        usable=np.zeros(count, np.int32),
        saturated=np.zeros(count, np.int32),
        first=np.full(count, -1, np.int16),
    )


def _nothing_seen(shown: Shown) -> tuple[Words, NDArray[np.bool_], NDArray[np.bool_]]:
    """An image before any of its positions is looked at: what it shows, and where it is usable and saturated."""
    count = shown.counts.shape[1]
    return np.zeros(shown.counts.shape[1:], np.uint64), np.zeros(count, np.bool_), np.zeros(count, np.bool_)


def shown_together(one: Shown, other: Shown) -> Shown:
    """What the images of other lights show in the same posture, added."""
    return Shown(
        visibility=one.visibility,
        counts=add_counts(one.counts, other.counts),
        usable=one.usable + other.usable,
        saturated=one.saturated + other.saturated,
        first=np.where(one.first < 0, other.first, one.first),
    )


def blind_spots(areas: NDArray[np.float64], postures: Sequence[Shown]) -> BlindSpots:
    """Blind spots of the whole surface over one posture or several: seen is what enough images of all of them show.

    Parameters
    ----------
    areas
        Of all patches of the run [mm²], shape (n,).
    postures
        What the images of each show.
    """
    count = len(areas)
    if not postures:
        return BlindSpots(codes=np.full(count, Blind.CAMERA, np.int16), share=np.zeros(count), areas=areas)
    first_posture = postures[0].visibility
    least = len(postures[0].counts)
    counts = np.zeros((least, count, postures[0].counts.shape[2]), np.uint64)
    usable, saturated = np.zeros(count, np.int64), np.zeros(count, np.int64)
    first = np.full(count, -1, np.int16)
    # 0 the camera does not see it, 1 at a grazing angle, 2 well
    sight = np.zeros(count, np.int8)
    for shown in postures:
        patch, grazing = shown.visibility.patch, shown.visibility.grazing
        sight[grazing] = np.maximum(sight[grazing], 1)
        sight[patch] = 2
        counts[:, patch] = add_counts(counts[:, patch], shown.counts)
        usable[patch] += shown.usable
        saturated[patch] += shown.saturated
        first[patch] = np.where(first[patch] < 0, shown.first, first[patch])
    codes = np.full(count, Blind.CONTRAST, np.int16)
    lacking = usable < least
    codes[lacking] = Blind.SHADOWED
    glaring = lacking & (usable + saturated >= least)
    codes[glaring] = Blind.SATURATED + first[glaring]
    codes[sight == 1] = Blind.GRAZING
    codes[sight == 0] = Blind.CAMERA
    sums = first_posture.weights(counts[-1])
    codes[sums == first_posture.total_weight] = Blind.SEEN
    return BlindSpots(codes=codes, share=sums / first_posture.total_weight, areas=areas)
