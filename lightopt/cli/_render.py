from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._terminal import echo, run_context
from lightopt.core.errors import counted


def render(
    rig: common.RigFile,
    part: common.PartFile,
    out: common.Out,
    light: common.Lights = None,
    posture: common.Postures = None,
    exposures: common.Exposures = "1",
    points: common.Points = None,
    noise: int | None = common.model_option(
        None, metavar="SEED", help="Add shot and read noise to the PNGs, with this random seed."
    ),
    shadows: common.Shadows = True,
    defects: bool = common.model_option(True, "--defects/--no-defects", help="Render the defects listed in PART."),
    supersample: int = common.model_option(1, metavar="N", min=1, help="Cast N × N rays per pixel."),
    bounces: common.Bounces = 0,
    patches: common.Patches = None,
    layers: bool = output_option(False, "--layers", help="Also write the EXR channels diffuse.Y and specular.Y."),
    sheet: common.Sheet = False,
    derived: common.Derived = False,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Render the images that the camera of RIG would take of PART, for each light and posture.

    Writes per light and posture a linear EXR and, for each exposure, the PNG of the camera. Also writes a geometry EXR
    per posture (points, normals, depth, patch numbers, and defect numbers if PART lists defects), patches.npz, and
    manifest.json. The same command continues an interrupted run.

    Example: lightopt render rig.yaml part.yaml -o out --exposures 1,1/16
    """
    from lightopt.rendering import DEFAULT_PATCH_BUDGET, RenderOptions, render_image_set

    options = RenderOptions(
        lights=tuple(light) if light else None,
        postures=common.parse_postures(posture),
        points=common.parse_points(points),
        exposures=common.parse_exposures(exposures),
        noise=noise,
        layers=layers,
        shadows=shadows,
        supersample=supersample,
        defects=defects,
        bounces=bounces,
        patch_budget=DEFAULT_PATCH_BUDGET if patches is None else patches,
    )
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    with run_context(threads) as run:
        done = render_image_set(loaded_rig, loaded_part, out, options=options, force=force, run=run)
    resumed = f" ({done.resumed} of them existed already)" if done.resumed else ""
    echo(f"{counted(done.images, 'image')}{resumed}, {done.rays / 1e6:.1f} million rays")
    if done.replaced:
        echo(f"replaced the existing image set ({counted(done.replaced, 'file')})")
    if done.patches is not None:
        echo(done.patches)
    echo(f"{done.folder / 'manifest.json'}")
    if sheet:
        title = f"{loaded_part.name} on {loaded_rig.name}"
        common.add_sheets(out, loaded_rig, exposures=options.exposures, title=title, force=force)
    if derived:
        common.add_derived(loaded_rig, loaded_part, out, out, force=force)
