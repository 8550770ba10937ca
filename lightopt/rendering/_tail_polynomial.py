"""The tail of GGX over a rectangle of a panel as a polynomial, where many parts of the rectangle are asked for.

A shadow's edge divides a panel into dozens of small areas. Far from the lobe's peak its tail is smooth over all of
them: a polynomial through few nodes serves, whose integral over any part needs no further light direction.
"""

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.lights import PanelNumbers
from lightopt.optics import Lobe, specular_divisor
from lightopt.rendering._panel_quadrature import NODES, Rectangle, above_masking, nodes_of_tail, tail_values
from lightopt.rendering._surface import SurfacePoint

MOST_TERMS = 5  # of a polynomial along a side


def _powers() -> Float64:
    # row n: the matrix that takes values at n Gauss–Legendre nodes on [−1, 1] to coefficients of powers
    found = np.zeros((MOST_TERMS + 1, MOST_TERMS, MOST_TERMS))
    for n in range(1, MOST_TERMS + 1):
        found[n, :n, :n] = np.linalg.inv(np.vander(2.0 * NODES[n, :n] - 1.0, increasing=True))
    found.flags.writeable = False
    return found


_POWERS = _powers()


@kernel
def tail_polynomial(
    at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int, found: Float64
) -> int:
    """Set the polynomial of the specular light of an area's places; return its terms a side, 0 where it is not smooth.

    panel_nodes: Nodes a side that the whole panel needs for its fall-off and emission
    found: Coefficients of xⁱ·yʲ, x and y from −1 to 1 over the area; shape (MOST_TERMS, MOST_TERMS)
    """
    if not lobe.ggx or lobe.widening > 1.0 or at.n_dot_v <= 0.0 or not above_masking(at, panel, area, lobe):
        return 0
    # a rule of n nodes integrates 2n terms: with as many digits a polynomial takes nearly as many nodes
    terms = 2 * nodes_of_tail(at, panel, area, lobe, panel_nodes) - 1
    if terms > MOST_TERMS:
        return 0
    values, half = np.empty((terms, terms)), np.empty((terms, terms))
    s, t = np.empty(terms * terms), np.empty(terms * terms)
    for i in range(terms):
        for j in range(terms):
            s[i * terms + j] = area.s0 + (area.s1 - area.s0) * NODES[terms, i]
            t[i * terms + j] = area.t0 + (area.t1 - area.t0) * NODES[terms, j]
    tail_values(at, panel, s, t, values.reshape(-1), lobe)
    divisor = specular_divisor(at.n_dot_v, 0.0, lobe)
    for i in range(terms):
        for j in range(terms):
            total = 0.0
            for k in range(terms):
                total += _POWERS[terms, i, k] * values[k, j]
            half[i, j] = total
    for i in range(terms):
        for j in range(terms):
            total = 0.0
            for k in range(terms):
                total += half[i, k] * _POWERS[terms, j, k]
            found[i, j] = total / divisor
    return terms


@kernel
def polynomial_light(polynomial: Float64, terms: int, area: Rectangle, part: Rectangle) -> float:
    """Integral of a :func:`tail_polynomial` of an area over a part of it."""
    width, height = 0.5 * (area.s1 - area.s0), 0.5 * (area.t1 - area.t0)
    x0, x1 = (part.s0 - area.s0) / width - 1.0, (part.s1 - area.s0) / width - 1.0
    y0, y1 = (part.t0 - area.t0) / height - 1.0, (part.t1 - area.t0) / height - 1.0
    total, low, high = 0.0, x0, x1
    for i in range(terms):
        row, first, last = 0.0, y0, y1
        for j in range(terms):
            row += polynomial[i, j] * (last - first) / (j + 1.0)
            first, last = first * y0, last * y1
        total += row * (high - low) / (i + 1.0)
        low, high = low * x0, high * x1
    return total * width * height
