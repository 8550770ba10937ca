"""Connected regions of high scores, split where wide Gaussians joined neighbouring defects."""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Index, Int32
from lightopt.inspection._image_blocks import gaussian_taps
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import SCALES_PX, smoothed_deviations

LOW_SHARE = 0.5  # a region spreads from where it is certain to where its score is above this share of the threshold
GAP_PX = 3  # pixels this near to each other belong to one defect: a dent shows at its walls, and not in its middle

# of a region remains what is above this share of the greatest score around, and its core: sums over Gaussians spread a
# strong defect beyond its outline …
PEAK_SHARE = 0.08

SPREAD_PX = 10  # … as far as this, the widest

# a defect reaches to where, under any light, the sum over the narrowest Gaussian is this share of the greatest of its
# sign around: what a wall darkens counts beside the glint of the wall across
OUTLINE_SHARE = 0.35

SHOWN_Z = 4.0  # a light shows a defect where a sum over a Gaussian is this many standard deviations off

_DISC = np.hypot(*np.mgrid[-GAP_PX : GAP_PX + 1, -GAP_PX : GAP_PX + 1]) <= GAP_PX + 0.5


def find_regions(score: Float32, high: float) -> tuple[Int32, int]:
    """Number of the region that each pixel belongs to, 0 for none, shape (H, W), and how many there are.

    Hysteresis: a region has a pixel of at least `high`, and spreads over what is connected to it and lower.

    score: Shape (H, W).
    high: Threshold.
    """
    low = score >= LOW_SHARE * high
    number, count = _label(_dilated(low)[GAP_PX:-GAP_PX, GAP_PX:-GAP_PX])
    own = number[low]
    peak = np.zeros(count + 1)
    np.maximum.at(peak, own, score[low])
    certain = 1 + np.flatnonzero(peak[1:] >= high)
    new = np.zeros(count + 1, np.int32)
    new[certain] = np.arange(1, len(certain) + 1, dtype=np.int32)
    labels = np.zeros(score.shape, np.int32)
    labels[low] = new[own]
    return labels, len(certain)


def _dilated(mask: Bool) -> Bool:
    # pixels within GAP_PX of a mask, with a border of as many pixels; of few pixels a small part of SciPy's time
    dilated = np.zeros([side + 2 * GAP_PX for side in mask.shape], np.bool_)
    row, column = np.nonzero(mask)
    for down, right in np.argwhere(_DISC):
        dilated[row + down, column + right] = True
    return dilated


def _label(mask: Bool) -> tuple[Int32, int]:
    # connected components, across corners too
    number = np.zeros(mask.shape, np.int32)
    return number, int(ndimage.label(mask, np.ones((3, 3)), output=number))  # pyright: ignore[reportArgumentType]


def region_pixels(labels: Int32, count: int) -> list[tuple[Index, Index]]:
    """Rows and columns of each region's pixels, the first region first, in one pass over the image."""
    row, column = np.nonzero(labels)
    number = labels[row, column]
    order = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[order], np.arange(1, count + 2))
    return [(row[order[a:b]], column[order[a:b]]) for a, b in pairwise(ends)]


def box_sums(found: Deviations, box: tuple[slice, slice], scales: Sequence[float] = SCALES_PX) -> list[Float32]:
    """Sums over Gaussians in a box of pixels, from what lies around it as far as the Gaussians reach.

    scales: widths of the Gaussians [px].
    Returns Of each Gaussian, of shape (lights, rows, columns).
    """
    reach = len(gaussian_taps(max(scales))) // 2
    rows, columns = (slice(max(0, side.start - reach), side.stop + reach) for side in box)
    around = found.in_box(rows, columns)
    inner = tuple(
        slice(side.start - wide.start, side.stop - wide.start) for side, wide in zip(box, (rows, columns), strict=True)
    )
    return [smoothed_deviations(around, scale, threads=1)[0][(slice(None), *inner)] for scale in scales]


def core_pixels(region: Bool, fine: Float32) -> Bool:
    """Pixels of a region whose own deviation is not only that of neighbours, spread by sums; shape of the region.

    fine: sums over the narrowest Gaussian in the same box, shape (lights, rows, columns).
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


def split_regions(labels: Int32, count: int, score: Float32, found: Deviations, high: float) -> tuple[Int32, int]:
    """Take off what sums only spread, and split regions whose cores lie apart, where each core would be a region.

    score: That they were found in, shape (H, W).
    high: Threshold of the score.
    Returns Labels and number as given, parts of a region one after the other.
    """
    result, number = np.zeros_like(labels), 0
    boxes = cast("list[tuple[slice, slice]]", ndimage.find_objects(labels, count))  # each region has its peak
    for own, box in enumerate(boxes, start=1):
        region = labels[box] == own
        core = core_pixels(region, *box_sums(found, box, SCALES_PX[:1]))
        within = np.where(region, score[box], np.float32(0.0))
        region &= core | (within >= PEAK_SHARE * ndimage.maximum_filter(within, 2 * SPREAD_PX + 1))
        cores, most = _core_components(core)
        peak = ndimage.maximum(np.where(region, score[box], 0.0), cores, np.arange(1, most + 1))
        certain = 1 + np.flatnonzero(np.asarray(peak) >= high)
        if len(certain) < 2:
            result[box][region] = number + 1
            number += 1
            continue
        new = np.zeros(most + 1, np.int32)
        new[certain] = number + np.arange(1, len(certain) + 1, dtype=np.int32)
        seeds = new[cores]
        # what is between them goes to the nearest
        nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
        row, column = cast("tuple[Int32, Int32]", nearest)
        result[box][region] = seeds[row, column][region]
        number += len(certain)
    return result, number


def _core_components(core: Bool) -> tuple[Int32, int]:
    # numbered; those within GAP_PX of each other are one, as in find_regions
    number, count = _label(_dilated(core))
    return np.where(core, number[GAP_PX:-GAP_PX, GAP_PX:-GAP_PX], 0).astype(np.int32), count
