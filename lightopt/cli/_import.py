"""Import photographs that other programs took."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from lightopt.cli import _common as common
from lightopt.cli._terminal import echo, echo_warning, show_progress
from lightopt.core.errors import InputError, counted
from lightopt.core.run_context import RunContext


def import_(
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="Folder of the photographs: PNG, JPEG, TIFF, EXR.")],
    lights: Annotated[Path, typer.Argument(metavar="LIGHTS", help="Table of photographs and their lights (CSV).")],
    out: common.Out,
    camera: Annotated[
        Path,
        common.model_option(
            metavar="FILE", help="Calibration: K, distortion, [R|t]; OpenCV's YAML or JSON, NPZ, or K as text."
        ),
    ],
    pose: Annotated[
        Path | None, common.model_option(metavar="FILE", help="File of [R|t], if the calibration file has none.")
    ] = None,
    pose_units: Annotated[
        Literal["mm", "cm", "m"], common.model_option(metavar="UNIT", help="Unit of t: mm, cm or m.")
    ] = "mm",
    distance: Annotated[
        float | None,
        common.model_option(
            metavar="MM", min=1e-3, help="Without [R|t]: distance of the camera, which looks straight down."
        ),
    ] = None,
    turn_world: Annotated[
        str | None,
        common.model_option(metavar="TURNS", help="Rotate the given world so that Z points up: x180, or x90,z-45."),
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
    plate: Annotated[
        str | None, common.model_option(metavar="W,H", help="The part is a flat plate [mm], its face at Z = 0.")
    ] = None,
    at: Annotated[
        str | None, common.model_option(metavar="X,Y,Z", help="Position of the mesh's origin in the given world [mm].")
    ] = None,
    mask: Annotated[
        Path | None,
        common.model_option(metavar="FILE", help="Image of the part, white on black; the rest is blackened."),
    ] = None,
    light_distance: Annotated[
        float | None,
        common.model_option(
            metavar="MM", min=1e-3, help="Distance of distant lights.", show_default="1000 times the part's reach"
        ),
    ] = None,
    light_size: Annotated[
        float | None,
        common.model_option(metavar="MM", min=1e-3, help="Side of the panels.", show_default="point lights"),
    ] = None,
    gamma: Annotated[
        Literal["linear", "srgb"] | None,
        common.model_option(metavar="NAME", help="Encoding of the levels: linear or srgb.", show_default="linear"),
    ] = None,
    channel: Annotated[
        Literal["luminance", "red", "green", "blue"],
        common.model_option(metavar="NAME", help="Grey value of colour photographs: luminance, red, green or blue."),
    ] = "luminance",
    bits: Annotated[
        int | None, common.model_option(metavar="N", help="Bits of the camera, if 16-bit files have fewer: 10, 12, 14.")
    ] = None,
    force: common.Force = False,
    quiet: common.Quiet = False,
    _verbose: common.Verbose = False,
) -> None:
    """Make rig.yaml, part.yaml and an image set from photographs, a table of lights and a camera calibration.

    LIGHTS has the columns image, light, and x, y, z (unit vector to a distant light) or x_mm, y_mm, z_mm (position);
    optional are exposure, intensity and posture ("tilt,rotation" in degrees). OpenCV's conventions are converted. See
    docs/how-to/own-photographs.md.

    Example: lightopt import photos lights.csv --camera calibration.yml --mesh part.stl --mesh-units mm -o set
    """
    from lightopt.photographs import ImportOptions, import_photographs

    size, place = _lengths(plate, 2, "--plate"), _lengths(at, 3, "--at")
    options = ImportOptions(
        camera=camera,
        pose=pose,
        pose_units=pose_units,
        distance=distance,
        turn_world=turn_world,
        mesh=mesh,
        mesh_units=mesh_units,
        sphere=sphere,
        plate=None if size is None else (size[0], size[1]),
        at=None if place is None else (place[0], place[1], place[2]),
        mask=mask,
        light_distance=light_distance,
        light_size=light_size,
        gamma=gamma,
        channel=channel,
        bits=bits,
    )
    with show_progress(quiet=quiet) as progress:
        run = RunContext(progress=progress, warn=echo_warning)
        done = import_photographs(images, lights, out, options=options, force=force, run=run)
    if quiet:
        return
    echo(
        f"{counted(done.images, 'photograph')} of {done.size[0]} × {done.size[1]} px, {done.bits} bits, under "
        f"{counted(done.lights, 'light')}: {done.manifest}"
    )
    echo(f"camera {done.camera}")
    echo(f"part: {done.placement}")
    if done.overlap is not None:
        echo(f"mask and part overlap by {done.overlap:.1%}")
    echo(f"next: lightopt check {done.rig} {done.part}")
    echo(f"then: lightopt fit-specular {done.rig} {done.part} {out} -o {out / 'fitted'} --joint")


def _lengths(text: str | None, count: int, option: str) -> list[float] | None:
    if text is None:
        return None
    try:
        values = [float(value) for value in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) < 1e6 for value in values):
        raise InputError(f'{option}: expected {count} numbers of mm with commas between them, found "{text}"')
    return values
