from typing import Annotated

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import (
    Exposures,
    Force,
    Lights,
    Out,
    PartFile,
    Patches,
    Points,
    Postures,
    Quiet,
    RigFile,
    Shadows,
    Sheet,
    Threads,
    Verbose,
    model_option,
    output_option,
    parse_exposures,
    parse_points,
    parse_postures,
)
from lightopt.cli._sheets import add_sheets
from lightopt.cli._terminal import echo, echo_warning, show_progress
from lightopt.core.errors import counted
from lightopt.core.run_context import RunContext


def render(
    rig: RigFile,
    part: PartFile,
    out: Out,
    light: Lights = None,
    posture: Postures = None,
    exposures: Exposures = "1",
    points: Points = None,
    noise: Annotated[
        int | None, model_option(metavar="SEED", help="Add the sensor's shot and read noise to the PNGs.")
    ] = None,
    shadows: Shadows = True,
    defects: Annotated[bool, model_option("--defects/--no-defects", help="Show the defects that PART names.")] = True,
    supersample: Annotated[int, model_option(metavar="N", min=1, help="Cast N × N rays per pixel.")] = 1,
    patches: Patches = None,
    layers: Annotated[
        bool, output_option("--layers", help="Write EXR channels diffuse.Y and specular.Y as well.")
    ] = False,
    sheet: Sheet = False,
    force: Force = False,
    threads: Threads = None,
    quiet: Quiet = False,
    _verbose: Verbose = False,
) -> None:
    """Render what the camera would see of PART on RIG: every light, every posture.

    Writes a linear EXR and the camera's PNG per light and posture, the geometry of each posture (points, normals,
    depth, patch, and defect where PART names any), patches.npz, and manifest.json. Running the same command again
    continues where it was interrupted.

    Example: lightopt render rig.yaml part.yaml -o out --exposures 1,1/16
    """
    chosen_postures = parse_postures(posture)
    chosen_exposures = parse_exposures(exposures)
    chosen_points = parse_points(points)

    from lightopt.rendering import DEFAULT_PATCH_BUDGET, RenderOptions, render_image_set

    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    options = RenderOptions(
        lights=tuple(light) if light else None,
        postures=chosen_postures,
        points=chosen_points,
        exposures=chosen_exposures,
        noise=noise,
        layers=layers,
        shadows=shadows,
        supersample=supersample,
        defects=defects,
        patch_budget=DEFAULT_PATCH_BUDGET if patches is None else patches,
    )
    with show_progress(quiet=quiet) as progress:
        run = RunContext(threads=threads, progress=progress, warn=echo_warning)
        done = render_image_set(loaded_rig, loaded_part, out, options=options, force=force, run=run)
    if not quiet:
        resumed = f" ({done.resumed} of them were there already)" if done.resumed else ""
        echo(f"{counted(done.images, 'image')}{resumed}, {done.rays / 1e6:.1f} million rays")
        if done.replaced:
            echo(f"replaced the image set that was there ({counted(done.replaced, 'file')})")
        if done.patches is not None:
            echo(done.patches)
        echo(f"{done.folder / 'manifest.json'}")
    if sheet:
        title = f"{loaded_part.name} on {loaded_rig.name}"
        add_sheets(out, exposures=chosen_exposures, title=title, force=force, quiet=quiet)
