"""Import photographs that other programs took."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lightopt.cli import _common as common
from lightopt.cli._terminal import echo, echo_warning, show_progress
from lightopt.core.errors import counted
from lightopt.core.run_context import RunContext


def import_(
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="Folder of the photographs: PNG, JPEG, TIFF.")],
    lights: Annotated[Path, typer.Argument(metavar="LIGHTS", help="Table of photographs and their lights (CSV).")],
    out: common.Out,
    camera: Annotated[
        Path,
        common.model_option(
            metavar="FILE", help="Calibration: K, distortion, [R|t]; OpenCV's YAML or JSON, or K as text."
        ),
    ],
    pose: Annotated[
        Path | None, common.model_option(metavar="FILE", help="File of [R|t], if the calibration file has none.")
    ] = None,
    pose_units: Annotated[
        Literal["mm", "cm", "m"], common.model_option(metavar="UNIT", help="Unit of t: mm, cm or m.")
    ] = "mm",
    turn_world: Annotated[
        Literal["x180", "x90", "x-90"] | None,
        common.model_option(
            metavar="TURN", help="Rotate the given world about X so that Z points up: x180, x90, x-90."
        ),
    ] = None,
    mesh: Annotated[Path | None, common.model_option(metavar="FILE", help="The part: a mesh or STEP file.")] = None,
    mesh_units: Annotated[
        Literal["um", "mm", "cm", "m", "inch", "ft"] | None,
        common.model_option(metavar="UNIT", help="Unit of the mesh file: um, mm, cm, m, inch or ft."),
    ] = None,
    sphere: Annotated[
        float | None,
        common.model_option(metavar="RADIUS", min=1e-3, help="The part is a sphere [mm], at the mask's disc."),
    ] = None,
    mask: Annotated[
        Path | None,
        common.model_option(metavar="FILE", help="Image of the part, white on black; the rest is blackened."),
    ] = None,
    gamma: Annotated[
        Literal["linear", "srgb"] | None,
        common.model_option(metavar="NAME", help="Encoding of the levels: linear or srgb.", show_default="linear"),
    ] = None,
    bits: Annotated[
        int | None, common.model_option(metavar="N", help="Bits of the camera, if 16-bit files have fewer: 10, 12, 14.")
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
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
    with show_progress(quiet=quiet) as progress:
        run = RunContext(progress=progress, warn=echo_warning)
        done = import_photographs(images, lights, out, options=options, force=force, run=run)
    if quiet:
        return
    entries, rig, part = done.manifest.images, out / "rig.yaml", out / "part.yaml"
    echo(
        f"{counted(len(entries), 'photograph')} of {done.size[0]} × {done.size[1]} px, {done.manifest.bit_depth} bits, "
        f"under {counted(len({entry.light for entry in entries}), 'light')}: {out / 'manifest.json'}"
    )
    if done.overlap is not None:
        echo(f"mask and part overlap by {done.overlap:.1%}")
    echo(f"next: lightopt check {rig} {part}")
    echo(f"then: lightopt fit-specular {rig} {part} {out} -o {out / 'fitted'} --joint")
