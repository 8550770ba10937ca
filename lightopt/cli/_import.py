"""Import photographs that other programs took."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import model_option
from lightopt.cli._terminal import echo, run_context
from lightopt.core.errors import counted


def import_(
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="Folder of the photographs: PNG, JPEG, TIFF.")],
    lights: Annotated[Path, typer.Argument(metavar="LIGHTS", help="Table of photographs and their lights (CSV).")],
    out: common.Out,
    camera: Path = model_option(
        ..., metavar="FILE", help="Calibration: K, distortion, [R|t]; OpenCV's YAML or JSON, or K as text."
    ),
    pose: Path | None = model_option(None, metavar="FILE", help="File of [R|t], if the calibration file has none."),
    pose_units: Literal["mm", "cm", "m"] = model_option("mm", metavar="UNIT", help="Unit of t: mm, cm or m."),
    turn_world: Literal["x180", "x90", "x-90"] | None = model_option(
        None, metavar="TURN", help="Rotate the given world about X so that Z points up: x180, x90, x-90."
    ),
    mesh: Path | None = model_option(None, metavar="FILE", help="The part: a mesh or STEP file."),
    mesh_units: Literal["um", "mm", "cm", "m", "inch", "ft"] | None = model_option(
        None, metavar="UNIT", help="Unit of the mesh file: um, mm, cm, m, inch or ft."
    ),
    sphere: float | None = model_option(
        None, metavar="RADIUS", min=1e-3, help="The part is a sphere [mm], at the mask's disc."
    ),
    mask: Path | None = model_option(
        None, metavar="FILE", help="Image of the part, white on black; the rest is blackened."
    ),
    gamma: Literal["linear", "srgb"] | None = model_option(
        None, metavar="NAME", help="Encoding of the levels: linear or srgb.", show_default="linear"
    ),
    bits: int | None = model_option(
        None, metavar="N", help="Bits of the camera, if 16-bit files have fewer: 10, 12, 14."
    ),
    force: common.Force = False,
) -> None:
    """Make rig.yaml, part.yaml and an image set from photographs, a table of lights and a camera calibration.

    LIGHTS has the columns image, light, and x, y, z (unit vector to a distant light) or x_mm, y_mm, z_mm (position);
    optional are exposure, intensity, tilt_deg and rotation_deg. OpenCV's conventions are converted. See
    docs/how-to/own-photographs.md.

    Example: lightopt import photos lights.csv --camera calibration.yml --mesh part.stl --mesh-units mm -o set
    """
    from lightopt.photographs import ImportOptions, import_photographs

    options = ImportOptions(
        camera=camera,
        pose=pose,
        pose_units=pose_units,
        turn_world=turn_world,
        mesh=mesh,
        mesh_units=mesh_units,
        sphere=sphere,
        mask=mask,
        gamma=gamma,
        bits=bits,
    )
    with run_context() as run:
        done = import_photographs(images, lights, out, options=options, force=force, run=run)
    entries, rig, part = done.manifest.images, out / "rig.yaml", out / "part.yaml"
    echo(
        f"{counted(len(entries), 'photograph')} of {done.size[0]} × {done.size[1]} px, {done.manifest.bit_depth} bits, "
        f"under {counted(len({entry.light for entry in entries}), 'light')}: {out / 'manifest.json'}"
    )
    if done.overlap is not None:
        echo(f"mask and part overlap by {done.overlap:.1%}")
    echo(f"next: lightopt check {rig} {part}")
    echo(f"then: lightopt fit-specular {rig} {part} {out} -o {out / 'fitted'} --joint")
