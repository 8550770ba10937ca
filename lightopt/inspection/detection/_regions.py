"""Connected regions of high scores, split where wide Gaussians joined neighbouring defects."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.kernels import kernel
from lightopt.inspection._row_blocks import gaussian_taps
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._score import SCALES_PX, smoothed_deviations

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


Bool = NDArray[np.bool_]

PEAK_SHARE = 0.08
"""Of a region remains what is above this share of the greatest score around, and its core: sums over Gaussians spread
a strong defect beyond its outline …"""

SPREAD_PX = 10
"""… as far as this, the widest."""

OUTLINE_SHARE = 0.35
"""A defect reaches to where, under any light, the sum over the narrowest Gaussian is this share of the greatest of its
sign around: what a wall darkens counts beside the glint of the wall across."""

SHOWN_Z = 4.0
"""A light shows a defect where a sum over a Gaussian is this many standard deviations off."""


def sums_in(
    found: Deviations, box: tuple[slice, slice], scales: Sequence[float] = SCALES_PX
) -> list[Float32]:
    """Sums over Gaussians in a box of pixels, from what lies around it as far as the Gaussians reach.

    Parameters
    ----------
    found
        Of a posture.
    box
        Rows and columns.
    scales
        Widths of the Gaussians [px].

    Returns
    -------
        Of each Gaussian, of shape (lights, rows, columns).
    """
    reach = len(gaussian_taps(max(scales))) // 2
    rows, columns = (slice(max(0, side.start - reach), side.stop + reach) for side in box)
    wide_box = (slice(None), rows, columns)
    around = Deviations(found.z[wide_box], found.scale[wide_box], found.usable[wide_box], found.lit[wide_box])
    inner = tuple(
        slice(side.start - wide.start, side.stop - wide.start)
        for side, wide in zip(box, (rows, columns), strict=True)
    )
    return [smoothed_deviations(around, scale, threads=1)[0][(slice(None), *inner)] for scale in scales]


def core_pixels(region: Bool, fine: Float32) -> Bool:
    """Pixels of a region whose own deviation is not only that of neighbours, spread by sums; shape of the region.

    Parameters
    ----------
    region
        In its box.
    fine
        Sums over the narrowest Gaussian in the same box, shape (lights, rows, columns).
    """
    nothing = np.float32(0.0)
    core = np.zeros_like(region)
    for one in (*fine, *-fine):
        size = np.where(region, np.maximum(one, nothing), nothing)
        if float(size.max()) >= SHOWN_Z:
            around = ndimage.maximum_filter(size, 2 * SPREAD_PX + 1)
            core |= (size >= OUTLINE_SHARE * around) & (around >= SHOWN_Z)
    if core.any():
        return core
    # shown by no light alone, but by wider sums or by several lights
    size = np.where(region, np.abs(fine).max(axis=0), nothing)
    return region & (size >= OUTLINE_SHARE * ndimage.maximum_filter(size, 2 * SPREAD_PX + 1))


def separate_pieces(
    labels: NDArray[np.int32], count: int, score: Float32, found: Deviations, high: float
) -> tuple[NDArray[np.int32], int]:
    """Take off what sums only spread, and divide regions whose cores lie apart, where each piece would be a region.

    Parameters
    ----------
    labels, count
        From :func:`find_regions`.
    score
        That they were found in, shape (H, W).
    found
        Of the posture.
    high
        Threshold of the score.

    Returns
    -------
        Labels and number as given, pieces of a region one after the other.
    """
    result, number = np.zeros_like(labels), 0
    boxes = cast("list[tuple[slice, slice]]", ndimage.find_objects(labels, count))  # each region has its peak
    for own, box in enumerate(boxes, start=1):
        region = labels[box] == own
        core = core_pixels(region, *sums_in(found, box, SCALES_PX[:1]))
        within = np.where(region, score[box], np.float32(0.0))
        region &= core | (within >= PEAK_SHARE * ndimage.maximum_filter(within, 2 * SPREAD_PX + 1))
        pieces, most = _pieces(core)
        peak = ndimage.maximum(np.where(region, score[box], 0.0), pieces, np.arange(1, most + 1))
        kept = 1 + np.flatnonzero(np.asarray(peak) >= high)
        if len(kept) < 2:
            result[box][region] = number + 1
            number += 1
            continue
        new = np.zeros(most + 1, np.int32)
        new[kept] = number + np.arange(1, len(kept) + 1, dtype=np.int32)
        seeds = new[pieces]
        # what is between them goes to the nearest
        nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
        row, column = cast("tuple[NDArray[np.int32], NDArray[np.int32]]", nearest)
        result[box][region] = seeds[row, column][region]
        number += len(kept)
    return result, number


def _pieces(core: Bool) -> tuple[NDArray[np.int32], int]:
    # numbered; those within GAP_PX are one, as in find_regions: a dent shows at its walls, and not in its middle
    side = np.arange(-GAP_PX, GAP_PX + 1)
    disc = np.hypot(side[:, None], side) <= GAP_PX + 0.5
    padded = np.pad(core, GAP_PX)
    near = ndimage.binary_dilation(padded, disc)
    number = np.zeros(near.shape, np.int32)
    most = int(ndimage.label(near, np.ones((3, 3)), output=number))  # pyright: ignore[reportArgumentType]
    inner = number[GAP_PX:-GAP_PX, GAP_PX:-GAP_PX]
    return np.where(core, inner, 0).astype(np.int32), most
