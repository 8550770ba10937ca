"""The colours of blind spots, the same in the pictures, in ``blind.csv``, in ``blind.ply`` and in the report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.design.blind_spots._blind_spots import Blind, BlindSpots
from lightopt.design.objectives._objective import share_text

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""


@dataclass(frozen=True, kw_only=True)
class BlindClass:
    """What patches of one colour have in common.

    Attributes
    ----------
    code
        Why defects are not seen; :attr:`Blind.SATURATED` stands for every light.
    some_seen
        Whether other defects are seen there.
    label
        In words.
    colour
        Of the patches.
    """

    code: Blind
    some_seen: bool
    label: str
    colour: Colour


@dataclass(frozen=True, kw_only=True)
class LegendRow:
    """A line of a picture's legend.

    Attributes
    ----------
    label
        In words.
    share
        Of the part's surface × defects; where it is left out, of the whole surface.
    amount
        The share in words, to the digits that the patches support.
    colours
        That stand for it.
    """

    label: str
    share: float
    amount: str
    colours: tuple[Colour, ...]


Legend = Callable[[NDArray[np.uint8], str, Sequence[LegendRow]], NDArray[np.uint8]]
"""Adds a title and the lines of a legend to a picture of shape (height, width, 3), below it."""

# Okabe and Ito, Color Universal Design (2008): apart with any colour vision
_REASONS = (
    (Blind.CONTRAST, "contrast under noise", (240, 228, 66)),
    (Blind.SATURATED, "saturated by a light", (213, 94, 0)),
    (Blind.SHADOWED, "shadowed", (11, 60, 93)),
    (Blind.GRAZING, "left out: seen at a grazing angle", (204, 121, 167)),
    (Blind.CAMERA, "never seen by the camera", (201, 206, 214)),
)
_NEVER_SOME = (Blind.GRAZING, Blind.CAMERA)


def _pale(colour: Colour) -> Colour:
    red, green, blue = ((channel + 255) // 2 for channel in colour)
    return red, green, blue


BLIND_CLASSES: tuple[BlindClass, ...] = (
    BlindClass(code=Blind.SEEN, some_seen=True, label="seen", colour=(86, 180, 233)),
    *(
        BlindClass(
            code=code,
            some_seen=some,
            label=f"{label}, other defects seen" if some else label,
            colour=_pale(colour) if some else colour,
        )
        for code, label, colour in _REASONS
        for some in ((False,) if code in _NEVER_SOME else (False, True))
    ),
)
"""Where all defects are seen, and each reason: in its own colour where no defect is seen, pale where others are."""


def blind_class(code: int) -> BlindClass:
    """The class of a code where no defect is seen, or where all are."""
    return next(one for one in BLIND_CLASSES if one.code == min(code, Blind.SATURATED))


def blind_classes(spots: BlindSpots) -> NDArray[np.uint8]:
    """Class of each patch, indices into :data:`BLIND_CLASSES`, shape (n,)."""
    codes, some = np.minimum(spots.codes, Blind.SATURATED), spots.share > 0.0
    classes = np.zeros(len(codes), np.uint8)
    for index, one in enumerate(BLIND_CLASSES):
        classes[(codes == one.code) & ((some == one.some_seen) | (one.code in _NEVER_SOME))] = index
    return classes


def blind_legend(spots: BlindSpots) -> tuple[LegendRow, ...]:
    """What is seen, and every reason that there is, with the colours that stand for it."""
    shares = dict.fromkeys(Blind, 0.0)
    shares[Blind.SEEN], shares[Blind.GRAZING] = spots.seen, spots.left_out
    for code, share in spots.by_reason().items():
        shares[Blind(min(code, Blind.SATURATED))] += share
    rows = [
        LegendRow(
            label=blind_class(code).label,
            share=shares[code],
            amount=share_text(shares[code], spots.grain),
            colours=tuple(one.colour for one in BLIND_CLASSES if one.code == code),
        )
        for code in (Blind.SEEN, *(code for code, *_ in _REASONS))
    ]
    return tuple(row for row in rows if row.share > 0.0 or row is rows[0])
