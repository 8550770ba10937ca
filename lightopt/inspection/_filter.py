"""Separable filters of images, compiled and spread over threads; nothing lies beyond an image's border."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.rendering import in_threads

__all__ = ["BLOCK_ROWS", "filtered", "gaussian_taps", "row_blocks"]

Float32 = NDArray[np.float32]

BLOCK_ROWS = 64
"""Rows that a thread works on at once."""

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


def filtered(image: Float32, taps: Float32, *, threads: int | None = None) -> Float32:
    """An image correlated with the same weights along both axes, shape (H, W).

    Parameters
    ----------
    image
        Shape (H, W).
    taps
        Shape (2r + 1,).
    threads
        Number of threads; the result does not depend on it.
    """
    image = np.ascontiguousarray(image)
    down, result = np.empty_like(image), np.empty_like(image)

    def block(top: int) -> None:
        bottom = min(top + BLOCK_ROWS, len(image))
        _down(image, taps, top, bottom, down)
        _across(down, taps, top, bottom, result)

    in_threads(block, row_blocks(len(image)), threads)
    return result


@kernel
def _down(image: Float32, taps: Float32, top: int, bottom: int, result: Float32) -> None:
    height, width = image.shape
    reach = len(taps) // 2
    for y in range(top, bottom):
        for x in range(width):
            result[y, x] = np.float32(0.0)
        for j in range(max(-reach, -y), min(reach, height - 1 - y) + 1):
            tap = taps[reach + j]
            for x in range(width):
                result[y, x] += tap * image[y + j, x]


@kernel
def _across(image: Float32, taps: Float32, top: int, bottom: int, result: Float32) -> None:
    width = image.shape[1]
    reach = len(taps) // 2
    for y in range(top, bottom):
        for x in range(width):
            result[y, x] = np.float32(0.0)
        for j in range(-reach, reach + 1):
            # slices, so that the compiler sees that no index is negative
            tap, left, right = taps[reach + j], max(0, -j), min(width, width - j)
            sums, source = result[y, left:right], image[y, left + j : right + j]
            for x in range(len(sums)):
                sums[x] += tap * source[x]
