"""Colours and legend of blind spots, the same in pictures, ``blind.csv``, ``blind.ply`` and report."""

from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import UInt8
from lightopt.design.blind_spots._blind_spots import BlindReason, BlindSpots
from lightopt.design.objectives._objective import share_text

Colour = tuple[int, int, int]  # red, green and blue, 0 to 255


@dataclass(frozen=True, kw_only=True)
class BlindClass:
    """Patches of one colour: why defects are not seen there, and whether others are.

    :attr:`BlindReason.SATURATED` stands for every light.
    """

    code: BlindReason
    some_seen: bool
    label: str
    colour: Colour


@dataclass(frozen=True, kw_only=True)
class LegendRow:
    """A line of a legend: label, share, the share in words, and the colours that stand for it.

    Shares are of the part's surface × defects; what is left out is a share of the whole surface.
    """

    label: str
    share: float
    amount: str
    colours: tuple[Colour, ...]


# Okabe and Ito, Color Universal Design (2008): apart with any colour vision
_REASONS = (
    (BlindReason.CONTRAST, "contrast under noise", (240, 228, 66)),
    (BlindReason.SATURATED, "saturated by a light", (213, 94, 0)),
    (BlindReason.SHADOWED, "shadowed", (11, 60, 93)),
    (BlindReason.GRAZING, "left out: seen at a grazing angle", (204, 121, 167)),
    (BlindReason.CAMERA, "never seen by the camera", (201, 206, 214)),
)
_NEVER_SOME = (BlindReason.GRAZING, BlindReason.CAMERA)


def _pale(colour: Colour) -> Colour:
    red, green, blue = ((channel + 255) // 2 for channel in colour)
    return red, green, blue


BLIND_CLASSES: tuple[BlindClass, ...] = (
    BlindClass(code=BlindReason.SEEN, some_seen=True, label="seen", colour=(86, 180, 233)),
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
"""Seen, and each reason: in its own colour where no defect is seen, pale where others are."""


def blind_class(code: int) -> BlindClass:
    """The class of a code where no defect is seen, or where all are."""
    return next(one for one in BLIND_CLASSES if one.code == min(code, BlindReason.SATURATED))


def blind_classes(spots: BlindSpots) -> UInt8:
    """Class of each patch, indices into :data:`BLIND_CLASSES`, shape (n,)."""
    codes, some = np.minimum(spots.codes, BlindReason.SATURATED), spots.share > 0.0
    classes = np.zeros(len(codes), np.uint8)
    for index, one in enumerate(BLIND_CLASSES):
        classes[(codes == one.code) & ((some == one.some_seen) | (one.code in _NEVER_SOME))] = index
    return classes


def blind_colours(spots: BlindSpots) -> UInt8:
    """Colour of each patch, shape (n, 3)."""
    return np.array([one.colour for one in BLIND_CLASSES], np.uint8)[blind_classes(spots)]


def blind_legend(spots: BlindSpots) -> tuple[LegendRow, ...]:
    """What is seen, and every reason that occurs, with the colours that stand for it."""
    shares = dict.fromkeys(BlindReason, 0.0)
    shares[BlindReason.SEEN], shares[BlindReason.GRAZING] = spots.seen, spots.left_out
    for code, share in spots.by_reason().items():
        shares[BlindReason(min(code, BlindReason.SATURATED))] += share
    rows = [
        LegendRow(
            label=blind_class(code).label,
            share=shares[code],
            amount=share_text(shares[code], spots.grain),
            colours=tuple(one.colour for one in BLIND_CLASSES if one.code == code),
        )
        for code in (BlindReason.SEEN, *(code for code, *_ in _REASONS))
    ]
    return tuple(row for row in rows if row.share > 0.0 or row is rows[0])
