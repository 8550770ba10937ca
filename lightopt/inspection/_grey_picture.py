"""Linear images as grey pictures for people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float32, UInt8

DARK, LIFTED, LEAST_POWER = 0.1, 0.25, 0.2
"""Where the middle level of the part is less than this share of white, levels are raised to the power that takes it to
the second share, but to no less than the third."""


@dataclass(frozen=True, eq=False)
class GreyPicture:
    """An image as grey: 255 · ((level − black) / (white − black)) ^ power.

    black, white: the levels that are shown black and white [grey level].
    """

    grey: UInt8
    black: float
    white: float
    power: float

    @property
    def legend(self) -> str:
        """What grey stands for."""
        black = f"black: {self.black:.3g}, " if self.black < 0.0 else ""
        stretched = (
            "" if self.power == 1.0 else f"; stretched by a power of {self.power:g}, so that dark places show"
        )
        return f"{black}white: {self.white:.3g} grey levels{stretched}"

    def as_dict(self) -> dict[str, Any]:
        """JSON form, for a picture's metadata."""
        return {
            "black_level": round(self.black, 4),
            "white_level": round(self.white, 4),
            "power": self.power,
        }


def grey_picture(level: Float32, mask: Bool) -> GreyPicture:
    """Show an image: white is the level that one in a thousand pixels exceeds, and dark images are stretched.

    level: Shape (H, W) [grey level].
    mask: Pixels that show the part; the others are black, shape (H, W).
    """
    inside = level[mask]
    white = max(float(np.percentile(inside, 99.9)), 1e-6) if inside.size else 1.0
    # gradients say nothing of the level of a dark field: integrated, it may be below black
    black = min(0.0, float(np.percentile(inside, 1.0))) if inside.size else 0.0
    share = np.where(mask, np.clip((level - black) / (white - black), 0.0, 1.0), 0.0)
    middle = float(np.median(share[mask])) if inside.size else 1.0
    power = 1.0
    if middle < DARK:
        power = max(LEAST_POWER, round(math.log(LIFTED) / math.log(max(middle, 1e-6)), 2))
    return GreyPicture((255.0 * share**power + 0.5).astype(np.uint8), black, white, power)
