"""Defects in the synthetic image: matched filters for dots and lines (paper, section 2.2)."""

import math

import numpy as np
from scipy import ndimage, special

from lightopt.core.arrays import Float32, Float64
from lightopt.inspection._image_blocks import convolve
from lightopt.inspection.detection._deviation import CLIPPED, MEAN_OF_NORMAL
from lightopt.inspection.fusion._synthetic_image import SyntheticImage

DOT_PX = (1.0, 2.0, 4.0)
LINE_PX = (1.2, 5.0)
LINE_DIRECTIONS = 8
TEMPLATES = len(DOT_PX) + LINE_DIRECTIONS
"""Dots: the negative Laplacian of Gaussians of these widths; lines: the second derivative across Gaussians of this
width and length, in so many directions."""

# the response is measured in units of what its surroundings show, as deviations of the other detector are
LOCAL_PX = 18.0

MEDIAN_PX = 3
BORDER_PX = 3.0  # nothing is scored within this distance of the border of the mask


def templates() -> tuple[Float64, ...]:
    """The templates: mean 0, sum of squares 1, square of odd side."""
    dots = [_dot(scale) for scale in DOT_PX]
    lines = [_line(*LINE_PX, math.pi * i / LINE_DIRECTIONS) for i in range(LINE_DIRECTIONS)]
    return (*dots, *lines)


def score_templates(image: SyntheticImage) -> Float32:
    """−log₁₀ of the probability that a place of even texture answers to a template as strongly, shape (H, W).

    image: Without highlights.
    """
    mask = image.mask
    if not mask.any():
        return np.zeros(mask.shape, np.float32)
    # beyond the mask goes on what is nearest in it, so that its border is no edge
    nearest = ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    assert nearest is not None
    level = ndimage.median_filter(image.level[tuple(nearest)], MEDIAN_PX).astype(np.float64)
    score = np.zeros(mask.shape, np.float32)
    within = np.asarray(ndimage.distance_transform_edt(mask), np.float64)
    inner = mask & ~image.filled & (within > BORDER_PX)
    if not inner.any():
        return score
    share = np.maximum(ndimage.gaussian_filter(inner.astype(np.float64), LOCAL_PX), 1e-6)
    for template in templates():
        # the mean goes first: what lies beyond the image's border is 0
        answer = convolve(level - level.mean(), template)
        spread = float(np.median(np.abs(answer[inner]))) / 0.6745
        size = np.where(inner, np.minimum(np.abs(answer), CLIPPED * max(spread, 1e-9)), 0.0)
        local = ndimage.gaussian_filter(size, LOCAL_PX) / share / MEAN_OF_NORMAL
        z = np.abs(answer) / np.maximum(np.maximum(local, 0.5 * spread), 1e-9)
        chance = 2.0 * special.ndtr(-np.minimum(z, 25.0))
        np.maximum(score, np.where(inner, -np.log10(chance), 0.0), out=score, casting="unsafe")
    return score


def _dot(scale: float) -> Float64:
    reach = math.ceil(3.5 * scale)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    square = (x * x + y * y) / scale**2
    return _normal((2.0 - square) * np.exp(-0.5 * square))


def _line(width: float, length: float, direction: float) -> Float64:
    reach = math.ceil(3.0 * length)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    along = (math.cos(direction) * x + math.sin(direction) * y) / length
    across = (math.cos(direction) * y - math.sin(direction) * x) / width
    return _normal((1.0 - across**2) * np.exp(-0.5 * (along**2 + across**2)))


def _normal(template: Float64) -> Float64:
    template = template - template.mean()
    return template / np.sqrt(np.sum(template**2))
