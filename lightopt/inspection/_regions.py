"""Connected regions of high scores."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["find_regions", "pixels_of"]

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

LOW_SHARE = 0.5
"""A region spreads from where it is certain to where its score is above this share of the threshold …"""

PEAK_SHARE = 0.08
"""… and above this share of its own peak: sums over Gaussians spread a strong defect beyond its outline."""

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
    low = score >= LOW_SHARE * high
    side = 2 * GAP_PX + 1
    disc = np.hypot(*np.mgrid[-GAP_PX : GAP_PX + 1, -GAP_PX : GAP_PX + 1]) <= GAP_PX + 0.5
    assert disc.shape == (side, side)
    near = np.zeros(score.shape, np.int32)
    count = int(ndimage.label(ndimage.binary_dilation(low, disc), np.ones((3, 3)), output=near))  # pyright: ignore[reportArgumentType]
    near[~low] = 0
    peak = np.zeros(count + 1)
    np.maximum.at(peak, near.ravel(), score.ravel())
    near[score < PEAK_SHARE * peak[near]] = 0
    kept = np.flatnonzero(peak >= high)
    kept = kept[kept > 0]
    number = np.zeros(count + 1, np.int32)
    number[kept] = np.arange(1, len(kept) + 1, dtype=np.int32)
    return number[near], len(kept)


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
