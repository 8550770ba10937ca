"""A pattern as a picture: its mean over each pixel of a display."""

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.lights._pattern import PICTURE, Pattern


def pattern_picture(pattern: Pattern, size: tuple[float, float], pixels: tuple[int, int]) -> Float64:
    """Mean of a pattern over each pixel of a display, exact, shape (rows, columns).

    size: Of the display along `across` and `along` [mm]
    pixels: Columns and rows; as :func:`picture_light` has them, row 0 is at the greatest v, column 0 at the greatest u
    """
    sums = [np.zeros(count) for count in pixels]
    shown = np.zeros(pixels[::-1])
    for term in pattern.terms:
        axis = int(term[1])
        if axis == PICTURE:
            first, rows, columns = pattern.levels[int(term[2]) - 1, 0]
            values = pattern.values[first : first + rows * columns].reshape(rows, columns).astype(np.float64)
            shown += term[0] * (_shares(pixels[1], rows) @ values @ _shares(pixels[0], columns).T)
            continue
        edges = size[axis] * (0.5 - np.arange(pixels[axis] + 1) / pixels[axis])
        sums[axis] += term[0] * _means(edges, wave=term[2], phase=term[3], duty=term[4])
    return shown + sums[1][:, None] + sums[0][None, :]


def _shares(pixels: int, of: int) -> Float64:
    # how much of each pixel is within each of so many others on the same side, shape (pixels, of)
    ends, others = np.arange(pixels + 1) / pixels, np.arange(of + 1) / of
    low = np.maximum(ends[:-1, None], others[None, :-1])
    high = np.minimum(ends[1:, None], others[None, 1:])
    return np.maximum(0.0, high - low) * pixels


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
