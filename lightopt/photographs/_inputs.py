"""Inputs of an import: options, table, photographs, calibration, mask and mesh, with all errors at once."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError, counted
from lightopt.core.transforms import rotation_x, rotation_y, rotation_z
from lightopt.core.units import MM_PER_UNIT
from lightopt.images import PhotographFormat, photograph_format, read_photograph
from lightopt.photographs._calibration import Intrinsics, Pose, read_intrinsics, read_pose
from lightopt.photographs._grey_levels import SRGB_BITS, Channel, Gamma, read_mask
from lightopt.photographs._light_table import TableRow, read_light_table
from lightopt.photographs._part import PartShape, mesh_part, plate_part, sphere_part

Value = TypeVar("Value")

_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
_AXES = {"x": rotation_x, "y": rotation_y, "z": rotation_z}
_BITS = (8, 10, 12, 14, 16)


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """What the photographs show and how they were taken.

    camera: Calibration file with K
    pose: File with [R|t]; `camera` unless given
    pose_units: Unit of t
    distance: From the origin to a camera without [R|t] [mm]
    turn_world: Turns about the axes that make Z point up, such as ``x180`` or ``x90,z-45``
    mesh, sphere, plate: The part, one of them: a file, a radius [mm], or width and height [mm]
    at: Where the mesh's origin is, in the frame of [R|t] [mm]
    mask: Image of the pixels that show the part
    light_distance: Of distant lights [mm]
    light_size: Side of the panels [mm]; point lights if None
    bits: Bits of samples that are right-aligned in 16 bits
    """

    camera: Path
    pose: Path | None = None
    pose_units: Literal["mm", "cm", "m"] = "mm"
    distance: float | None = None
    turn_world: str | None = None
    mesh: Path | None = None
    mesh_units: str | None = None
    sphere: float | None = None
    plate: tuple[float, float] | None = None
    at: tuple[float, float, float] | None = None
    mask: Path | None = None
    light_distance: float | None = None
    light_size: float | None = None
    gamma: Gamma | None = None
    channel: Channel = "luminance"
    bits: int | None = None


@dataclass(frozen=True)
class Photographs:
    """What the headers of all photographs say.

    size: Width and height [px]
    full: Sample at full scale
    bits: Of the levels to write; None for floating point
    notes: Warnings
    """

    size: tuple[int, int]
    full: float
    bits: int | None
    bits_from: str
    notes: tuple[str, ...]

    @property
    def sensor_bits(self) -> int:
        """Bit depth of the sensor in the rig."""
        return self.bits or 16


@dataclass(frozen=True)
class Inputs:
    """All that an import reads; rows of the table and the pose are in the world frame.

    turn: From the frame of [R|t], table and mesh to the world's, shape (3, 3)
    mask: Pixels of the part, shape (H, W)
    """

    rows: tuple[TableRow, ...]
    photographs: Photographs
    intrinsics: Intrinsics
    pose: Pose | None
    turn: Float64
    mask: Bool | None
    shape: PartShape


def read_inputs(folder: Path, table: Path, out: Path, options: ImportOptions) -> Inputs:
    """Read all inputs.

    folder: Of the photographs
    out: Of the part file that is written, relative to which meshes are named
    Raises InputError: With one message per problem of all of them
    """
    problems: list[str] = []

    def read(reader: Callable[..., Value], *given: Any) -> Value | None:
        try:
            return reader(*given)
        except InputError as error:
            problems.extend(error.messages)
            return None

    turn = read(_turn, options.turn_world)
    rows = read(read_light_table, table)
    photographs = None if rows is None else read(_photographs, folder, rows, options)
    pose = read(_pose, options)
    if turn is not None:
        pose = pose and Pose(turn @ pose.position, turn @ pose.rotation)
        rows = rows and tuple(replace(row, place=turn @ row.place) for row in rows)
        problems += _below(pose, rows or (), options)
    intrinsics = read(_intrinsics, options.camera, photographs)
    mask = read(_mask, options, photographs, rows or ())
    shape = None if turn is None else read(_shape, options, out, pose, turn)
    if problems or turn is None or rows is None or photographs is None or intrinsics is None or shape is None:
        raise InputError(*dict.fromkeys(problems))  # the camera's file is read twice
    return Inputs(rows, photographs, intrinsics, pose, turn, mask, shape)


def _turn(text: str | None) -> Float64:
    rotation = np.eye(3)
    for step in (text or "x0").split(","):
        match = re.fullmatch(r"\s*([xyz])([-+]?\d+(?:\.\d*)?)\s*", step)
        if match is None:
            raise InputError(
                f"option 'turn_world': expected turns in degrees such as x180 or x90,z-45, found \"{text}\""
            )
        rotation = _AXES[match[1]](np.radians(float(match[2]))) @ rotation
    return rotation


def _photographs(folder: Path, rows: Sequence[TableRow], options: ImportOptions) -> Photographs:
    problems: list[str] = []
    found: list[tuple[TableRow, PhotographFormat]] = []
    for row in rows:
        try:
            found.append((row, photograph_format(folder / row.image)))
        except InputError as error:  # noqa: PERF203
            problems += [f"{row.where}: {message}" for message in error.messages]
    if not found:
        raise InputError(*problems)
    leading, first = found[0]
    for row, one in found:
        kind, expected = (f"{f.width} × {f.height} px, {f.bits or 'floating-point'} bits" for f in (one, first))
        if kind != expected:
            problems.append(f"{row.where}: {row.image}: {kind}; expected {expected} as {leading.image}")
    stored = first.bits
    if options.bits is not None and (stored != 16 or options.bits not in _BITS):
        problems.append(f"option 'bits': expected 10, 12 or 14, of images stored in 16 bits, found {options.bits}")
    elif options.bits is not None:
        highest = max(int(read_photograph(folder / row.image).max()) for row, _ in found)
        if highest >= 2**options.bits:
            problems.append(f"option 'bits': found levels up to {highest}, more than {options.bits} bits have")
    if problems:
        raise InputError(*problems)
    named = {row.image for row in rows} | ({options.mask.name} if options.mask else set())
    others = [p.name for p in sorted(folder.iterdir()) if p.suffix.lower() in _SUFFIXES and p.name not in named]
    bits = options.bits or stored
    bits_from = "as given" if options.bits else "as stored" if stored else "of floating-point images; 1 is full scale"
    if options.gamma == "srgb" and bits == 8:
        bits, bits_from = SRGB_BITS, "of 8-bit sRGB photographs, made linear"
    notes: list[str] = []
    if others:
        notes.append(f"{folder}: {counted(len(others), 'image')} without light, left out: {', '.join(others[:5])}")
    if any(one.compressed for _, one in found):
        notes.append("JPEG is compressed with losses, and cameras write it with gamma: raw images fit better")
    if options.gamma is None and stored == 8:
        notes.append("8-bit levels are read as linear; photographs of ordinary cameras need option 'gamma' srgb")
    full = 1.0 if stored is None else 2.0 ** (options.bits or stored) - 1.0
    return Photographs((first.width, first.height), full, bits, bits_from, tuple(notes))


def _pose(options: ImportOptions) -> Pose | None:
    path = options.pose or options.camera
    unit = MM_PER_UNIT[options.pose_units]
    pose = read_pose(path, mm_per_unit=unit, required=options.pose is not None)
    if pose is not None and options.distance is not None:
        raise InputError(f"option 'distance': {path} has [R|t]; expected only one of them")
    return pose


def _below(pose: Pose | None, rows: Sequence[TableRow], options: ImportOptions) -> Iterator[str]:
    """Problems of a world in which camera or lights are below Z = 0."""
    advice = "Z points up in a rig, from the part to the camera; turn the world with option 'turn_world', such as x180"
    if pose is not None and pose.position[2] <= 0.0:
        yield f"{options.pose or options.camera}: [R|t] puts the camera at Z = {pose.position[2]:.6g} mm; {advice}"
    low = [row for row in rows if row.place[2] <= 0.0]
    if low and len(low) == len(rows):
        yield f"{rows[0].where}: all lights are below Z = 0; {advice}"
    elif low:
        yield from (f'{row.where}: light "{row.light}" is below the part, at Z ≤ 0; remove its row' for row in low)


def _intrinsics(path: Path, photographs: Photographs | None) -> Intrinsics:
    found = read_intrinsics(path)
    if photographs and found.size not in (None, photographs.size):
        calibrated, images = (f"{w} × {h} px" for w, h in (found.size, photographs.size))
        raise InputError(f"{path}: calibrated with {calibrated}, but the photographs have {images}")
    if photographs and not all(0 < c < s for c, s in zip(found.principal_point, photographs.size, strict=True)):
        raise InputError(f"{path}: the principal point is outside the photographs; are they of this camera?")
    return found


def _mask(options: ImportOptions, photographs: Photographs | None, rows: Sequence[TableRow]) -> Bool | None:
    if options.mask is None:
        return None
    mask = read_mask(options.mask)
    size = (mask.shape[1], mask.shape[0])
    if photographs and size != photographs.size:
        mine, theirs = (f"{w} × {h} px" for w, h in (size, photographs.size))
        raise InputError(f"{options.mask}: {mine}, but the photographs have {theirs}")
    if len({row.posture for row in rows}) > 1:
        raise InputError("option 'mask': one mask holds for one posture, but the table has several; leave it out")
    return mask


def _shape(options: ImportOptions, out: Path, pose: Pose | None, turn: Float64) -> PartShape:
    given = [one for one in (options.mesh, options.sphere, options.plate) if one is not None]
    if len(given) != 1:
        raise InputError(f"expected one of option 'mesh', option 'sphere' and option 'plate', found {len(given)}")
    if options.mesh is not None:
        return mesh_part(options.mesh, units=options.mesh_units, folder=out)
    if options.sphere is not None:
        return sphere_part(options.sphere)
    assert options.plate is not None
    if min(options.plate) <= 0.0:
        raise InputError(f"option 'plate': expected width and height above 0, found {options.plate}")
    eye = np.array([0.0, 0.0, 1.0]) if pose is None else pose.position
    return plate_part(*options.plate, towards_z=bool((turn.T @ eye)[2] > 0.0))
