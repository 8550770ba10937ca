"""Weights of Gauss–Legendre nodes along a side of an element, for light with the stripes of a pattern on it.

Where stripes have edges, or where the light varies so much less than they do that it takes few nodes, the polynomial
through the light at the nodes is integrated over the stripes: Σ wᵢ·Σₖ (2k + 1)·Pₖ(xᵢ)·Mₖ, where Mₖ is the mean of the
Legendre polynomial Pₖ times the pattern. Pictures are integrated likewise, by their pixels or, where a side has many
of these, by means of 2 × 2, 4 × 4, ... of them.
"""

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.lights import Pattern
from lightopt.rendering._panel_quadrature import MAX_NODES, NODES, WEIGHTS

MOST_PIXELS = 64  # of a picture along a side, above which means of more pixels are taken: sharp edges to 0.5 %


@kernel
def pattern_weights(
    term: Float64, axis: int, low: float, width: float, count: int, smooth: bool, weights: Float64
) -> None:
    """Set the weights of the nodes on [low, low + width] of a side for a term of a pattern, without its coefficient.

    term: As :mod:`lightopt.lights` has it; it is 1 along the other axis
    smooth: Whether the light may vary too little for the nodes to follow the stripes
    weights: Shape (count,); their sum is the term's mean
    """
    wave, phase, duty = term[2], term[3], term[4]
    if wave == 0.0 or axis != int(term[1]):
        for i in range(count):
            weights[i] = WEIGHTS[count, i]
        return
    if duty == 0.0 and not smooth:
        for i in range(count):
            weights[i] = WEIGHTS[count, i] * math.cos(wave * (low + width * NODES[count, i]) + phase)
        return
    means = np.zeros(count)
    if duty == 0.0:
        for q in range(MAX_NODES):
            x = NODES[MAX_NODES, q]
            value = WEIGHTS[MAX_NODES, q] * math.cos(wave * (low + width * x) + phase)
            _add_polynomials(2.0 * x - 1.0, value, means)
    else:
        # numbers of the first and last bar, by where its middle is
        turn = 2.0 * math.pi
        first = math.ceil((wave * low + phase) / turn - 0.5 * duty)
        last = math.floor((wave * (low + width) + phase) / turn + 0.5 * duty)
        for number in range(first, last + 1):
            start = ((number - 0.5 * duty) * turn - phase) / wave
            end = ((number + 0.5 * duty) * turn - phase) / wave
            _add_integrals(2.0 * (min(end, low + width) - low) / width - 1.0, 0.5, means)
            _add_integrals(2.0 * (max(start, low) - low) / width - 1.0, -0.5, means)
    for i in range(count):
        x = 2.0 * NODES[count, i] - 1.0
        before, now, total = 1.0, x, means[0]
        for k in range(1, count):
            total += (2 * k + 1) * now * means[k]
            before, now = now, ((2 * k + 1) * x * now - k * before) / (k + 1)
        weights[i] = WEIGHTS[count, i] * total


@kernel
def _add_polynomials(x: float, factor: float, sums: Float64) -> None:
    # factor times P₀(x), P₁(x), ...
    before, now = 1.0, x
    sums[0] += factor
    for k in range(1, len(sums)):
        sums[k] += factor * now
        before, now = now, ((2 * k + 1) * x * now - k * before) / (k + 1)


@kernel
def _add_integrals(x: float, factor: float, sums: Float64) -> None:
    # factor times ∫ P₀, ∫ P₁, ... up to x, but for a constant: ∫ Pₖ = (Pₖ₊₁ − Pₖ₋₁) / (2k + 1)
    before, now = 1.0, x
    sums[0] += factor * x
    for k in range(1, len(sums)):
        after = ((2 * k + 1) * x * now - k * before) / (k + 1)
        sums[k] += factor * (after - before) / (2 * k + 1)
        before, now = now, after


@kernel
def picture_weights(
    pattern: Pattern, term: Float64, low: tuple[float, float], sides: tuple[float, float], weights: Float64
) -> None:
    """Set the weights of nodes on a rectangle, low + [0, sides] in (u, v), for a term that is a picture.

    term: As :mod:`lightopt.lights` has it, without its coefficient
    weights: Of the nodes along u and v, shape (count_u, count_v); their sum is the picture's mean
    """
    number = int(term[2]) - 1
    rows, columns = pattern.levels[number, 0, 1], pattern.levels[number, 0, 2]
    wide, high = term[3] / columns, term[4] / rows
    halving = 0
    while max(sides[0] / wide, sides[1] / high) > MOST_PIXELS and halving + 1 < pattern.levels.shape[1]:
        wide, high, halving = 2.0 * wide, 2.0 * high, halving + 1
    first, rows, columns = pattern.levels[number, halving]
    count_u, count_v = weights.shape
    # columns go with decreasing u, rows with decreasing v
    left, right = _pixels(0.5 * term[3], wide, low[0], sides[0], columns)
    top, bottom = _pixels(0.5 * term[4], high, low[1], sides[1], rows)
    across, down = np.zeros((right - left, count_u)), np.zeros((bottom - top, count_v))
    _set_moments(0.5 * term[3], wide, low[0], sides[0], left, across)
    _set_moments(0.5 * term[4], high, low[1], sides[1], top, down)
    sums, products, line = np.zeros((count_u, count_v)), np.empty((count_u, count_v)), np.empty(count_u)
    for row in range(top, bottom):
        for k in range(count_u):
            line[k] = 0.0
        for column in range(left, right):
            value = pattern.values[first + row * columns + column]
            if value != 0.0:
                for k in range(count_u):
                    line[k] += value * across[column - left, k]
        for k in range(count_u):
            for m in range(count_v):
                sums[k, m] += line[k] * down[row - top, m]
    of_u, of_v = np.empty((count_u, count_u)), np.empty((count_v, count_v))
    _set_polynomials(of_u)
    _set_polynomials(of_v)
    # loops: numba takes seconds to compile products of matrices
    for i in range(count_u):
        for m in range(count_v):
            products[i, m] = 0.0
            for k in range(count_u):
                products[i, m] += of_u[i, k] * sums[k, m]
    for i in range(count_u):
        for j in range(count_v):
            weights[i, j] = 0.0
            for m in range(count_v):
                weights[i, j] += products[i, m] * of_v[j, m]


@kernel
def _pixels(edge: float, side: float, low: float, width: float, count: int) -> tuple[int, int]:
    # the pixels that an interval meets, whose numbers grow from the edge downwards
    first = math.floor((edge - low - width) / side)
    last = math.ceil((edge - low) / side)
    return min(max(0, first), count - 1), max(1, min(count, last))


@kernel
def _set_moments(edge: float, side: float, low: float, width: float, first: int, moments: Float64) -> None:
    # mean over the interval of each Legendre polynomial, where a pixel is, shape (pixels, count)
    for number in range(len(moments)):
        high_end = edge - (first + number) * side
        start, end = max(low, high_end - side), min(low + width, high_end)
        if end > start:
            _add_integrals(2.0 * (end - low) / width - 1.0, 0.5, moments[number])
            _add_integrals(2.0 * (start - low) / width - 1.0, -0.5, moments[number])


@kernel
def _set_polynomials(values: Float64) -> None:
    # weight of each node times (2k + 1)·Pₖ there, shape (count, count)
    count = len(values)
    for i in range(count):
        x, weight = 2.0 * NODES[count, i] - 1.0, WEIGHTS[count, i]
        before, now = 0.0, 1.0
        for k in range(count):
            values[i, k] = weight * (2 * k + 1) * now
            before, now = now, ((2 * k + 1) * x * now - k * before) / (k + 1)
