"""The part in photographs: a mesh of the user, a sphere or a plate."""

from __future__ import annotations

import os.path
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.units import MM_PER_UNIT
from lightopt.geometry import UNITLESS_SUFFIXES, box_mesh, load_mesh, sphere_mesh, stl_bytes

_THICKNESS = 0.02  # of a plate, as a share of its longer side


@dataclass(frozen=True, kw_only=True)
class PartShape:
    """A part's mesh.

    file: As the part file names it
    content: Of a generated file; None for one of the user
    corners: Of the bounding box, frame of the mesh [mm], shape (2, 3)
    """

    name: str
    file: str
    units: str | None
    content: bytes | None
    corners: Float64


def mesh_part(path: Path, *, units: str | None, folder: Path) -> PartShape:
    """A part with a mesh file, which a part file in `folder` will name.

    Raises InputError: The mesh cannot be read, or its unit is missing
    """
    unitless = path.suffix.lower() in UNITLESS_SUFFIXES
    if unitless and units is None:
        raise InputError(f"option 'mesh_units': expected the unit of {path}: {path.suffix} files carry none")
    unit = MM_PER_UNIT[units] if unitless and units else None
    mesh = load_mesh(path, unit_mm=unit, normals="facet", crease_angle=0.0, chord_tolerance_mm=0.1).mesh
    path, folder = path.resolve(), folder.resolve()
    file = Path(os.path.relpath(path, folder) if path.drive == folder.drive else path).as_posix()
    return PartShape(name=path.stem, file=file, units=units, content=None, corners=np.array(mesh.bounds))


def sphere_part(radius: float) -> PartShape:
    """A sphere about the origin of its mesh; radius [mm]."""
    corners = np.array([[-radius] * 3, [radius] * 3])
    return PartShape(
        name="sphere", file="sphere.stl", units="mm", content=stl_bytes(sphere_mesh(radius)), corners=corners
    )


def plate_part(width: float, height: float, *, towards_z: bool) -> PartShape:
    """A plate [mm] with the middle of its face at the origin, seen from above (`towards_z`) or from below."""
    depth = _THICKNESS * max(width, height) * np.array([-1.0, 0.0] if towards_z else [0.0, 1.0])
    corners = np.stack([0.5 * width * np.array([-1, 1]), 0.5 * height * np.array([-1, 1]), depth], axis=1)
    return PartShape(name="plate", file="plate.stl", units="mm", content=stl_bytes(box_mesh(corners)), corners=corners)
