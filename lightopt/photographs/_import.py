"""From a folder of photographs, a table of lights and a calibration to a rig, a part and an image set."""

import json
import math
import os.path
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightopt import images
from lightopt.config import load_part, load_rig, standing_at
from lightopt.core.arrays import Bool, Float64, UInt8
from lightopt.core.errors import InputError, collected, counted, refuse
from lightopt.core.provenance import file_sha256, files_sha256
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import rotation_x, vector_of_rotation
from lightopt.core.units import MM_PER_UNIT
from lightopt.geometry import UNITLESS_SUFFIXES, sphere_mesh, stl_bytes
from lightopt.photographs._input_files import Intrinsics, Pose, TableRow, read_intrinsics, read_light_table, read_pose
from lightopt.rendering import cast_rays_at, set_manifest, trace_pixels
from lightopt.scene import Distortion, Scene, build_scene, pixel_directions, pose_camera

_ROUND = 0.02  # share of its radius by which a disc's outline may be off a circle


@dataclass(frozen=True, kw_only=True)
class PhotographedPart:
    name: str
    file: str  # as the part file names it
    units: str | None = "mm"
    content: bytes | None = None  # of a generated file; None for one of the user
    # from the mesh's frame to the world's
    rotate_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translate_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


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
        raise InputError(f"option 'mask': off a circle by {off:.0%} of the radius; expected the disc of the sphere")
    return axis * (radius / sine)


def _outline(mask: Bool) -> tuple[Float64, Float64]:
    """Columns and rows [px] of the middles of all pixel sides between the mask and what is around it."""
    rows, columns = np.nonzero(mask[:, 1:] != mask[:, :-1])
    below, beside = np.nonzero(mask[1:] != mask[:-1])
    across = np.concatenate([columns + 1.0, beside + 0.5], dtype=np.float64)
    return across, np.concatenate([rows + 0.5, below + 1.0], dtype=np.float64)


_FAR_MM = 1e6  # a distant light: its direction differs by less than 0.06° over a part of 1 m
Turn = Literal["x180", "x90", "x-90"]
_DOWN = np.diag([1.0, -1.0, -1.0])  # axes of a camera that looks straight down with the world's X to the right
_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # ITU-R BT.709-6, section 3.2
_SRGB_BITS = 12  # of linear levels of 8-bit sRGB samples: enough that no two become one
_LOW = 2**14  # levels of 16 bits that all stay below this are probably of fewer bits
_LEAST_OVERLAP = 0.9  # of mask and part; less says that calibration, units or placement are wrong


def rig_text(
    name: str, rows: Sequence[TableRow], intrinsics: Intrinsics, pose: Pose, *, size: tuple[int, int], bits: int
) -> str:
    """Rig file of photographs of a size [px] and of so many bits."""
    lights = list({row.light: row for row in rows}.values())
    near = [float(np.linalg.norm(row.place)) for row in lights if row.near]
    mean = sum(near) / max(len(near), 1)
    reference = f"  reference_distance_mm: {mean:.9g} # of near lights: the mean of their distances\n" if near else ""
    distortion = ", ".join(f"{name}: {value:.9g}" for name, value in intrinsics.distortion.items())
    return f"""# Written by lightopt import. Lengths in mm, angles in degrees, Z up.

format: lightopt-rig/1
name: {_quoted(name)}

camera:
  pose:
    position_mm: {_list(pose.position)}
    rotation_vector_deg: {_list(np.degrees(vector_of_rotation(pose.rotation)))}
  resolution_px: [{size[0]}, {size[1]}]
  pixel_size_um: 3.45           # assumed; images do not depend on it
  focal_px: {_list(intrinsics.focal)}
  principal_point_px: {_list(intrinsics.principal_point)} # the first pixel's centre is at 0.5, 0.5
  distortion: {{{distortion}}}
  sensor:                       # its noise is not known; --write-noise of the fits adds it
    bit_depth: {bits}

light_source:
  size_mm: [1, 1]
  points: 1                     # size not known: single points; give size_mm and auto if it is
  falloff: none                 # of distant lights: brightness does not depend on the distance
{reference}
lights:                         # gain is the column intensity, 1 without it
{chr(10).join(map(_light, lights))}
"""


def _light(row: TableRow) -> str:
    at = standing_at([float(v) for v in row.place * (1.0 if row.near else _FAR_MM)])
    at["distance_mm"] = at["distance_mm"] if row.near else _FAR_MM
    place = ", ".join(f"{key}: {value:.9g}" for key, value in at.items())
    falloff = ", falloff: inverse_square" if row.near else ""
    return f'  - {{name: "{row.light}", {place}, gain: {row.intensity:.9g}{falloff}}}'


def part_text(part: PhotographedPart, rows: Sequence[TableRow]) -> str:
    postures = [
        f"  - {{elevation_deg: {p.elevation_deg:.9g}, rotation_deg: {p.rotation_deg:.9g}}}"
        for p in dict.fromkeys(row.posture for row in rows)
    ]
    return f"""# Written by lightopt import.

format: lightopt-part/1
name: {_quoted(part.name)}

mesh:
  file: {_quoted(part.file)}
{f"  units: {part.units}" if part.units else ""}

placement:
  anchor: as_modelled
  rotate_deg: {_list(part.rotate_deg)}
  translate_mm: {_list(part.translate_mm)}

postures:
{chr(10).join(postures)}

reflectance:                    # not known yet: fit-diffuse and fit-specular find it
  R_d: 50
  R_s: 1000
  sigma_rad: 0.05
"""


def _list(values: Iterable[float]) -> str:
    return "[" + ", ".join(f"{round(float(v), 9) + 0.0:.12g}" for v in values) + "]"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """What the photographs show and how they were taken."""

    camera: Path  # calibration file with K
    pose: Path | None = None  # file with [R|t]; `camera` unless given
    pose_units: Literal["mm", "cm", "m"] = "mm"  # of t
    turn_world: Turn | None = None  # rotation about X [deg] that makes Z point up
    mesh: Path | None = None  # the part: a file, or a sphere
    mesh_units: str | None = None
    sphere: float | None = None  # its radius [mm]
    mask: Path | None = None  # image of the pixels that show the part
    gamma: Literal["linear", "srgb"] | None = None  # encoding; linear if None, with a warning for 8 bits
    bits: int | None = None  # of samples that are right-aligned in 16 bits

    @property
    def turn_deg(self) -> float:
        return float((self.turn_world or "x0").removeprefix("x"))


@dataclass(frozen=True, kw_only=True)
class ImportedSet:
    manifest: images.Manifest
    size: tuple[int, int]
    overlap: float | None  # intersection over union of mask and part; None without a mask


def import_photographs(
    folder: Path, table: Path, out: Path, *, options: ImportOptions, force: bool = False, run: RunContext | None = None
) -> ImportedSet:
    """Write rig.yaml, part.yaml and an image set of photographs, so that they are read like captured images.

    Raises InputError: Table, calibration, images, part or output folder are not as expected
    """
    run = run or RunContext()
    rows = read_light_table(table)
    shape = _common_format(folder, rows, options)
    intrinsics = _intrinsics(options.camera, shape)
    mask = None if options.mask is None else _mask(options.mask, shape, rows)
    pose = read_pose(options.pose or options.camera, mm_per_unit=MM_PER_UNIT[options.pose_units])
    turn = rotation_x(math.radians(options.turn_deg))
    pose = pose and Pose(turn @ pose.position, turn @ pose.rotation)
    rows = tuple(replace(row, place=turn @ row.place) for row in rows)
    pose, part = _placed(pose, mask, intrinsics, out, options)
    _refuse_below(pose, rows, options)
    bits = _SRGB_BITS if options.gamma == "srgb" and shape.bits == 8 else options.bits or shape.bits

    images.make_folder(out)
    size = (shape.width, shape.height)
    rig_yaml = rig_text(folder.resolve().name, rows, intrinsics, pose, size=size, bits=bits)
    files = {"rig.yaml": rig_yaml.encode(), "part.yaml": part_text(part, rows).encode()}
    if part.content is not None:
        files[part.file] = part.content
    for name, content in files.items():
        images.write_bytes_atomic(out / name, content, overwrite=force)
    rig_config, part_config = load_rig(out / "rig.yaml"), load_part(out / "part.yaml")
    scene = build_scene(rig_config, part_config)
    # options in JSON form, files by their content
    chosen = {**asdict(options), "table": table}
    facts = {key: file_sha256(value) if isinstance(value, Path) else value for key, value in chosen.items()}
    facts["photographs"] = files_sha256(folder, [row.image for row in rows])
    header = set_manifest("captured", rig_config, part_config, scene, options=facts)
    plan = [(row.light, row.posture, row.exposure) for row in rows]
    writer = images.ImageSetWriter(out, header, force=force, plan=plan)
    _warn_of_photographs(folder, rows, shape, options, run)
    overlap = None if mask is None else _overlap(scene, mask)
    if overlap is not None and overlap < _LEAST_OVERLAP:
        run.warn(f"mask and part overlap by {overlap:.0%} only; check [R|t], the units and option 'turn_world'")
    lights = {light.name: light for light in rig_config.lights}
    highest = 0
    for number, row in enumerate(rows):
        samples = images.read_photograph(folder / row.image)
        highest = max(highest, int(samples.max()))
        full = 2 ** (options.bits or shape.bits) - 1
        levels = _grey_levels(samples, full=full, srgb=options.gamma == "srgb", bits=bits)
        if mask is not None:
            levels[~mask] = 0
        angles = lights[row.light].elevation_deg, lights[row.light].azimuth_deg
        extra = {"photograph": row.image}
        entry = images.ImageEntry(row.light, *angles, posture=row.posture, exposure=row.exposure, extra=extra)
        writer.add_image(entry, png=levels)
        run.stage("importing")((number + 1) / len(rows))
    if shape.bits == 16 and highest < _LOW and options.bits is None:
        run.warn(f"no level reaches {_LOW} of 65535; a camera of 10 to 14 bits needs option 'bits'")
    writer.add_warnings(run.warnings)
    return ImportedSet(manifest=writer.manifest, size=size, overlap=overlap)


def _common_format(folder: Path, rows: Sequence[TableRow], options: ImportOptions) -> images.PhotographFormat:
    problems: list[str] = []
    first: images.PhotographFormat | None = None
    for row in rows:
        with collected(problems, where=row.where):
            shape = images.photograph_format(folder / row.image)
            first = first or shape
            if shape != first:
                raise InputError(f"{row.image}: {shape}; expected {first} as the photographs above")
    if first is None or problems:
        raise InputError(*problems)
    if options.bits is not None:
        if first.bits != 16 or options.bits not in (10, 12, 14, 16):
            raise InputError(f"option 'bits': expected 10, 12 or 14, of images stored in 16 bits, found {options.bits}")
        highest = max(int(images.read_photograph(folder / row.image).max()) for row in rows)
        if highest >= 2**options.bits:
            raise InputError(f"option 'bits': found levels up to {highest}, more than {options.bits} bits have")
    return first


def _intrinsics(path: Path, shape: images.PhotographFormat) -> Intrinsics:
    found = read_intrinsics(path)
    if found.size not in (None, (shape.width, shape.height)):
        calibrated = f"{found.size[0]} × {found.size[1]} px"
        raise InputError(f"{path}: calibrated with {calibrated}, but the photographs have {shape}")
    if not (0 < found.principal_point[0] < shape.width and 0 < found.principal_point[1] < shape.height):
        raise InputError(f"{path}: the principal point is outside the photographs; are they of this camera?")
    return found


def _mask(path: Path, shape: images.PhotographFormat, rows: Sequence[TableRow]) -> Bool:
    # pixels of the part, of half of full scale or more
    samples = images.read_photograph(path)
    mask: Bool = samples.max(axis=2) > np.iinfo(samples.dtype).max // 2
    if mask.all() or not mask.any():
        colour = "white" if mask.all() else "black"
        raise InputError(f"{path}: the mask is all {colour}; expected the part white on black")
    if mask.shape != (shape.height, shape.width):
        raise InputError(f"{path}: {mask.shape[1]} × {mask.shape[0]} px, but the photographs have {shape}")
    if len({row.posture for row in rows}) > 1:
        raise InputError("option 'mask': one mask holds for one posture, but the table has several; leave it out")
    return mask


def _placed(
    pose: Pose | None, mask: Bool | None, intrinsics: Intrinsics, out: Path, options: ImportOptions
) -> tuple[Pose, PhotographedPart]:
    """Camera and part; without [R|t] the camera looks straight down at a sphere that rests on the origin."""
    if options.sphere is not None:
        if options.mesh is not None:
            raise InputError("expected only one of option 'mesh' and option 'sphere'")
        if mask is None:
            raise InputError("option 'sphere': expected option 'mask', whose disc says where it is")
        centre = sphere_in_mask(mask, intrinsics, options.sphere)
        pose = pose or Pose(np.array([0.0, 0.0, options.sphere + float(centre[2])]), _DOWN)
        x, y, z = (pose.position + pose.rotation @ centre).tolist()
        content = stl_bytes(sphere_mesh(options.sphere))
        return pose, PhotographedPart(name="sphere", file="sphere.stl", content=content, translate_mm=(x, y, z))
    if options.mesh is None:
        raise InputError("expected option 'mesh' or option 'sphere': the part")
    if pose is None:
        where = options.pose or options.camera
        raise InputError(f"{where}: expected [R|t], as rvec and tvec, R and T, or 3 × 4 numbers (option 'pose')")
    if not options.mesh.is_file():
        raise InputError(f"{options.mesh}: no such file; expected a mesh or STEP file")
    if (suffix := options.mesh.suffix).lower() in UNITLESS_SUFFIXES and options.mesh_units is None:
        raise InputError(f"option 'mesh_units': expected the unit of {options.mesh}: {suffix} files carry none")
    path, folder = options.mesh.resolve(), out.resolve()
    file = Path(os.path.relpath(path, folder) if path.drive == folder.drive else path).as_posix()
    turned = (options.turn_deg, 0.0, 0.0)
    return pose, PhotographedPart(name=path.stem, file=file, units=options.mesh_units, rotate_deg=turned)


def _refuse_below(pose: Pose, rows: Sequence[TableRow], options: ImportOptions) -> None:
    advice = "Z points up in a rig, from the part to the camera; turn the world with option 'turn_world', such as x180"
    problems: list[str] = []
    if pose.position[2] <= 0.0:
        where = options.pose or options.camera
        problems.append(f"{where}: [R|t] puts the camera at Z = {pose.position[2]:.6g} mm; {advice}")
    low = [row for row in rows if row.place[2] <= 0.0]
    if low and len(low) == len(rows):
        problems.append(f"{rows[0].where}: all lights are below Z = 0; {advice}")
    else:
        problems += [f'{row.where}: light "{row.light}" is below the part, at Z ≤ 0; remove its row' for row in low]
    refuse(problems)


def _warn_of_photographs(
    folder: Path, rows: Sequence[TableRow], shape: images.PhotographFormat, options: ImportOptions, run: RunContext
) -> None:
    named = {row.image for row in rows} | ({options.mask.name} if options.mask else set())
    others = [p.name for p in sorted(folder.iterdir()) if p.suffix.lower() in _SUFFIXES and p.name not in named]
    if others:
        run.warn(f"{folder}: {counted(len(others), 'image')} without light, left out: {', '.join(others[:5])}")
    if options.gamma is None and shape.bits == 8:
        run.warn("8-bit levels are read as linear; photographs of ordinary cameras need option 'gamma' srgb")


def _overlap(scene: Scene, mask: Bool) -> float:
    pixels = trace_pixels(scene, scene.postures[0], cast_rays_at(scene))
    part = np.zeros_like(mask)
    part[pixels.row, pixels.column] = True
    return float((part & mask).sum() / (part | mask).sum())


def _grey_levels(samples: NDArray[Any], *, full: int, srgb: bool, bits: int) -> UInt8 | NDArray[np.uint16]:
    # linear grey levels of so many bits, shape (H, W), of samples as stored, shape (H, W, 1 or 3); the highest where a
    # channel is at `full` scale
    value = samples.astype(np.float32) / np.float32(full)
    if srgb:
        # IEC 61966-2-1, section 5.2
        decoded = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        value = decoded.astype(np.float32)
    grey = value @ _LUMINANCE if value.shape[2] == 3 else value[..., 0]
    top = 2**bits - 1
    levels = np.floor(grey * np.float32(top) + np.float32(0.5))
    levels[np.any(value >= 1.0, axis=2)] = top
    return levels.astype(np.uint8) if bits <= 8 else levels.astype(np.uint16)
