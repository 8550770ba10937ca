"""From a folder of photographs, a table of lights and a calibration to a rig, a part and an image set."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lightopt.config import RigConfig, load_part, load_rig
from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.errors import InputError
from lightopt.core.provenance import file_sha256, files_sha256
from lightopt.core.run_context import RunContext
from lightopt.images import ImageEntry, ImageSetWriter, make_folder, read_photograph, remove_file, write_bytes_atomic
from lightopt.photographs._file_texts import part_text, rig_text
from lightopt.photographs._grey_levels import grey_share, quantised
from lightopt.photographs._inputs import ImportOptions, Inputs, read_inputs
from lightopt.photographs._light_table import TableRow
from lightopt.photographs._placement import place
from lightopt.rendering import cast_rays_at, set_manifest, trace_pixels
from lightopt.scene import Scene, build_scene

_FAR = 1000.0  # a distant light is so many times farther from the origin than any point of the part
_FARTHEST_MM = 1e6
_LOW = 2**14  # levels of 16 bits that all stay below this are probably of fewer bits
_LEAST_OVERLAP = 0.9  # of mask and part; less says that calibration, units or placement are wrong


@dataclass(frozen=True, kw_only=True)
class ImportedSet:
    """What :func:`import_photographs` left on disk.

    overlap: Intersection over union of mask and part; None without a mask
    """

    rig: Path
    part: Path
    manifest: Path
    images: int
    lights: int
    size: tuple[int, int]
    bits: int
    camera: str
    placement: str
    overlap: float | None


def import_photographs(
    folder: Path, table: Path, out: Path, *, options: ImportOptions, force: bool = False, run: RunContext | None = None
) -> ImportedSet:
    """Write rig.yaml, part.yaml and an image set of photographs, so that they are read like captured images.

    folder: Of the photographs
    table: CSV of the lights, as :func:`lightopt.photographs._light_table.read_light_table` reads it
    out: Made where it does not exist
    Raises InputError: Whatever is wrong with table, calibration, images, part or folder, one message per problem
    """
    run = run or RunContext()
    inputs = read_inputs(folder, table, out, options)
    rows, photographs = inputs.rows, inputs.photographs
    placed = place(inputs, options)
    rig_yaml = rig_text(
        inputs,
        placed,
        options,
        name=folder.resolve().name or "photographs",
        table=table.name,
        light_distance=options.light_distance or min(float(f"{_FAR * placed.reach:.3g}"), _FARTHEST_MM),
    )
    files = {"rig.yaml": rig_yaml.encode(), "part.yaml": part_text(inputs, placed).encode()}
    if inputs.shape.content is not None:
        files[inputs.shape.file] = inputs.shape.content
    with _written(out, files, force=force):
        rig, part = load_rig(out / "rig.yaml"), load_part(out / "part.yaml")
        scene = build_scene(rig, part)
        header = set_manifest("captured", rig, part, scene, options=_facts(folder, table, inputs, options))
        plan = [(row.light, row.posture, row.exposure) for row in rows]
        writer = ImageSetWriter(out, header, force=force, plan=plan)
    run.warn(*photographs.notes)
    overlap = None if inputs.mask is None else _overlap(scene, inputs.mask)
    if overlap is not None and overlap < _LEAST_OVERLAP:
        run.warn(
            f"mask and part overlap by {overlap:.0%} only; check [R|t], the units, option 'turn_world' and option 'at'"
        )
    highest = 0.0
    for number, row in enumerate(rows):
        highest = max(highest, _add(writer, rig, row, folder, inputs, options))
        if (progress := run.stage("importing")) is not None:
            progress((number + 1) / len(rows))
    if photographs.bits == 16 and highest < _LOW:
        run.warn(f"no level reaches {_LOW} of 65535; a camera of 10 to 14 bits needs option 'bits'")
    writer.add_warnings(run.warnings)
    return ImportedSet(
        rig=out / "rig.yaml",
        part=out / "part.yaml",
        manifest=out / "manifest.json",
        images=len(rows),
        lights=len(rig.lights),
        size=photographs.size,
        bits=rig.camera.sensor.bit_depth,
        camera=f"at {_point(placed.camera.position)} mm; {placed.camera_from}",
        placement=f"{inputs.shape.name} at {_point(placed.translate)} mm; {placed.part_from}",
        overlap=overlap,
    )


@contextmanager
def _written(out: Path, files: Mapping[str, bytes], *, force: bool) -> Generator[None]:
    """Write files of a folder; those that are new are removed again where what follows raises InputError."""
    taken = [name for name in files if (out / name).exists()]
    other = [name for name in taken if (out / name).read_bytes() != files[name]]
    if other and not force:
        raise InputError(
            f"{out} already has {', '.join(other)} with other content; use option 'force' to overwrite them, or choose "
            "another folder"
        )
    make_folder(out)
    try:
        for name, content in files.items():
            write_bytes_atomic(out / name, content)
        yield
    except InputError:
        for name in files:
            if name not in taken:
                remove_file(out / name)
        raise


def _facts(folder: Path, table: Path, inputs: Inputs, options: ImportOptions) -> dict[str, Any]:
    """Options of an import in JSON form, files by their content."""
    chosen = {key: value for key, value in asdict(options).items() if value is not None}
    hashes = {key: {"sha256": file_sha256(value)} for key, value in chosen.items() if isinstance(value, Path)}
    photographs = files_sha256(folder, [row.image for row in inputs.rows])
    return {**chosen, **hashes, "table": {"sha256": file_sha256(table)}, "photographs": {"sha256": photographs}}


def _overlap(scene: Scene, mask: Bool) -> float:
    pixels = trace_pixels(scene, scene.postures[0], cast_rays_at(scene))
    part = np.zeros_like(mask)
    part[pixels.row, pixels.column] = True
    return float((part & mask).sum() / (part | mask).sum())


def _add(
    writer: ImageSetWriter, rig: RigConfig, row: TableRow, folder: Path, inputs: Inputs, options: ImportOptions
) -> float:
    """Write one photograph, levels as PNG, floating point as EXR, black off the mask; returns its highest sample."""
    photographs = inputs.photographs
    samples = read_photograph(folder / row.image)
    share, full = grey_share(samples, full=photographs.full, gamma=options.gamma or "linear", channel=options.channel)
    if inputs.mask is not None:
        share, full = np.where(inputs.mask, share, np.float32(0.0)), full & inputs.mask
    light = next(light for light in rig.lights if light.name == row.light)
    entry = ImageEntry(
        light=row.light,
        light_elevation_deg=light.elevation_deg,
        light_azimuth_deg=light.azimuth_deg,
        posture=row.posture,
        exposure=row.exposure,
        extra={"photograph": row.image},
    )
    if photographs.bits is not None:
        writer.add_image(entry, png=quantised(share, full, bits=photographs.bits))
    else:
        level: Float32 = share * np.float32(writer.manifest.full_scale / row.exposure)
        writer.add_image(entry, exr={"Y": level, "valid": (~full).astype(np.float32)})
    return float(samples.max())


def _point(point: Float64) -> str:
    return f"({', '.join(f'{round(v, 6) + 0.0:.4g}' for v in point)})"
