from __future__ import annotations

from typing import Annotated

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import (
    Force,
    Lights,
    NoShadows,
    Out,
    PartFile,
    Patches,
    Points,
    Postures,
    Quiet,
    RigFile,
    Sheet,
    Threads,
    parse_exposure,
    parse_points,
    parse_posture,
)
from lightopt.cli._sheets import add_sheets
from lightopt.cli._terminal import say, say_warning, show_share
from lightopt.core.errors import counted
from lightopt.core.run_context import RunContext


def render(
    rig: RigFile,
    part: PartFile,
    out: Out,
    light: Lights = None,
    posture: Postures = None,
    points: Points = None,
    exposure: Annotated[
        list[str] | None,
        typer.Option(
            "--exposure", metavar="X", help="Exposure of the PNGs, such as 1 or 1/16; repeatable. [1]"
        ),
    ] = None,
    noise: Annotated[
        int | None, typer.Option(metavar="SEED", help="Add the sensor's shot and read noise to the PNGs.")
    ] = None,
    layers: Annotated[
        bool, typer.Option("--layers", help="EXR channels diffuse.Y and specular.Y as well.")
    ] = False,
    no_shadows: NoShadows = False,
    no_defects: Annotated[
        bool, typer.Option("--no-defects", help="The good part, without the defects that PART names.")
    ] = False,
    supersample: Annotated[int, typer.Option(metavar="N", help="N × N rays per pixel.")] = 1,
    patches: Patches = None,
    sheet: Sheet = False,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Render what the camera would see of PART on RIG: every light, every posture.

    Writes a linear EXR and the camera's PNG per light and posture, the geometry of each posture (points, normals,
    depth, patch, and defect where PART names any), patches.npz, and manifest.json. Running the same command again
    continues where it was interrupted.

    Example: lightopt render rig.yaml part.yaml -o out --exposure 1 --exposure 1/16
    """
    chosen_postures = tuple(parse_posture(text) for text in posture) if posture else None
    exposures = tuple(parse_exposure(text) for text in exposure) if exposure else (1.0,)
    chosen_points = None if points is None else parse_points(points)

    from lightopt.rendering import DEFAULT_PATCH_BUDGET, RenderOptions, render_image_set

    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    options = RenderOptions(
        lights=tuple(light) if light else None,
        postures=chosen_postures,
        points=chosen_points,
        exposures=exposures,
        noise=noise,
        layers=layers,
        shadows=not no_shadows,
        supersample=supersample,
        defects=not no_defects,
        patch_budget=DEFAULT_PATCH_BUDGET if patches is None else patches,
    )
    with show_share(quiet=quiet) as progress:
        run = RunContext(threads=threads, progress=progress, inform=None if quiet else say, warn=say_warning)
        done = render_image_set(loaded_rig, loaded_part, out, options=options, force=force, run=run)
    if not quiet:
        if done.replaced:
            say(f"replaced the image set that was there ({counted(done.replaced, 'file')})")
        resumed = f" ({done.resumed} of them were there already)" if done.resumed else ""
        say(f"{counted(done.images, 'image')}{resumed}, {done.rays / 1e6:.1f} million rays")
        if done.patches is not None:
            say(done.patches)
        say(f"{done.folder / 'manifest.json'}")
    if sheet:
        title = f"{loaded_part.name} on {loaded_rig.name}"
        add_sheets(out, exposures=exposures, title=title, force=force, quiet=quiet)
