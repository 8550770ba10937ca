"""Defects on a surface: the coordinates of their tangent planes, and what they do to the points that lie in them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.defects._shape import DefectShape, height_gradient, radial_place

LEAST_NORMAL_COSINE = 0.5  # points whose normal is more than 60° from the defect's are another side of the part

# points further off the tangent plane than this share of their distance along it are another surface: the height of an
# arc whose normal has turned by 60°, over its chord's run
STEEPEST_DEPARTURE = math.tan(math.radians(30.0))

DEPARTURE_SLACK_MM = 0.01  # facets of curved surfaces depart from them by about this much [mm]

# an X axis whose share in the tangent plane is less than this is no reference; the Y axis then is
LEAST_REFERENCE = 0.1


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacedDefect:
    """A defect on a part, in the frame that its vectors are given in."""

    name: str  # of this defect, for messages and reports
    shape: DefectShape
    position: Float64  # its centre, on the surface [mm], shape (3,)
    normal: Float64  # unit normal of the undisturbed surface there, shape (3,)
    along: Float64  # unit vector of its length, in the tangent plane, shape (3,)

    @property
    def across(self) -> Float64:
        """Unit vector of its width, shape (3,); along × across is the normal."""
        return np.cross(self.normal, self.along)

    @property
    def reach(self) -> float:
        """Radius of the sphere around its centre that has all of it [mm]."""
        return 0.5 * self.shape.length * math.hypot(1.0, STEEPEST_DEPARTURE) + DEPARTURE_SLACK_MM


def tangent_direction(normal: Float64, angle: float, *, x_axis: Float64, y_axis: Float64) -> Float64:
    """Unit vector in a tangent plane at an angle, counterclockwise seen from outside, from the part's X axis.

    The reference is the X axis projected onto the tangent plane; where the surface all but faces along X, the Y axis.

    x_axis, y_axis: Unit vectors of the part's axes, in the frame of the normal, shape (3,)
    """
    reference = tangent_references(normal[None, :], x_axis=x_axis, y_axis=y_axis)[0]
    return math.cos(angle) * reference + math.sin(angle) * np.cross(normal, reference)


def tangent_references(normals: Float64, *, x_axis: Float64, y_axis: Float64) -> Float64:
    """The unit vectors in tangent planes that :func:`tangent_direction` counts from, shape (k, 3).

    normals: Unit normals of the surface, shape (k, 3)
    x_axis, y_axis: As for :func:`tangent_direction`
    """
    references = x_axis - (normals @ x_axis)[:, None] * normals
    lengths = np.linalg.norm(references, axis=1)
    rest = np.flatnonzero(lengths < LEAST_REFERENCE)
    references[rest] = y_axis - (normals[rest] @ y_axis)[:, None] * normals[rest]
    lengths[rest] = np.linalg.norm(references[rest], axis=1)
    return references / lengths[:, None]


def surface_coordinates(defect: PlacedDefect, points: Float64, normals: Float64) -> tuple[Float64, Float64, Bool]:
    """Coordinates x, y of points in a defect's tangent plane [mm], and whether they belong to its surface.

    Projection onto the tangent plane stands for lengths along the surface: on a radius of curvature R they differ at a
    distance a by a²/(6R²), 1 % at a = R/4.

    points, normals: Of the surface [mm], shape (k, 3), frame of the defect
    """
    offset = points - defect.position
    x, y, z = offset @ defect.along, offset @ defect.across, offset @ defect.normal
    same = (normals @ defect.normal >= LEAST_NORMAL_COSINE) & (
        np.abs(z) <= STEEPEST_DEPARTURE * np.hypot(x, y) + DEPARTURE_SLACK_MM
    )
    return x, y, same


@dataclass(frozen=True, eq=False, kw_only=True)
class Marks:
    """The points of a surface that lie in defects, j of them."""

    index: Index  # of each among the points given, ascending, shape (j,)
    label: Int32  # index of its defect, the last one where several overlap; shape (j,)
    normals: Float64  # unit normals of the disturbed surface, shape (j, 3)
    R_d_factor: Float64  # by which R_d is multiplied, shape (j,)
    sigma_factor: Float64  # by which σ is multiplied, shape (j,)


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
        index=index, label=label[index], normals=tilted, R_d_factor=factors[index, 0], sigma_factor=factors[index, 1]
    )
