"""Patterns of lights: sums of stripes and pictures, so that lights that differ in phase share their integrals.

The terms of a pattern are an array of shape (b, TERM_NUMBERS), each a row (coefficient, axis, wave, phase, duty):
coefficient times a function of x, which is u for axis 0 and v for axis 1 [mm; rad on a dome],

    duty 0: cos(wave·x + phase), which is 1 for wave 0 and phase 0
    duty > 0: 1 where wave·x + phase is within duty·π of a multiple of 2π, else 0

Axis 2 (PICTURE) is a picture instead: (coefficient, 2, its number from 1, its width, its height [mm]).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lightopt.core.arrays import Float32, Float64, Int64

TERM_NUMBERS = 5
PICTURE = 2


class Pattern(NamedTuple):
    """What the radiance of a light is multiplied by, at each place on it."""

    terms: Float64  # shape (b, TERM_NUMBERS)
    # levels of all pictures, each in full and in means of 2 × 2, 4 × 4, ... of its pixels, one after the other
    values: Float32
    levels: Int64  # where each of these begins in `values`, its rows and its columns, shape (pictures, halvings, 3)


def _stripes(terms: list[list[float]]) -> Pattern:
    return Pattern(np.array(terms), np.zeros(0, np.float32), np.zeros((0, 0, 3), np.int64))


UNIFORM = _stripes([[1.0, 0.0, 0.0, 0.0, 0.0]])  # the pattern that is 1 everywhere


def sine_pattern(axis: int, *, period: float, phase: float) -> Pattern:
    """Stripes ½·(1 + cos(2π·x/period + phase)); [mm] or, on a dome, [rad]."""
    wave = 2.0 * math.pi / period
    cosine = [0.5 * math.cos(phase), axis, wave, 0.0, 0.0]
    sine = [-0.5 * math.sin(phase), axis, wave, -0.5 * math.pi, 0.0]
    return _stripes([[0.5, 0.0, 0.0, 0.0, 0.0], cosine, sine])


def bar_pattern(axis: int, *, period: float, phase: float, duty: float) -> Pattern:
    """Bars that take up the share `duty` of a period [mm], in the middle of one where 2π·x/period + phase is 0."""
    return _stripes([[1.0, axis, 2.0 * math.pi / period, phase, duty]])


def picture_patterns(pictures: Sequence[Float64], size: tuple[float, float]) -> list[Pattern]:
    """A pattern for each of some pictures of one light, each spread over all of it.

    pictures: Shares of the full radiance, as seen from the part with `along` upwards, shape (rows, columns) each: row 0
        is at the greatest v, column 0 at the greatest u
    size: Of the light along `across` and `along` [mm]
    """
    halvings = max(math.ceil(math.log2(max(picture.shape))) for picture in pictures) + 1
    levels, values, used = np.zeros((len(pictures), halvings, 3), np.int64), list[Float32](), 0
    for number, picture in enumerate(pictures):
        total, count = picture, np.ones(picture.shape)
        for halving in range(halvings):
            levels[number, halving] = used, *total.shape
            values.append((total / count).astype(np.float32).ravel())
            used += total.size
            total, count = _halved(total), _halved(count)
    joined = np.concatenate(values)
    terms = [np.array([[1.0, PICTURE, number + 1.0, *size]]) for number in range(len(pictures))]
    return [Pattern(own, joined, levels) for own in terms]


def _halved(sums: Float64) -> Float64:
    # sums over 2 × 2 pixels; fewer at the last row and column of an odd number
    rows, columns = sums.shape
    even = np.pad(sums, ((0, rows % 2), (0, columns % 2)))
    return even.reshape((rows + 1) // 2, 2, (columns + 1) // 2, 2).sum(axis=(1, 3))


def pattern_at(pattern: Pattern, u: Float64, v: Float64) -> Float64:
    """What a pattern multiplies the radiance by at places on the light [mm], shape (n,)."""
    values = np.zeros(len(u))
    for coefficient, axis, wave, phase, duty in pattern.terms:
        if axis == PICTURE:
            first, rows, columns = pattern.levels[int(wave) - 1, 0]
            row = np.clip(np.floor((0.5 - v / duty) * rows), 0, rows - 1).astype(np.intp)
            column = np.clip(np.floor((0.5 - u / phase) * columns), 0, columns - 1).astype(np.intp)
            values += coefficient * pattern.values[first + row * columns + column]
            continue
        angle = wave * (v if axis else u) + phase
        bright = np.abs(np.remainder(angle + math.pi, 2.0 * math.pi) - math.pi) <= duty * math.pi
        values += coefficient * (bright if duty > 0.0 else np.cos(angle))
    return values


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
