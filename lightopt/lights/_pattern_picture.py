"""A pattern as a picture: its mean over each pixel of a display."""

import math

import numpy as np

from lightopt.core.arrays import Float64


def pattern_picture(pattern: Float64, size: tuple[float, float], pixels: tuple[int, int]) -> Float64:
    """Mean of a pattern over each pixel of a display, exact, shape (rows, columns).

    pattern: Its terms, as :mod:`lightopt.lights` has them
    size: Of the display along `across` and `along` [mm]
    pixels: Columns and rows; as :func:`picture_light` has them, row 0 is at the greatest v, column 0 at the greatest u
    """
    sums = [np.zeros(count) for count in pixels]
    for term in pattern:
        axis = int(term[1])
        edges = size[axis] * (0.5 - np.arange(pixels[axis] + 1) / pixels[axis])
        sums[axis] += term[0] * _means(edges, wave=term[2], phase=term[3], duty=term[4])
    return sums[1][:, None] + sums[0][None, :]


def _means(edges: Float64, *, wave: float, phase: float, duty: float) -> Float64:
    # means of a term without its coefficient between neighbouring edges [mm]
    if wave == 0.0:
        return np.full(len(edges) - 1, math.cos(phase))
    at = wave * edges + phase
    if duty == 0.0:
        return np.diff(np.sin(at)) / np.diff(at)
    # bars up to a place: whole ones, and the share of the last one
    turns = at / (2.0 * math.pi) + 0.5 * duty
    whole = np.floor(turns)
    return np.diff(whole * duty + np.minimum(turns - whole, duty)) / np.diff(turns)
