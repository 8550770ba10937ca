"""A defect on a surface, and the surface around it in the coordinates of its tangent plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.defects._shape import DefectShape

LEAST_NORMAL_COSINE = 0.5
"""Points whose normal is more than 60° from the defect's are another side of the part."""

STEEPEST_DEPARTURE = math.tan(math.radians(30.0))
"""Points further off the tangent plane than this share of their distance along it are another surface: the height of
an arc whose normal has turned by 60°, over its chord's run."""

DEPARTURE_SLACK_MM = 0.01
"""Facets of curved surfaces depart from them by about this much [mm]."""

LEAST_REFERENCE = 0.1
"""An X axis whose share in the tangent plane is less than this is no reference; the Y axis then is."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlacedDefect:
    """A defect on a part, in the frame that its vectors are given in.

    Attributes
    ----------
    name: Of this one, for people
    position: Its centre, on the surface [mm], shape (3,)
    normal: Unit normal of the undisturbed surface there, shape (3,)
    along: Unit vector of its length, in the tangent plane, shape (3,)
    """

    name: str
    shape: DefectShape
    position: Float64
    normal: Float64
    along: Float64

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
    (nx, ny, nz), (x, y, z) = normal.tolist(), reference.tolist()
    across = np.array([ny * z - nz * y, nz * x - nx * z, nx * y - ny * x])
    return math.cos(angle) * reference + math.sin(angle) * across


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


def surface_coordinates(
    defect: PlacedDefect, points: Float64, normals: Float64
) -> tuple[Float64, Float64, Bool]:
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
