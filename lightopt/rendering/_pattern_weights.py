"""Weights of Gauss–Legendre nodes along a side of an element, for light with the stripes of a pattern on it.

Where stripes have edges, or where the light varies so much less than they do that it takes few nodes, the polynomial
through the light at the nodes is integrated over the stripes: Σ wᵢ·Σₖ (2k + 1)·Pₖ(xᵢ)·Mₖ, where Mₖ is the mean of the
Legendre polynomial Pₖ times the pattern.
"""

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.rendering._panel_quadrature import MAX_NODES, NODES, WEIGHTS


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
