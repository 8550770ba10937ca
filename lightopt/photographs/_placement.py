"""Where the part of imported photographs lies, and a camera above it where no pose is known."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.photographs._calibration import Intrinsics, Pose
from lightopt.photographs._grey_levels import outline
from lightopt.photographs._inputs import ImportOptions, Inputs
from lightopt.scene import Distortion, pixel_directions, pose_camera

_DOWN = np.diag([1.0, -1.0, -1.0])  # axes of a camera that looks straight down with the world's X to the right
_FILLED = 0.8  # share of the image's shorter side that the part fills where nothing says how far the camera is
_ROUND = 0.02  # share of its radius by which a disc's outline may be off a circle


@dataclass(frozen=True, kw_only=True)
class Placed:
    """Where part and camera are, world frame.

    translate: Of the part, after the anchor [mm], shape (3,)
    reach: Distance of the part's farthest point from the origin [mm]
    """

    camera: Pose
    anchor: str
    translate: Float64
    reach: float
    camera_from: str
    part_from: str


def place(inputs: Inputs, options: ImportOptions) -> Placed:
    """Place the part, and a camera above it where its pose is not known.

    Raises InputError: A sphere's mask is no disc, or a sphere has neither mask nor place
    """
    pose, mask, turn, distance = inputs.pose, inputs.mask, inputs.turn, options.distance
    corners = np.array(list(itertools.product(*inputs.shape.corners.T))) @ turn.T
    translate = turn @ (options.at or (0.0, 0.0, 0.0))
    anchor, part_from = "as_modelled", "as given" if options.at else "in the frame of [R|t]"
    camera_from = "R and t" if pose else "looking straight down, at the distance given"
    if not options.at and options.sphere:
        if mask is None:
            raise InputError("option 'sphere': expected option 'mask', whose disc says where it is, or option 'at'")
        axis, away = _sphere_in_mask(mask, inputs.intrinsics, options.sphere, pose.rotation if pose else _DOWN)
        if pose is None and distance is None:
            distance = options.sphere - away * float(axis[2])
            camera_from = "looking straight down, as far away as the mask's disc says"
        eye = pose.position if pose else np.array([0.0, 0.0, distance])
        translate, part_from = eye + away * axis, "the middle of the mask's disc"
    elif not options.at and pose is None:
        anchor, part_from = "rest_on_table", "no [R|t]: on the table"
        low, high = corners.min(axis=0), corners.max(axis=0)
        corners = corners - np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    if pose is None and distance is None:
        low, high = corners.min(axis=0) + translate, corners.max(axis=0) + translate
        pixels = _FILLED * min(inputs.photographs.size)
        camera_from = f"looking straight down, the part fills {_FILLED:.0%} of the image"
        if mask is not None:
            pixels = max(float(np.ptp(side)) for side in outline(mask))
            camera_from = "looking straight down, the part as large as the mask"
        distance = inputs.intrinsics.focal[0] * float(max(high[:2] - low[:2])) / pixels + 0.5 * float(low[2] + high[2])
    return Placed(
        camera=pose or Pose(np.array([0.0, 0.0, distance]), _DOWN),
        anchor=anchor,
        translate=translate,
        reach=float(np.linalg.norm(corners + translate, axis=1).max()),
        camera_from=camera_from,
        part_from=part_from,
    )


def _sphere_in_mask(mask: Bool, intrinsics: Intrinsics, radius: float, rotation: Float64) -> tuple[Float64, float]:
    """Unit vector from the camera to the middle of a sphere, world frame, shape (3,), and how far away that is [mm]."""
    camera = pose_camera(
        position=np.zeros(3),
        rotation=rotation,
        width=mask.shape[1],
        height=mask.shape[0],
        pixel_size=1.0 / intrinsics.focal[0],
        image_distance=1.0,
        distortion=Distortion(**intrinsics.distortion),
        principal_point=intrinsics.principal_point,
        aspect=intrinsics.focal[1] / intrinsics.focal[0],
    )
    rays = pixel_directions(camera, *outline(mask))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    # rays u that graze a sphere make one angle α with its axis a: u · a / cos α = 1
    axis = np.asarray(np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0], np.float64)
    cosine = 1.0 / float(np.linalg.norm(axis))
    axis *= cosine
    angles = np.linalg.norm(np.cross(rays, axis), axis=1)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    off = float(np.sqrt(np.mean((angles / max(sine, 1e-12) - 1.0) ** 2)))
    if not off < _ROUND:
        raise InputError(
            f"option 'mask': its outline is off a circle by {off:.0%} of the radius; expected the disc of the sphere"
        )
    return axis, radius / sine
