"""Connected regions of high scores."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.kernels import kernel

Float32 = NDArray[np.float32]

LOW_SHARE = 0.5
"""A region spreads from where it is certain to where its score is above this share of the threshold."""

GAP_PX = 3
"""Pieces this near to each other are one defect: a dent shows at its walls, and not in its middle."""


def find_regions(score: Float32, high: float) -> tuple[NDArray[np.int32], int]:
    """Number of the region that each pixel belongs to, 0 for none, shape (H, W), and how many there are.

    Hysteresis: a region has a pixel of at least `high`, and spreads over what is connected to it and lower.

    Parameters
    ----------
    score
        Shape (H, W).
    high
        Threshold.
    """
    low = np.flatnonzero(score >= LOW_SHARE * high)
    near = np.zeros(score.shape, np.uint8)
    side = np.arange(-GAP_PX, GAP_PX + 1)
    reach = np.floor(np.sqrt((GAP_PX + 0.5) ** 2 - side**2)).astype(np.int64)
    _spread(low, reach, near)
    number = np.zeros(score.shape, np.int32)
    count = int(ndimage.label(near, np.ones((3, 3)), output=number))  # pyright: ignore[reportArgumentType]
    own, value = number.ravel()[low], score.ravel()[low]
    peak = np.zeros(count + 1)
    np.maximum.at(peak, own, value)
    kept = np.flatnonzero(peak >= high)
    kept = kept[kept > 0]
    new = np.zeros(count + 1, np.int32)
    new[kept] = np.arange(1, len(kept) + 1, dtype=np.int32)
    labels = np.zeros(score.shape, np.int32)
    labels.ravel()[low] = new[own]
    return labels, len(kept)


def pixels_of(labels: NDArray[np.int32], count: int) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Rows and columns of each region's pixels, the first region first; looks at the image once.

    Parameters
    ----------
    labels, count
        From :func:`find_regions`.
    """
    row, column = np.nonzero(labels)
    number = labels[row, column]
    order = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[order], np.arange(1, count + 2))
    return [(row[order[a:b]], column[order[a:b]]) for a, b in pairwise(ends)]


@kernel
def _spread(places: NDArray[np.intp], reach: NDArray[np.int64], near: NDArray[np.uint8]) -> None:
    # marks all pixels within GAP_PX of those at `places`
    height, width = near.shape
    half = len(reach) // 2
    for place in places:
        y, x = place // width, place % width
        for j in range(max(-half, -y), min(half, height - 1 - y) + 1):
            for k in range(max(0, x - reach[half + j]), min(width, x + reach[half + j] + 1)):
                near[y + j, k] = 1
