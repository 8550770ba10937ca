"""The part in photographs: a mesh of the user, or a sphere where the mask shows one."""

from __future__ import annotations

import math
import os.path
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.geometry import UNITLESS_SUFFIXES, sphere_mesh, stl_bytes
from lightopt.photographs._calibration import Intrinsics
from lightopt.photographs._grey_levels import outline
from lightopt.scene import Distortion, pixel_directions, pose_camera

_ROUND = 0.02  # share of its radius by which a disc's outline may be off a circle


@dataclass(frozen=True, kw_only=True)
class PhotographedPart:
    """A part in the world."""

    name: str
    file: str  # as the part file names it
    units: str | None = "mm"
    content: bytes | None = None  # of a generated file; None for one of the user
    # from the mesh's frame to the world's
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translate_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


def mesh_part(path: Path, *, units: str | None, folder: Path, about_x_deg: float) -> PhotographedPart:
    """A part with a mesh file, which a part file in `folder` will name.

    Raises InputError: The mesh is missing, or its unit is
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a mesh or STEP file")
    if path.suffix.lower() in UNITLESS_SUFFIXES and units is None:
        raise InputError(f"option 'mesh_units': expected the unit of {path}: {path.suffix} files carry none")
    path, folder = path.resolve(), folder.resolve()
    file = Path(os.path.relpath(path, folder) if path.drive == folder.drive else path).as_posix()
    return PhotographedPart(name=path.stem, file=file, units=units, rotate_deg=(about_x_deg, 0.0, 0.0))


def sphere_part(radius: float, centre: Float64) -> PhotographedPart:
    """A sphere [mm] about a point of the world, shape (3,)."""
    x, y, z = centre.tolist()
    content = stl_bytes(sphere_mesh(radius))
    return PhotographedPart(name="sphere", file="sphere.stl", content=content, translate_mm=(x, y, z))


def sphere_in_mask(mask: Bool, intrinsics: Intrinsics, radius: float) -> Float64:
    """Centre of a sphere in the camera's own axes [mm], shape (3,), from its disc.

    Raises InputError: The mask is no disc
    """
    camera = pose_camera(
        position=np.zeros(3),
        rotation=np.eye(3),
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
    sine = math.sqrt(max(1.0 - cosine * cosine, 1e-24))
    off = float(np.sqrt(np.mean((angles / sine - 1.0) ** 2)))
    if not off < _ROUND:
        raise InputError(
            f"option 'mask': its outline is off a circle by {off:.0%} of the radius; expected the disc of the sphere"
        )
    return axis * (radius / sine)
