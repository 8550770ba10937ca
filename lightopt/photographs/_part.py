"""The part in photographs: its mesh, where it lies, and a camera above it where no pose is known."""

from __future__ import annotations

import itertools
import math
import os.path
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.core.units import MM_PER_UNIT
from lightopt.geometry import UNITLESS_SUFFIXES, box_stl, load_mesh, sphere_stl
from lightopt.photographs._calibration import Intrinsics, Pose
from lightopt.photographs._grey_levels import outline
from lightopt.scene import Distortion, pixel_directions, pose_camera

_DOWN = np.diag([1.0, -1.0, -1.0])  # axes of a camera that looks straight down with the world's X to the right
_FILLED = 0.8  # share of the image's shorter side that the part fills where nothing says how far the camera is
_ROUND = 0.02  # share of its radius by which a disc's outline may be off a circle


@dataclass(frozen=True, kw_only=True)
class PartShape:
    """A part's mesh.

    name: Of the part
    file: As the part file names it
    content: Of a generated file; None for one of the user
    low, high: Corners of the bounding box, frame of the mesh [mm], shape (3,)
    radius: Of a sphere [mm]
    """

    name: str
    file: str
    units: str | None
    content: bytes | None
    low: Float64
    high: Float64
    radius: float | None = None


@dataclass(frozen=True, kw_only=True)
class Placed:
    """Where part and camera are, world frame.

    rotation: Of the part, shape (3, 3)
    translate: After the anchor [mm], shape (3,)
    reach: Distance of the part's farthest point from the origin [mm]
    """

    camera: Pose
    anchor: str
    rotation: Float64
    translate: Float64
    reach: float
    camera_from: str
    part_from: str


def mesh_part(path: Path, *, units: str | None, folder: Path) -> PartShape:
    """A part with a mesh file, which a part file in `folder` will name.

    Raises InputError: The mesh cannot be read, or its unit is missing
    """
    unitless = path.suffix.lower() in UNITLESS_SUFFIXES
    if unitless and units is None:
        raise InputError(
            f"option 'mesh_units': expected the unit of {path}: {path.suffix} files carry none (mm, inch, …)"
        )
    unit = MM_PER_UNIT[units] if unitless and units else None
    mesh = load_mesh(path, unit_mm=unit, normals="facet", crease_angle=0.0, chord_tolerance_mm=0.1).mesh
    low, high = mesh.bounds
    file = Path(os.path.relpath(path, folder)).as_posix()
    return PartShape(name=path.stem, file=file, units=units, content=None, low=low, high=high)


def sphere_part(radius: float) -> PartShape:
    """A sphere about the origin of its mesh; radius [mm]."""
    corner = np.full(3, radius)
    return PartShape(
        name="sphere",
        file="sphere.stl",
        units="mm",
        content=sphere_stl(radius),
        low=-corner,
        high=corner,
        radius=radius,
    )


def plate_part(width: float, height: float, *, towards_z: bool) -> PartShape:
    """A plate [mm] with its middle at the origin, seen from above (`towards_z`) or from below."""
    thickness = 0.02 * max(width, height)
    low, high = np.array([-0.5 * width, -0.5 * height, 0.0]), np.array([0.5 * width, 0.5 * height, 0.0])
    (low if towards_z else high)[2] = -thickness if towards_z else thickness
    content = box_stl((low[0], low[1], low[2]), (high[0], high[1], high[2]))
    return PartShape(name="plate", file="plate.stl", units="mm", content=content, low=low, high=high)


def place(
    shape: PartShape,
    intrinsics: Intrinsics,
    pose: Pose | None,
    *,
    size: tuple[int, int],
    mask: Bool | None,
    turn: Float64,
    at: Float64 | None,
    distance: float | None,
) -> Placed:
    """Place a part, and a camera above it where its pose is not known.

    pose: World frame, turned already
    size: Of the images [px]
    turn: From the frame of [R|t], mesh and `at` to the world's, shape (3, 3)
    at: Where the mesh's origin is, before the turn [mm]
    distance: Of a camera without pose to the origin [mm]
    Raises InputError: A sphere's mask is no disc, or a sphere has neither mask nor place
    """
    corners = np.array(list(itertools.product(*zip(shape.low, shape.high, strict=True)))) @ turn.T
    translate = np.zeros(3) if at is None else turn @ at
    anchor, part_from = "as_modelled", "as given" if at is not None else "in the frame of [R|t]"
    camera_from = "R and t" if pose else "looking straight down, at the distance given"
    if at is None and shape.radius is not None:
        if mask is None:
            raise InputError("option 'sphere': expected option 'mask', whose disc says where it is, or option 'at'")
        axis, away = _sphere_in_mask(mask, intrinsics, shape.radius, pose.rotation if pose else _DOWN)
        if pose is None and distance is None:
            distance, camera_from = (
                shape.radius - away * float(axis[2]),
                "looking straight down, as the mask's disc says",
            )
        eye = pose.position if pose else np.array([0.0, 0.0, distance])
        translate, part_from = eye + away * axis, "the middle of the mask's disc"
    elif at is None and pose is None:
        anchor, part_from = "rest_on_table", "no [R|t]: on the table"
        low, high = corners.min(axis=0), corners.max(axis=0)
        corners = corners - np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    if pose is None and distance is None:
        low, high = corners.min(axis=0) + translate, corners.max(axis=0) + translate
        pixels, camera_from = _FILLED * min(size), f"looking straight down, the part fills {_FILLED:.0%} of the image"
        if mask is not None:
            pixels = max(float(np.ptp(side)) for side in outline(mask))
            camera_from = "looking straight down, the part as large as the mask"
        distance = intrinsics.focal[0] * float(max(high[:2] - low[:2])) / pixels + 0.5 * float(low[2] + high[2])
    return Placed(
        camera=pose or Pose(np.array([0.0, 0.0, distance]), _DOWN),
        anchor=anchor,
        rotation=turn,
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
