"""The good part as its own images have it: each place has the level of its smooth neighbourhood.

A quadratic surface is fitted to the neighbourhood of each place by robust least squares, so that a defect has little
weight in its own reference (locally weighted regression: Cleveland 1979, doi:10.1080/01621459.1979.10481038). The fit
uses means of blocks of pixels, and no neighbourhood reaches over an edge or into a shadow.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.defects import SIZES, CatalogueEntry
from lightopt.inspection._image_blocks import block_sums
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.scene import Scene, pixel_footprint

# the neighbourhood is a Gaussian of this many times the width of the largest defect, and of at least so many pixels
WIDTHS, LEAST_PX = 1.5, 10.0

BLOCKS = 3.0  # blocks per standard deviation of the Gaussian
LARGEST_BLOCK_PX = 8
FULL_BLOCK = 0.5  # a block counts where at least this share of its pixels does
REACH = 3.0  # the Gaussian is cut off at so many standard deviations

MARGIN_PX = 2  # expected levels go on so far beyond an edge, so that their slope is no edge's

LEAST_BLOCKS = 18  # three for each coefficient: surfaces of fewer have no neighbourhood to compare with
ROUNDS = 6
BIWEIGHT = 4.685  # of Tukey: blocks that are further off than so many standard deviations do not count
RIDGE = 1e-4  # keeps the fit determined where the neighbourhood is a narrow strip

_POWERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))  # of the quadratic's terms, along rows and columns


def neighbourhood_px(scene: Scene, catalogue: Sequence[CatalogueEntry]) -> float:
    """Standard deviation of the neighbourhood of a place [px]: well above the widest defect of a catalogue."""
    widths = [min(entry.shape.length, entry.shape.width) * entry.sizes[1] for entry in catalogue]
    widest = max(widths, default=0.0) * max(SIZES)
    distance = float(np.linalg.norm(scene.camera.position - scene.pivot))
    return max(LEAST_PX, WIDTHS * widest / pixel_footprint(scene.camera, distance))


def neighbourhood_view(view: PostureView, width: float, *, threads: int | None = None) -> tuple[PostureView, Bool]:
    """A view whose expected levels are those of each place's neighbourhood, Gaussian of a `width` [px].

    What the model shows of a place that its neighbourhood does not, such as a highlight or the rim of a shadow, counts
    as noise. Surfaces without a neighbourhood are not evaluable.

    Returns The view, and the pixels that have a neighbourhood in each image, shape (lights, H, W): the expected levels
        go on a little beyond these.
    """
    predicted, deviation = np.zeros_like(view.predicted), view.deviation.copy()
    known = np.zeros(predicted.shape, np.bool_)

    def expect(i: int) -> None:
        lit = view.clean & (view.predicted[i] > 0.0)
        number = np.zeros(lit.shape, np.int32)
        count = int(ndimage.label(lit, output=number))  # pyright: ignore[reportArgumentType]
        level = np.minimum(view.level[i], view.limit[i])
        for label, tight in enumerate(ndimage.find_objects(number, count), 1):
            box = tuple(slice(max(0, side.start - MARGIN_PX), side.stop + MARGIN_PX) for side in tight)
            own = number[box] == label
            fits = _fit_surface(level[box], view.predicted[i][box], own & ~view.saturated[i][box], width)
            if fits is None:
                continue
            known[i][box][own] = True
            around = own | (ndimage.binary_dilation(own, iterations=MARGIN_PX) & (predicted[i][box] == 0.0))
            predicted[i][box][around] = np.maximum(fits[0][around], 1e-6)
            detail = view.predicted[i][box][own] - fits[1][own]
            deviation[i][box][own] = np.hypot(deviation[i][box][own], detail)

    in_threads(expect, range(len(predicted)), threads)
    prediction = replace(view.prediction, clean=view.clean & known.any(axis=0))
    return replace(view, predicted=predicted, deviation=deviation, prediction=prediction), known


def _fit_surface(level: Float32, model: Float32, known: Bool, width: float) -> tuple[Float32, Float32] | None:
    # the smooth surfaces of measured and predicted levels of one connected surface; None where it is too small
    side = max(1, min(LARGEST_BLOCK_PX, round(width / BLOCKS)))
    count = block_sums(known.astype(np.float64), side)
    full = count >= FULL_BLOCK * side**2
    if np.count_nonzero(full) < LEAST_BLOCKS:
        return None
    inside = (np.where(known, values, 0.0).astype(np.float64) for values in (level, model))
    means = [block_sums(values, side) / np.maximum(count, 1.0) for values in inside]
    weight = full.astype(np.float64)
    for _ in range(ROUNDS):
        (surface,) = _local_fit(width / side, weight, means[:1])
        off = np.abs(means[0] - surface[..., 0])
        spread = 1.4826 * float(np.median(off[full]))
        weight = np.where(full, np.square(np.maximum(1.0 - np.square(off / max(BIWEIGHT * spread, 1e-9)), 0.0)), 0.0)
    result = np.zeros((2, *known.shape), np.float32)
    for surface, out in zip(_local_fit(width / side, weight, means), result, strict=True):
        _blend(np.ascontiguousarray(surface), side, out)
    return result[0], result[1]


def _local_fit(width: float, weight: Float64, images: Sequence[Float64]) -> list[Float64]:
    # weighted least squares of a quadratic around each block, with Gaussian weights of a width [blocks]: coefficients
    # of the terms of each image [level per block^power], shape (h, w, 6)
    reach = math.ceil(REACH * width)
    offset = np.arange(-reach, reach + 1) / width
    taps = [np.exp(-0.5 * offset**2) * offset**power for power in range(5)]

    def moment(values: Float64, powers: tuple[int, int]) -> Float64:
        down = ndimage.correlate1d(values, taps[powers[0]], axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(down, taps[powers[1]], axis=1, mode="constant"), np.float64)

    moments = {(a, b): moment(weight, (a, b)) for a in range(5) for b in range(5 - a)}
    units = np.array([width ** -(a + b) for a, b in _POWERS])
    result: list[Float64] = []
    for image in images:
        right = np.stack([moment(weight * image, powers) for powers in _POWERS], axis=-1)
        rows: list[Float64] = []
        for row in range(len(image)):
            # a row at a time: matrices take six times as much memory as moments
            terms = [[moments[a + c, b + d][row] for c, d in _POWERS] for a, b in _POWERS]
            normal = np.moveaxis(np.array(terms), -1, 0)
            total = np.maximum(normal[:, :1, :1], 1e-6)
            normal += RIDGE * total * np.diag([1e-6, 1.0, 1.0, 1.0, 1.0, 1.0])
            rows.append(np.linalg.solve(normal, right[row][..., None])[..., 0])
        result.append(np.stack(rows) * units)
    return result


@kernel
def _blend(surface: Float64, side: int, result: Float32) -> None:
    # each pixel has the quadratics of the four blocks around it, by how near their middles are
    rows, columns, _ = surface.shape
    for y in range(result.shape[0]):
        v = min(max((y + 0.5) / side - 0.5, 0.0), rows - 1.0)
        i = min(int(v), max(rows - 2, 0))
        for x in range(result.shape[1]):
            u = min(max((x + 0.5) / side - 0.5, 0.0), columns - 1.0)
            k = min(int(u), max(columns - 2, 0))
            total = 0.0
            for down in range(2):
                for right in range(2):
                    row, column = min(i + down, rows - 1), min(k + right, columns - 1)
                    share = (1.0 - abs(v - (i + down))) * (1.0 - abs(u - (k + right)))
                    if share <= 0.0:
                        continue
                    p, q = (y + 0.5) / side - 0.5 - row, (x + 0.5) / side - 0.5 - column
                    c = surface[row, column]
                    total += share * (c[0] + c[1] * p + c[2] * q + c[3] * p * p + c[4] * p * q + c[5] * q * q)
            result[y, x] = total
