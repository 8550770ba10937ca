"""Blocks of rows that threads work on, and a Gaussian filter of tiles that fit a processor's cache."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.kernels import kernel

Float32 = NDArray[np.float32]

BLOCK_ROWS = 64
"""Rows that a thread works on at once."""

TILE_COLUMNS = 256
"""Of as many columns of these."""

REACH = 4.0
"""Gaussians are cut off at so many standard deviations."""


def gaussian_taps(scale: float) -> Float32:
    """Weights of a Gaussian of a width [px], their sum 1, shape (2r + 1,)."""
    reach = math.ceil(REACH * scale)
    taps = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / scale))
    return (taps / taps.sum()).astype(np.float32)


def row_blocks(height: int) -> range:
    """First rows of the blocks of an image."""
    return range(0, height, BLOCK_ROWS)


@kernel
def filter_tile(image: NDArray[Any], taps: Float32, top: int, left: int, result: Float32) -> None:
    """Write part of an image correlated with the same weights along both axes; kernels may call it.

    Parameters
    ----------
    image
        Numbers or flags, shape (H, W).
    taps
        Shape (2r + 1,), the same from either end.
    top, left
        First row and column of the part.
    result
        To write to, of the part's shape (h, w).
    """
    reach = len(taps) // 2
    rows, columns = result.shape
    around = np.zeros((rows + 2 * reach, columns + 2 * reach), np.float32)
    first, last = max(0, left - reach), min(image.shape[1], left + columns + reach)
    for y in range(max(0, top - reach), min(image.shape[0], top + rows + reach)):
        for x in range(first, last):
            around[y - top + reach, x - left + reach] = image[y, x]
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
