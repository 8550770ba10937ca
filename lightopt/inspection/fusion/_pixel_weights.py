"""How much each pixel of an image shows the surface: nothing in highlights, on their flanks and in shadows."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32
from lightopt.inspection._image_blocks import in_image_blocks

BLOOMING_PX = 2
"""Pixels this near to a saturated one do not count: charge, glare and lens spread there."""

LIT = 3.0
"""A pixel that is predicted to be less than this many standard deviations of noise above black is in shadow."""


def pixel_weights(
    saturated: Bool,
    predicted: Float32,
    specular: Float32,
    deviations: Float32,
    limit: Float32,
    *,
    threads: int | None = None,
) -> Float32:
    """How much each pixel of each image shows the surface and not a highlight or a shadow, 0 to 1.

    0 where it is saturated or predicted to be, and next to that; 0 in shadow; the less the steeper the flank of the
    highlight that is predicted there.

    Parameters
    ----------
    saturated
        As measured, shape (images, H, W).
    predicted, specular
        Levels of the good part, and the highlights' share of them [grey level], same shape.
    deviations
        Standard deviation of the noise [grey level], same shape.
    limit
        Level from which a pixel is saturated [grey level], same shape.
    """
    weights = np.empty(predicted.shape, np.float32)
    images, height, _ = predicted.shape

    def weigh(i: int, rows: slice) -> None:
        # with the rows around that dilation and gradients need
        above = max(0, rows.start - BLOOMING_PX)
        around = slice(above, rows.stop + BLOOMING_PX)
        inner = slice(rows.start - above, rows.stop - above)
        full = saturated[i, around] | (predicted[i, around] >= limit[i, around])
        hidden = np.asarray(ndimage.maximum_filter(full, 2 * BLOOMING_PX + 1), np.bool_)[inner]
        down, right = (np.asarray(g, np.float64)[inner] for g in np.gradient(specular[i, around]))
        noise = deviations[i, rows]
        hidden |= predicted[i, rows] < LIT * noise.astype(np.float64)
        weights[i, rows] = np.where(
            hidden, 0.0, 1.0 / (1.0 + (down * down + right * right) / (noise * noise))
        )

    in_image_blocks(weigh, images, height, threads)
    return weights
