"""Deflectometry: from places on a display, seen in a mirror surface, to how far its normals are from the model's.

The camera sees, at a point of the surface, the place X of the display whose light is mirrored there. The normal that
does this bisects the directions to X and to the camera. The surface's points are the model's: an error of its height
turns the result by about half its ratio to the display's distance.
"""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float32, Float64
from lightopt.lights import PanelLight

LEAST_TANGENT = 0.1  # share of world X in the tangent plane, from which on it is a direction of the slope


@dataclass(frozen=True)
class SlopeMap:
    """How far the measured normals lean from the model's, shape (H, W) each; NaN where unknown.

    x, y: Towards world X as projected onto the model's tangent plane, and towards the direction 90° counterclockwise of
        it, seen from outside [deg]
    """

    x: Float64
    y: Float64


def slope_map(
    points: Float32 | Float64,
    normals: Float32 | Float64,
    u: Float64,
    v: Float64,
    *,
    camera: Float64,
    display: PanelLight,
) -> SlopeMap:
    """Slopes of a mirror surface against its model.

    points, normals: Of the model, as the geometry image of the posture has them: world frame [mm], shape (H, W, 3)
    u, v: Place on the display that each pixel sees, from its middle along `across` and `along` [mm], shape (H, W)
    camera: Position of the camera, world frame [mm], shape (3,)
    display: World frame
    """
    places = display.centre + u[..., None] * display.across + v[..., None] * display.along
    measured = _unit(_unit(places - points) + _unit(camera - points))
    x_axis = np.array([1.0, 0.0, 0.0]) - normals[..., :1] * normals
    length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        x_axis = np.where(length >= LEAST_TANGENT, x_axis / length, np.nan)
    y_axis = np.cross(normals, x_axis)
    along = np.einsum("hwi,hwi->hw", measured, normals)
    x, y = (np.arctan2(np.einsum("hwi,hwi->hw", measured, axis), along) for axis in (x_axis, y_axis))
    return SlopeMap(np.degrees(x), np.degrees(y))


def slope_noise(phase: float, period: float, distance: float) -> float:
    """Standard deviation of the slope [deg] of a phase's [rad]: a tilt β moves the mirrored place by about 2dβ.

    period: Of the stripes [mm]
    distance: From the surface to the display [mm]
    """
    return math.degrees(phase * period / (2.0 * math.pi) / (2.0 * distance))


def _unit(vectors: Float64) -> Float64:
    with np.errstate(divide="ignore", invalid="ignore"):
        return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
