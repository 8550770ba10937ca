"""Images in blocks: rows for threads, boxes around masks, sums over squares, a Gaussian filter of small tiles."""

import itertools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads

T = TypeVar("T")
BLOCK_ROWS = 64  # rows that a thread works on at once
TILE_COLUMNS = 256  # of as many columns of these
REACH = 4.0  # gaussians are cut off at so many standard deviations


def in_row_blocks(work: Callable[[slice], T], height: int, threads: int | None) -> list[T]:
    """Results of `work` for each block of rows from the top down, worked out in threads."""
    return in_threads(work, _row_blocks(height), threads)


def in_image_blocks(work: Callable[[int, slice], None], images: int, height: int, threads: int | None) -> None:
    """Call `work` with the number of each image and each block of its rows, in threads."""
    in_threads(lambda block: work(*block), list(itertools.product(range(images), _row_blocks(height))), threads)


def _row_blocks(height: int) -> list[slice]:
    return [slice(top, min(top + BLOCK_ROWS, height)) for top in range(0, height, BLOCK_ROWS)]


def mask_window(mask: Bool) -> tuple[slice, slice]:
    """Rows and columns that hold a mask of shape (H, W); empty slices for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def block_sums(values: Float64 | Float32 | Bool, side: int) -> Float64:
    """Sums over squares of so many pixels; beyond the last row and column is nothing."""
    whole = np.pad(values, [(0, -size % side) for size in values.shape])
    rows, columns = whole.shape
    return whole.reshape(rows // side, side, columns // side, side).sum(axis=(1, 3), dtype=np.float64)


def gaussian_taps(scale: float) -> Float32:
    """Weights of a Gaussian of a standard deviation [px], their sum 1, shape (2r + 1,)."""
    reach = math.ceil(REACH * scale)
    taps = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / scale))
    return (taps / taps.sum()).astype(np.float32)


def convolve(image: Float64, weights: Float64) -> Float64:
    """Convolve an image, shape (H, W), with weights of an odd square; beyond the image's border is nothing."""
    shape = [fft.next_fast_len(n + t - 1, real=True) for n, t in zip(image.shape, weights.shape, strict=True)]
    reach = weights.shape[0] // 2
    full = np.asarray(fft.irfft2(np.asarray(fft.rfft2(image, shape)) * np.asarray(fft.rfft2(weights, shape)), shape))
    return full[reach : reach + image.shape[0], reach : reach + image.shape[1]]


@kernel
def filter_tile(image: NDArray[Any], taps: Float32, top: int, left: int, most: float, result: Float32) -> None:
    """Write to `result`, shape (h, w), a tile of an image correlated with the same weights along both axes.

    Beyond the image's border is nothing. Several times as fast as SciPy's correlation of the whole image, and sums are
    in single precision. Kernels may call it.

    image: numbers or flags, shape (H, W).
    taps: shape (2r + 1,), the same from either end.
    top, left: first row and column of the tile.
    most: numbers further from 0 count as this much.
    """
    reach, bound = len(taps) // 2, np.float32(most)
    rows, columns = result.shape
    around = np.zeros((rows + 2 * reach, columns + 2 * reach), np.float32)
    first, last = max(0, left - reach), min(image.shape[1], left + columns + reach)
    for y in range(max(0, top - reach), min(image.shape[0], top + rows + reach)):
        for x in range(first, last):
            around[y - top + reach, x - left + reach] = min(max(np.float32(image[y, x]), -bound), bound)
    down = np.empty(columns + 2 * reach, np.float32)
    across = np.empty(columns, np.float32)
    for y in range(rows):
        middle = around[y + reach]
        for x in range(len(down)):
            down[x] = taps[reach] * middle[x]
        for j in range(1, reach + 1):
            tap, above, below = taps[reach + j], around[y + reach - j], around[y + reach + j]
            for x in range(len(down)):
                down[x] += tap * (above[x] + below[x])
        for x in range(columns):
            across[x] = taps[reach] * down[reach + x]
        for j in range(1, reach + 1):
            # slices, so that the compiler sees that no index is negative
            tap, before, after = taps[reach + j], down[reach - j :], down[reach + j :]
            for x in range(columns):
                across[x] += tap * (before[x] + after[x])
        result[y] = across
