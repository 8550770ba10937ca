"""Commands that make images: rendered, for training, imported, or to be shown on a display."""

import math
import re
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Option

from lightopt.cli import _common as common
from lightopt.cli._common import model_option, output_option, selection_option
from lightopt.cli._terminal import echo, echo_paths, run_context, show_table
from lightopt.core.errors import InputError, counted, refuse


def render(
    rig: common.RigFile,
    part: common.PartFile,
    out: common.Out,
    light: common.Lights = None,
    posture: common.Postures = None,
    exposures: common.Exposures = "1",
    points: common.Points = None,
    noise: int | None = model_option(
        None, metavar="SEED", help="Add shot and read noise to the PNGs, with this random seed."
    ),
    shadows: common.Shadows = True,
    defects: bool = model_option(True, "--defects/--no-defects", help="Render the defects listed in PART."),
    supersample: int = model_option(1, metavar="N", min=1, help="Cast N × N rays per pixel."),
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

    Example: lightopt render rig.yaml part.yaml -o out --exposure 1,1/16
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


def dataset(
    rig: common.RigFile,
    part: common.PartFile,
    out: common.Out,
    images: int = Option(..., metavar="N", min=1, help="Number of samples, each of one image per light."),
    seed: int = Option(0, metavar="N", min=0, help="Random seed; the same seed gives the same bytes."),
    ranges: Path | None = model_option(
        None, metavar="FILE", help="What is randomised, and within which limits (YAML).", show_default="see the how-to"
    ),
    exposure: str = model_option("1", metavar="X", help="Relative exposure time, such as 1/4."),
    false_alarms: float = model_option(
        0.05, metavar="N", help="False alarms per posture at which a defect counts as visible."
    ),
    fusion: str = output_option(
        "paper", metavar="RULE", help="Rule of the fused image: paper, median, minimum, second-largest or none."
    ),
    stacks: bool = output_option(False, "--stacks", help="Also write the images of each pose as HDF5 (needs h5py)."),
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Render a labelled training set for defect detectors: good and defective pieces of PART under the lights of RIG.

    Randomises placement, reflectance, gains, waviness, dust, noise and the defects of PART's defect_catalogue. Writes a
    folder per light, and one for the fused image, with MVTec-AD folders (images/), COCO (coco-*.json) and YOLO
    (data.yaml) annotations; normals and the nominal images of each pose; samples.csv with the split; and datasheet.md,
    which says what was randomised. Defects that no detector could find in the noise are marked. The same command
    continues an interrupted run.

    Example: lightopt dataset rig.yaml part.yaml -o set --images 500 --seed 1
    """
    from lightopt.config import load_ranges
    from lightopt.dataset import DatasetOptions, make_dataset

    options = DatasetOptions(
        images=images,
        seed=seed,
        exposure=common.parse_exposure(exposure),
        fusion=None if fusion == "none" else fusion,  # type: ignore[arg-type]  # checked by the library
        stacks=stacks,
        false_alarms=false_alarms,
    )
    refuse(options.problems())
    chosen = None if ranges is None else load_ranges(ranges)
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    with run_context(threads) as run:
        done = make_dataset(loaded_rig, loaded_part, out, options=options, ranges=chosen, force=force, run=run)
    resumed = f" ({done.resumed} of them existed already)" if done.resumed else ""
    echo(f"{counted(done.samples, 'sample')}, {counted(done.images, 'image')}, {counted(done.poses, 'pose')}{resumed}")
    echo(f"{counted(done.defects, 'defect')}, {done.visible} of them visible in the images of their sample")
    echo_paths(*done.files)


def import_(
    images: Annotated[Path, typer.Argument(metavar="IMAGES", help="Folder of the photographs: PNG, JPEG, TIFF.")],
    lights: Annotated[Path, typer.Argument(metavar="LIGHTS", help="Table of photographs and their lights (CSV).")],
    out: common.Out,
    camera: Path = model_option(
        ...,
        metavar="FILE",
        help="Calibration of the camera: camera matrix K [px], distortion coefficients and pose [R|t] from world to "
        "camera, as OpenCV writes them (YAML or JSON); or K alone, as a text of 3 × 3 numbers.",
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
    bits: int | None = model_option(None, metavar="N", help="Camera's bits, if 16-bit files have fewer: 10, 12, 14."),
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


TILTS_DEG = 0.01, 0.03, 0.1
MOST_PIXELS = 20_000


def inverse_pattern(
    rig: common.RigFile,
    part: common.PartFile,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The picture (PNG).")],
    light: str = selection_option(..., metavar="NAME", help="The display, by its name in RIG."),
    posture: str | None = selection_option(
        None, metavar="θ,φ", help="Tilt and rotation of the part [deg].", show_default="the first posture of PART"
    ),
    pixels: str = model_option("64x48", metavar="WxH", help="Columns and rows of the picture."),
    period: float = model_option(
        16.0,
        "--period-px",
        metavar="N",
        min=0.0,
        help="Period of the regular pattern in the camera's image [px]; 0 for a flat one, which hides slopes.",
    ),
    force: common.Force = False,
) -> None:
    """Compute the picture on a display whose reflection in a good part is a regular pattern of known levels.

    An image of a part, less that pattern, is flat but for defects. Writes the picture as a viewer at the part sees it,
    and prints how flat the rendered reflection is, what a tilt of the part adds, and what the defects listed in PART
    add. See docs/how-to/image-series.md.

    Example: lightopt inverse-pattern rig.yaml part.yaml --light lcd -o picture.png
    """
    from lightopt import series
    from lightopt.images import write_png
    from lightopt.scene import build_scene

    columns, rows = _parse_pixels(pixels)
    if out.suffix.lower() != ".png":
        raise InputError(f"option '--out': expected a name that ends in .png, found {out}")
    if 0.0 < period < 2.0:
        raise InputError(f"option '--period-px': expected 0, or at least 2 pixels, found {period:g}")
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    chosen = common.parse_postures(None if posture is None else [posture])
    loaded_rig = loaded_rig.without_programme()
    scene = build_scene(loaded_rig, loaded_part, postures=chosen)
    display = series.display_of(loaded_rig, scene, light)
    with run_context() as run:
        run.warn(*scene.warnings)
        found = series.inverse_pattern(scene, display, pixels=(columns, rows), period_px=period or None)
        tilts = series.tilt_residuals(scene, found, [math.radians(tilt) for tilt in TILTS_DEG])
        shown = series.defects_shown(scene, found)
    facts = {"light": light, "posture": scene.postures[0].as_dict(), "period_px": period, "residual": found.residual}
    write_png(out, found.levels, metadata=facts, overwrite=force)
    mean = float(found.target.mean())
    echo(f"{counted(len(found.row), 'camera pixel')} of the part; mean level {mean:.4g} at exposure 1")
    echo(f"rendered reflection less the pattern: {100.0 * found.residual:.2g} % of the mean level (root mean square)")
    residuals = [[f"{tilt:g}°", f"{100.0 * rest:.2g} %"] for tilt, rest in zip(TILTS_DEG, tilts, strict=True)]
    show_table(["part tilted by", "residual"], residuals)
    if shown:
        show_table(
            ["defect", "greatest change", "over noise"],
            [[one.name, f"{100.0 * one.change:.2g} %", f"{one.over_noise:.3g}"] for one in shown],
        )
    echo(f"{out}")


def _parse_pixels(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    columns, rows = (0, 0) if found is None else (int(found[1]), int(found[2]))
    if min(columns, rows) < 2 or columns * rows > MOST_PIXELS:
        expected = f"columns and rows such as 64x48, at most {MOST_PIXELS:,} in all"
        raise InputError(f"option '--pixels': expected {expected}, found {text!r}")
    return columns, rows
