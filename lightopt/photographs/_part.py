"""The part in photographs: a mesh of the user, or a sphere where the mask shows one."""

import math
import os.path
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.geometry import UNITLESS_SUFFIXES, sphere_mesh, stl_bytes
from lightopt.images import read_photograph
from lightopt.photographs._calibration import Intrinsics
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
    """A part with a mesh file, which a part file in `folder` will name; InputError where mesh or unit is missing."""
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
    """Centre of a sphere in the camera's own axes [mm], shape (3,), from its disc; InputError where that is no disc."""
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
    rays = pixel_directions(camera, *_outline(mask))
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


def read_mask(path: Path) -> Bool:
    """Pixels of the part, (H, W): of half of full scale or more; InputError for no image or pixels of one kind."""
    samples = read_photograph(path)
    mask: Bool = samples.max(axis=2) > np.iinfo(samples.dtype).max // 2
    if mask.all() or not mask.any():
        raise InputError(
            f"{path}: the mask is all {'white' if mask.all() else 'black'}; expected the part white on black"
        )
    return mask


def _outline(mask: Bool) -> tuple[Float64, Float64]:
    """Columns and rows [px] of the middles of all pixel sides between the mask and what is around it."""
    rows, columns = np.nonzero(mask[:, 1:] != mask[:, :-1])
    below, beside = np.nonzero(mask[1:] != mask[:-1])
    middles = np.array([np.append(columns + 1.0, beside + 0.5), np.append(rows + 0.5, below + 1.0)], dtype=np.float64)
    return middles[0], middles[1]
