"""Vectors and panels as the kernels want them, and the light of one point of a panel.

Numbers and not arrays, since counting references to arrays costs the kernels more than the arithmetic.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.optics import MAX_LOBE_EXPONENT, lambert, torrance_sparrow
from lightopt.scene import PanelLight


class Vector(NamedTuple):
    """A point or a direction."""

    x: float
    y: float
    z: float


class PanelNumbers(NamedTuple):
    """A panel in the part's frame; a point of it is ``centre + s·across + t·along`` with s, t in [−½, ½].

    across, along: As long as the panel's sides [mm]
    distance: Of the panel's centre to the origin of the world [mm]
    """

    centre: Vector
    across: Vector
    along: Vector
    outward: Vector
    distance: float
    inverse_square: bool
    emission_exponent: float


def panel_numbers(light: PanelLight) -> PanelNumbers:
    """The numbers of a panel, in the frame that its vectors are given in."""
    return PanelNumbers(
        centre=Vector(*light.centre.tolist()),
        across=Vector(*(light.size[0] * light.across).tolist()),
        along=Vector(*(light.size[1] * light.along).tolist()),
        outward=Vector(*light.outward.tolist()),
        distance=float(light.distance),
        inverse_square=light.inverse_square,
        emission_exponent=float(light.emission_exponent),
    )


@kernel
def vector_at(rows: Float64, i: int) -> Vector:
    """Row i of an array of shape (k, 3)."""
    return Vector(rows[i, 0], rows[i, 1], rows[i, 2])


@kernel
def plus(a: Vector, b: Vector) -> Vector:
    """A + b."""
    return Vector(a.x + b.x, a.y + b.y, a.z + b.z)


@kernel
def minus(a: Vector, b: Vector) -> Vector:
    """A − b."""
    return Vector(a.x - b.x, a.y - b.y, a.z - b.z)


@kernel
def scaled(a: Vector, factor: float) -> Vector:
    """Factor · a."""
    return Vector(a.x * factor, a.y * factor, a.z * factor)


@kernel
def divided(a: Vector, divisor: float) -> Vector:
    """A / divisor, which is not rounded as 1/divisor · a is."""
    return Vector(a.x / divisor, a.y / divisor, a.z / divisor)


@kernel
def dot(a: Vector, b: Vector) -> float:
    """A · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@kernel
def cross(a: Vector, b: Vector) -> Vector:
    """A × b."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


@kernel
def length(a: Vector) -> float:
    """|a|."""
    return math.sqrt(dot(a, a))


@kernel
def panel_point(panel: PanelNumbers, s: float, t: float) -> Vector:
    """The point centre + s·across + t·along."""
    c, a, b = panel.centre, panel.across, panel.along
    return Vector(c.x + s * a.x + t * b.x, c.y + s * a.y + t * b.y, c.z + s * a.z + t * b.z)


@kernel
def half_diagonal(panel: PanelNumbers) -> float:
    """Of the panel [mm]."""
    a, b = panel.across, panel.along
    return 0.5 * math.sqrt(a.x**2 + a.y**2 + a.z**2 + b.x**2 + b.y**2 + b.z**2)


@kernel
def point_terms(
    p: Vector,
    n: Vector,
    v: Vector,
    n_dot_v: float,
    q: Vector,
    panel: PanelNumbers,
    inverse_two_sigma_squared: float,
) -> tuple[float, float]:
    """Diffuse and specular terms, per unit of R_d and R_s, of one point light of weight 1 (paper, equations 2 and 3).

    p, n, v: Surface point [mm], its unit normal and unit view direction
    n_dot_v: cosθ_o; 0 leaves the specular term out
    q: The point light [mm], a point of the panel
    inverse_two_sigma_squared: 1/(2σ²) [rad⁻²]
    """
    light = minus(q, p)
    r2 = dot(light, light)
    light = scaled(light, 1.0 / math.sqrt(r2))
    n_dot_l = dot(n, light)
    if n_dot_l <= 0.0:
        return 0.0, 0.0
    weight = 1.0
    if panel.inverse_square:
        weight = panel.distance * panel.distance / r2
    if panel.emission_exponent > 0.0:
        weight *= max(0.0, dot(panel.outward, light)) ** panel.emission_exponent
    diffuse = weight * lambert(n_dot_l)
    if n_dot_v <= 0.0:
        return diffuse, 0.0
    half = plus(light, v)
    length_squared = dot(half, half)
    # far from the lobe, where most pixels of a glossy part are, not even the square root is needed
    n_dot_h = dot(n, half)
    least_cosine = 1.0 - 0.5 * MAX_LOBE_EXPONENT / inverse_two_sigma_squared
    if least_cosine > 0.0 and (
        n_dot_h <= 0.0 or n_dot_h * n_dot_h < least_cosine * least_cosine * length_squared
    ):
        return diffuse, 0.0
    chord = minus(n, scaled(half, 1.0 / math.sqrt(length_squared)))
    return diffuse, weight * torrance_sparrow(dot(chord, chord), n_dot_v, inverse_two_sigma_squared)
