"""Which points of a surface lie in defects, and what those do to normals and coefficients there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64, Index, Int32
from lightopt.defects._placed import PlacedDefect, surface_coordinates
from lightopt.defects._profile import height_gradient, radial_place


@dataclass(frozen=True, eq=False, kw_only=True)
class Marks:
    """The points of a surface that lie in defects, j of them.

    index: Of each among the points given, ascending, shape (j,)
    label: Index of its defect, the last one where several overlap; shape (j,)
    normals: Unit normals of the disturbed surface, shape (j, 3)
    R_d_factor, sigma_factor: By which R_d and σ are multiplied, shape (j,)
    """

    index: Index
    label: Int32
    normals: Float64
    R_d_factor: Float64
    sigma_factor: Float64


def mark_surface(defects: Sequence[PlacedDefect], points: Float64, normals: Float64) -> Marks | None:
    """Find the points inside defects, and turn their normals; None where there are none.

    Heights h of defects that overlap add up, and factors multiply. A displaced surface p + h·N has, for heights small
    against the radius of curvature, the normal N − ∇h normalised, ∇h the gradient along the surface.

    defects: In the frame of the points
    points, normals: Of the undisturbed surface: [mm] and of unit length, shape (k, 3)
    """
    if not defects or not len(points):
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    label = np.full(len(points), -1, np.int32)
    gradient = np.zeros((0, 3))
    factors = np.zeros((0, 2))
    for number, defect in enumerate(defects):
        if np.any(defect.position < low - defect.reach) or np.any(defect.position > high + defect.reach):
            continue
        offset = points - defect.position
        near = np.flatnonzero(np.einsum("ij,ij->i", offset, offset) <= defect.reach**2)
        x, y, same = surface_coordinates(defect, points[near], normals[near])
        same &= radial_place(defect.shape, x, y) < 1.0
        inside = near[same]
        if not len(inside):
            continue
        if not len(gradient):
            gradient, factors = np.zeros((len(points), 3)), np.ones((len(points), 2))
        label[inside] = number
        along, across = height_gradient(defect.shape, x[same], y[same])
        gradient[inside] += along[:, None] * defect.along + across[:, None] * defect.across
        factors[inside] *= (defect.shape.R_d_factor, defect.shape.sigma_factor)
    index = np.flatnonzero(label >= 0)
    if not len(index):
        return None
    undisturbed, slope = normals[index], gradient[index]
    slope = slope - np.einsum("ij,ij->i", slope, undisturbed)[:, None] * undisturbed
    tilted = undisturbed - slope
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    # a stain leaves the normal as it is, to the last bit
    flat = ~slope.any(axis=1)
    tilted[flat] = undisturbed[flat]
    return Marks(
        index=index,
        label=label[index],
        normals=tilted,
        R_d_factor=factors[index, 0],
        sigma_factor=factors[index, 1],
    )
