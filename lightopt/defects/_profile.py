"""Heights of defects above the undisturbed surface, and their slopes, in coordinates of the tangent plane.

A place of the outline is ρ = 1, the centre (for a scratch its middle line) ρ = 0. A wall's slope, in units of the
steepest, is a function g(ρ) that vanishes at both ends, so that heights are smooth:

========  =====================================================================
dent      sin πρ, a cosine bowl; a bump the same upwards
blister   0 up to ρ = 0.6, the flat top; then sin π(ρ − 0.6)/0.4, upwards
pit       1, a cone, from ρ = 0.2 to 0.8; rounded linearly at the tip and at the rim
scratch   the same across: a V with a rounded bottom and rounded lips
========  =====================================================================

What the functions share
------------------------
shape
    The defect.
x, y
    Coordinates along its length and across [mm], shape (k,).
"""

from __future__ import annotations

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.defects._shape import BLEND, BLISTER_TOP, SHAPE_KINDS, DefectShape, depth_of_slope


def radial_place(shape: DefectShape, x: Float64, y: Float64) -> Float64:
    """ρ: 0 in the middle, 1 on the outline, shape (k,)."""
    if shape.kind == "scratch":
        return np.hypot(x - _on_middle_line(shape, x), y) / (0.5 * shape.width)
    return np.hypot(x / (0.5 * shape.length), y / (0.5 * shape.width))


def height(shape: DefectShape, x: Float64, y: Float64) -> Float64:
    """Height above the undisturbed surface [mm], negative for dents, pits and scratches; shape (k,)."""
    rho = np.minimum(radial_place(shape, x, y), 1.0)
    if shape.kind not in SHAPE_KINDS:
        return np.zeros_like(rho)
    if shape.kind in ("dent", "bump", "blister"):
        top = BLISTER_TOP if shape.kind == "blister" else 0.0
        share = 0.5 + 0.5 * np.cos(math.pi * np.maximum(rho - top, 0.0) / (1.0 - top))
    else:
        # integral of the trapezoid from ρ to the rim, over that from the centre
        fallen = np.minimum(rho, 1.0 - BLEND) - 0.5 * BLEND
        fallen = np.where(rho < BLEND, 0.5 * rho**2 / BLEND, fallen)
        fallen = fallen + np.where(rho > 1.0 - BLEND, 0.5 * (BLEND - (1.0 - rho) ** 2 / BLEND), 0.0)
        share = 1.0 - fallen / (1.0 - BLEND)
    return _sign(shape) * depth_of_slope(shape.kind, shape.width, shape.slope) * share


def height_gradient(shape: DefectShape, x: Float64, y: Float64) -> tuple[Float64, Float64]:
    """Slopes of the height along x and along y, each of shape (k,)."""
    rho = radial_place(shape, x, y)
    steepness = np.where(rho < 1.0, _relative_slope(shape, rho), 0.0)
    # the height falls off as ρ grows; d(ρ)/dx in units of 1 / (width/2)
    fall = -_sign(shape) * math.tan(shape.slope) * steepness
    if shape.kind == "scratch":
        across_x, across_y = x - _on_middle_line(shape, x), y
        scale = 1.0 / np.where(rho > 0.0, rho * 0.5 * shape.width, 1.0)
        return fall * across_x * scale, fall * across_y * scale
    a, b = 0.5 * shape.length, 0.5 * shape.width
    scale = b / np.where(rho > 0.0, rho, 1.0)
    return fall * x / a**2 * scale, fall * y / b**2 * scale


def _relative_slope(shape: DefectShape, rho: Float64) -> Float64:
    if shape.kind in ("dent", "bump", "blister"):
        top = BLISTER_TOP if shape.kind == "blister" else 0.0
        return np.sin(math.pi * np.clip((rho - top) / (1.0 - top), 0.0, 1.0))
    if shape.kind in ("pit", "scratch"):
        return np.clip(np.minimum(rho, 1.0 - rho) / BLEND, 0.0, 1.0)
    return np.zeros_like(rho)


def _on_middle_line(shape: DefectShape, x: Float64) -> Float64:
    half = 0.5 * (shape.length - shape.width)
    return np.clip(x, -half, half)


def _sign(shape: DefectShape) -> float:
    return 1.0 if shape.kind in ("bump", "blister") else -1.0
