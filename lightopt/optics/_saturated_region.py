"""The saturated region of an image: how large it is and how long its border."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64


@dataclass(frozen=True, kw_only=True)
class SaturatedRegion:
    """Area and perimeter of the saturated pixels, by which the paper compares images (section 4.4)."""

    area: int  # number of pixels at or above the saturation level [px]
    perimeter: float  # length of the line at the saturation level, interpolated between pixel centres [px]


def saturated_region(levels: NDArray[Any], saturation_level: float) -> SaturatedRegion:
    """Area and perimeter of the region at or above a level.

    levels: Image, linear or as the camera delivers it, shape (height, width)
    saturation_level: In the units of `levels`
    """
    above = np.asarray(levels) >= saturation_level
    excess = np.pad(np.asarray(levels, dtype=np.float64) - saturation_level, 1, constant_values=-1.0)
    # of the image's highlights only the place of the border counts, not how far they rise above it
    excess = np.clip(excess, -1e6, 1e6)
    return SaturatedRegion(area=int(above.sum()), perimeter=_contour_length(excess))


def _contour_length(values: Float64) -> float:
    # marching squares: straight segments of the line where values are 0 cross every 2 × 2 square of pixel centres
    corners = (values[:-1, :-1], values[:-1, 1:], values[1:, 1:], values[1:, :-1])
    mixed = np.any([(corner >= 0.0) != (corners[0] >= 0.0) for corner in corners[1:]], axis=0)
    a, b, c, d = (corner[mixed] for corner in corners)
    total = 0.0
    zero, one = np.zeros_like(a), np.ones_like(a)
    top, right = (_crossing(a, b), zero), (one, _crossing(b, c))
    bottom, left = (_crossing(d, c), one), (zero, _crossing(a, d))
    inside = [corner >= 0.0 for corner in (a, b, c, d)]
    around = ((left, top), (top, right), (right, bottom), (bottom, left))
    for corner, (one_side, other_side) in enumerate(around):
        own, next_, across, previous = (inside[(corner + k) % 4] for k in range(4))
        # a corner cut off from both its neighbours; of a diagonal pair, the two inside corners
        alone = (own != next_) & (own != previous) & ((own != across) | own)
        total += _length(one_side, other_side, alone)
    split = (inside[0] == inside[1]) & (inside[2] == inside[3]) & (inside[0] != inside[2])
    total += _length(left, right, split)
    split = (inside[0] == inside[3]) & (inside[1] == inside[2]) & (inside[0] != inside[1])
    return total + _length(top, bottom, split)


def _crossing(first: Float64, second: Float64) -> Float64:
    # share of the way from the first corner to the second where the value passes zero; meaningless where it does not
    difference = first - second
    return np.clip(first / np.where(difference == 0.0, 1.0, difference), 0.0, 1.0)


def _length(start: tuple[Float64, Float64], end: tuple[Float64, Float64], where: Bool) -> float:
    return float(np.hypot(start[0] - end[0], start[1] - end[1])[where].sum())
