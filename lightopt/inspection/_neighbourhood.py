"""What is known of the surroundings of a pixel or an edge stands for what is not known of itself."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.core.threads import in_threads
from lightopt.inspection._filter import BLOCK_ROWS, filter_tile, gaussian_taps, row_blocks

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

PRIOR_PX = 15.0
BLOCK_PX = 4
"""Where no image tells a gradient, it is taken to be about as large as those around, Gaussian of this width, which are
added up in blocks of this side first."""


def typical_size(gradient: Float64, unknown: Bool) -> Float32:
    """How large gradients are around each edge: root mean square of the known ones, by blocks of edges.

    Parameters
    ----------
    gradient
        Difference at each edge, shape (h, w).
    unknown
        Edges whose difference is not known, same shape.
    """
    known = ~unknown
    square = np.where(known, np.square(gradient), 0.0)
    typical = math.sqrt(float(square.sum()) / max(float(known.sum()), 1.0))
    shares, squares = (
        ndimage.gaussian_filter(_in_blocks(values), PRIOR_PX / BLOCK_PX) for values in (known, square)
    )
    prior = np.where(shares > 1e-3, np.sqrt(squares / np.maximum(shares, 1e-3)), typical).astype(np.float32)
    rows, columns = gradient.shape
    return prior.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)[:rows, :columns]


def _in_blocks(values: Float64 | Bool) -> Float64:
    # means of blocks; beyond the last row and column is nothing
    rows, columns = (-(-side // BLOCK_PX) * BLOCK_PX for side in values.shape)
    whole = np.zeros((rows, columns))
    whole[: values.shape[0], : values.shape[1]] = values
    return whole.reshape(rows // BLOCK_PX, BLOCK_PX, columns // BLOCK_PX, BLOCK_PX).mean(axis=(1, 3))


def smoothed(values: Float64, mask: Bool, width: float, threads: int | None = None) -> Float64:
    """Means over a Gaussian of a width [px], of the pixels of a mask alone; shape of `values`.

    Parameters
    ----------
    values
        Shape (H, W); none counts outside of the mask.
    mask
        Same shape.
    width
        Standard deviation [px].
    threads
        Number of threads; the result does not depend on it.
    """
    taps = gaussian_taps(width)
    inside = np.where(mask, values, 0.0).astype(np.float32)
    share, total = np.empty_like(inside), np.empty_like(inside)

    def block(top: int) -> None:
        rows = slice(top, top + BLOCK_ROWS)
        filter_tile(mask, taps, top, 0, share[rows])
        filter_tile(inside, taps, top, 0, total[rows])

    in_threads(block, row_blocks(len(mask)), threads)
    return total.astype(np.float64) / np.maximum(share, 1e-3)
