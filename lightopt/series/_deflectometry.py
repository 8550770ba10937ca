"""Deflectometry: from places on a display, seen in a mirror surface, to how far its normals are from the model's.

The camera sees, at a point of the surface, the place X of the display whose light is mirrored there. The normal that
does this bisects the directions to X and to the camera. The surface's points are the model's: an error h of its height
turns the result by about h·sinθ/d, θ the angle of incidence and d the distance to the display.
"""

from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.lights import PanelLight

LEAST_TANGENT = 0.1  # share of the X axis in the tangent plane, from which on it is a direction of the slope


@dataclass(frozen=True)
class SlopeMap:
    """How far the measured normals lean from the model's, shape (...); NaN where unknown.

    x, y: Towards the X axis as projected onto the model's tangent plane, and towards the direction 90° counterclockwise
        of it, seen from outside [deg]
    """

    x: Float64
    y: Float64


def slope_map(
    points: Float64, normals: Float64, u: Float64, v: Float64, *, camera: Float64, display: PanelLight
) -> SlopeMap:
    """Slopes of a mirror surface against its model; everything in one frame, the part's or the world's.

    points, normals: Of the model, where each pixel's ray meets it: [mm] and of unit length, shape (..., 3)
    u, v: Place on the display that each pixel sees, from its middle along `across` and `along` [mm], shape (...)
    camera: Position of the camera [mm], shape (3,)
    """
    places = display.centre + u[..., None] * display.across + v[..., None] * display.along
    measured = _unit(_unit(places - points) + _unit(camera - points))
    x_axis = np.array([1.0, 0.0, 0.0]) - normals[..., :1] * normals
    length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
    x_axis = _unit(np.where(length >= LEAST_TANGENT, x_axis, np.nan))
    axes = x_axis, np.cross(normals, x_axis)
    x, y = (np.degrees(np.arctan2(_dot(measured, axis), _dot(measured, normals))) for axis in axes)
    return SlopeMap(x, y)


def _unit(vectors: Float64) -> Float64:
    return vectors / np.sqrt(_dot(vectors, vectors))[..., None]


def _dot(a: Float64, b: Float64) -> Float64:
    return np.sum(a * b, axis=-1)
