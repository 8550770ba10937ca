from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import Force, Out, PartFile, Quiet, RigFile, make_folder, parse_points
from lightopt.cli._terminal import say, say_warning, show_share, show_table
from lightopt.core.errors import CheckFailed, InputError
from lightopt.core.run_context import RunContext

if TYPE_CHECKING:
    from lightopt.estimate.reflectance import (
        FitFolder,
        FitOptions,
        FitResult,
        FittedValue,
        MeasuredNoise,
        PaperOptions,
    )


Images = Annotated[
    Path, typer.Argument(metavar="IMAGES", help="Image set, rendered or captured: folder or manifest.json.")
]
Method = Annotated[
    str, typer.Option(metavar="NAME", help="likelihood, or paper: sections 4.2 and 4.3. [likelihood]")
]
Free = Annotated[
    list[str] | None,
    typer.Option(
        "--free",
        metavar="WHAT",
        help="Also fit gain (of each light), dark (level) or shift (of the part on the stage); repeatable.",
    ),
]
Pixels = Annotated[
    int, typer.Option(metavar="N", help="About how many pixels to look at, over all images. [1500000]")
]
WriteNoise = Annotated[
    bool, typer.Option("--write-noise", help="Write the noise that the images show into rig.fitted.yaml.")
]
AllowUnconverged = Annotated[
    bool, typer.Option("--allow-unconverged", help="Exit with 0 even where the optimiser did not converge.")
]
Threads = Annotated[
    int | None, typer.Option(metavar="N", help="Threads; all by default. The files do not depend on it.")
]
METHODS = ("likelihood", "paper")
FREE = ("gain", "dark", "shift")


def fit_diffuse(
    rig: RigFile,
    part: PartFile,
    images: Images,
    out: Out,
    method: Method = "likelihood",
    free: Free = None,
    points: Annotated[
        str | None, typer.Option(metavar="M", help="Point lights per panel: 1, 4, 9, … or auto. [the rig's]")
    ] = None,
    pixels: Pixels = 1_500_000,
    lambda_d: Annotated[
        float, typer.Option(metavar="LEVEL", help="Paper's λ_d: difference of mean brightness.")
    ] = 0.01,
    start: Annotated[float, typer.Option(metavar="LEVEL", help="Paper's starting R_d.")] = 10.0,
    away: Annotated[
        float,
        typer.Option(metavar="DEG", help="Paper: diffuse only this far from mirroring a panel, in normals."),
    ] = 20.0,
    write_noise: WriteNoise = False,
    allow_unconverged: AllowUnconverged = False,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Fit R_d to the pixels of IMAGES that are away from every highlight.

    Writes part.fitted.yaml (PART with the fitted value), fit.json and a chart; rig.fitted.yaml where gain or dark is
    freed, or with --write-noise.

    Example: lightopt fit-diffuse rig.yaml part.yaml captured/ -o fitted
    """
    from lightopt.estimate.reflectance import PaperOptions

    paper = PaperOptions(lambda_d=lambda_d, R_d_start=start, away=math.radians(away))
    options = _options("diffuse", method, free, points, pixels, paper, threads, write_noise=write_noise)
    _run("diffuse", rig, part, images, out, options, threads, force, quiet, allow_unconverged)


def fit_specular(
    rig: RigFile,
    part: PartFile,
    images: Images,
    out: Out,
    method: Method = "likelihood",
    joint: Annotated[
        bool, typer.Option("--joint", help="Fit R_d along instead of keeping the part file's.")
    ] = False,
    free: Free = None,
    points: Annotated[
        str | None,
        typer.Option(
            metavar="M,…", help="Point lights per panel, such as auto, or 1,4,9,16 to compare. [the rig's]"
        ),
    ] = None,
    pixels: Pixels = 1_500_000,
    no_validation: Annotated[
        bool, typer.Option("--no-validation", help="Do not predict each light from the others.")
    ] = False,
    lambda_s1: Annotated[
        float, typer.Option(metavar="SHARE", help="Paper's λ_s1: saturated pixels that may differ.")
    ] = 0.005,
    lambda_s2: Annotated[
        float, typer.Option(metavar="SHARE", help="Paper's λ_s2: total brightness that may differ.")
    ] = 0.05,
    sigma_step: Annotated[float, typer.Option(metavar="RAD", help="Paper's σ_step.")] = 0.0025,
    sigma_start: Annotated[float, typer.Option(metavar="RAD", help="Paper's starting σ.")] = 0.01,
    start: Annotated[float, typer.Option(metavar="LEVEL", help="Paper's starting R_s.")] = 255.0,
    write_noise: WriteNoise = False,
    allow_unconverged: AllowUnconverged = False,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Fit R_s and σ to IMAGES, R_d kept from PART or fitted along.

    Writes part.fitted.yaml (PART with the fitted values), fit.json, a chart of the ridge, and pictures of measured
    minus predicted for each light left out in turn; rig.fitted.yaml where gain or dark is freed, or with
    --write-noise.

    Example: lightopt fit-specular rig.yaml part.yaml captured/ -o fitted --joint
    """
    from lightopt.estimate.reflectance import PaperOptions

    paper = PaperOptions(
        lambda_s1=lambda_s1,
        lambda_s2=lambda_s2,
        sigma_step=sigma_step,
        sigma_start=sigma_start,
        R_s_start=start,
    )
    options = _options(
        "specular", method, free, points, pixels, paper, threads, joint=joint, validate=not no_validation,
        write_noise=write_noise,
    )  # fmt: skip
    _run("specular", rig, part, images, out, options, threads, force, quiet, allow_unconverged)


def _run(
    kind: Literal["diffuse", "specular"],
    rig: Path,
    part: Path,
    images: Path,
    out: Path,
    options: FitOptions,
    threads: int | None,
    force: bool,
    quiet: bool,
    allow_unconverged: bool,
) -> None:
    from lightopt.estimate.reflectance import FitFolder, fit_diffuse, fit_provenance, fit_specular
    from lightopt.images import read_image_set
    from lightopt.report import fit_chart

    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    image_set = read_image_set(images)
    arguments: dict[str, Any] = {**vars(options), "kind": kind, "paper": options.paper.as_dict()}
    made_from = fit_provenance(loaded_rig, loaded_part, image_set, arguments)
    folder = FitFolder(out, made_from, force=force)
    make_folder(out)
    with show_share(quiet=quiet) as progress:
        run = RunContext(threads=threads, progress=progress, warn=say_warning)
        if kind == "diffuse":
            result = fit_diffuse(loaded_rig, loaded_part, image_set, options=options, run=run)
        else:
            save = _save_residuals(
                folder, loaded_rig.camera.sensor.bit_depth, loaded_rig.camera.sensor.saturation_level
            )
            result = fit_specular(
                loaded_rig, loaded_part, image_set, options=options, run=run, save_prediction=save
            )
    chart = fit_chart(result, lambda: folder.place("fit.png"))
    written = folder.write(result, loaded_rig, loaded_part)
    if not quiet:
        _show(result)
        for path in (*written, *([chart] if chart else [])):
            say(f"{path}")
    if not result.converged and not allow_unconverged:
        raise CheckFailed(
            "the fit did not converge; its files are written all the same. --allow-unconverged takes it as it is"
        )


def _options(
    kind: str,
    method: str,
    free: list[str] | None,
    points: str | None,
    pixels: int,
    paper: PaperOptions,
    threads: int | None,
    *,
    joint: bool = False,
    validate: bool = True,
    write_noise: bool,
) -> FitOptions:
    from lightopt.config import points_problem
    from lightopt.estimate.reflectance import PAPER_OPTION_FLAGS, FitOptions, PaperOptions

    problems: list[str] = []
    if method not in METHODS:
        problems.append(f'--method: expected likelihood or paper, found "{method}"')
    problems += [
        f'--free: expected {" or ".join(FREE)}, found "{name}"' for name in free or () if name not in FREE
    ]
    if pixels < 1000:
        problems.append(f"--pixels: expected at least 1000, found {pixels}")
    if threads is not None and threads < 1:
        problems.append(f"--threads: expected at least 1, found {threads}")
    chosen: tuple[int | Literal["auto"], ...] = ()
    if points is not None:
        chosen = tuple(parse_points(text.strip()) for text in points.split(","))
    problems += [f"--points: {problem}" for m in chosen if (problem := points_problem(m)) is not None]
    if kind == "diffuse" and len(chosen) > 1:
        problems.append("--points: fit-diffuse takes one number of points; fit-specular compares several")
    problems += paper.problems()
    if method == "likelihood":
        usual = PaperOptions().as_dict()
        changed = [
            PAPER_OPTION_FLAGS[name] for name, value in paper.as_dict().items() if value != usual[name]
        ]
        problems += [f"{name}: belongs to --method paper, which was not asked for" for name in changed]
    if method == "paper" and (free or joint):
        problems.append("--method paper: takes neither --free nor --joint")
    if method == "paper" and write_noise:
        problems.append("--method paper: knows no noise, so that --write-noise has nothing to write")
    if problems:
        raise InputError(*problems)
    return FitOptions(
        method="paper" if method == "paper" else "likelihood",
        joint=joint,
        gain="gain" in (free or ()),
        dark="dark" in (free or ()),
        shift="shift" in (free or ()),
        points=chosen,
        pixels=pixels,
        validate=validate,
        write_noise=write_noise,
        paper=paper,
    )


def _save_residuals(
    folder: FitFolder, bit_depth: int, saturation: float | None
) -> Callable[[Any, Any], None]:
    # a picture of measured minus predicted for each image that was left out
    from lightopt.images import png_name
    from lightopt.report import residual_picture

    full = float(2**bit_depth - 1)

    def save(seen: Any, levels: Any) -> None:
        name = png_name(seen.light, seen.posture, seen.exposure).replace("/", "_")
        residual_picture(
            folder.place(f"left-out/{name}"),
            measured=seen.levels,
            predicted=levels,
            saturated_from=full if saturation is None else saturation,
            full=full,
        )

    return save


def _show(result: FitResult) -> None:
    from lightopt.estimate.reflectance import format_interval

    rows = []
    for value in result.values:
        held = "as in the file" if value.name not in (*result.fitted, "half_angle_rad") else ""
        error = f"{value.standard_error:.2g}" if value.standard_error else ""
        interval = "" if value.interval is None else format_interval(value.interval)
        rows.append([value.name, f"{value.value:.6g}", error, interval or held])
    show_table(["", "value", "std. error", "95 % interval"], rows)
    if result.highlights is not None:
        r_s, sigma = result.highlights
        say(
            f"R_s {r_s:.4g} and σ {sigma:.4g} rad, fitted along to know where the highlights are, are not written"
        )
    if result.paper is not None:
        say(f"from {result.paper.image}; this method knows no uncertainty")
    if result.correlation is not None:
        say(f"correlation of ln R_s and ln σ: {result.correlation:.3f}")
    if result.gains is not None:
        say("gains: " + ", ".join(_with_error(gain) for gain in result.gains.values()))
    if result.dark is not None:
        say(_with_error(result.dark).replace("black_level", "black level:"))
    if result.write_noise and result.noise is not None:
        _show_noise(result.noise)
    if result.placement is not None:
        p = result.placement
        turn, error = math.degrees(p.turn), math.degrees(p.errors[2])
        say(
            f"the part lies {p.x:+.3f} mm in x, {p.y:+.3f} mm in y and {turn:+.3f}° from where its file has it "
            f"(standard errors {p.errors[0]:.1g} mm, {p.errors[1]:.1g} mm, {error:.1g}°)"
        )
    if result.quality is not None:
        q = result.quality
        say(
            f"{result.observations:,} levels of {result.pixels:,} pixels; residual {q.rms:.3g} sensor levels rms ("
            f"noise {q.floor:.2g}), {100.0 * q.epsilon:.2f} % of the pixels unexplained"
        )
    if result.rows:
        _show_points(result)
    if result.left_out:
        _show_left_out(result)


def _with_error(value: FittedValue) -> str:
    if value.interval is None:
        return f"{value.name} {value.value:.4g} (held)"
    return f"{value.name} {value.value:.6g} ± {value.standard_error:.2g}"


def _show_noise(noise: MeasuredNoise) -> None:
    figures = (
        ("read noise {:.3g} ± {:.1g} levels", noise.read_noise, noise.read_noise_error),
        ("{:.4g} ± {:.2g} electrons per level", noise.electrons, noise.electrons_error),
    )
    parts = [text.format(value, error) for text, value, error in figures if value is not None]
    if parts:
        say("noise written: " + ", ".join(parts))


def _show_points(result: FitResult) -> None:
    areas = ["area [px]", "measured", "perimeter [px]", "measured"]
    head = ["m", "R_d", "R_s", "σ [rad]", *areas, "likelihood", ""]
    rows = [
        [
            str(row.points),
            f"{row.R_d:.4g}",
            f"{row.R_s:.6g}",
            f"{row.sigma:.4g}",
            f"{row.area:,}",
            f"{row.measured_area:,}",
            f"{row.perimeter:,.0f}",
            f"{row.measured_perimeter:,.0f}",
            "-" if row.likelihood is None else f"{row.likelihood:.5f}",
            "kept" if row.points == result.points else "",
        ]
        for row in result.rows
    ]
    show_table(head, rows, numbers_from=0)


def _show_left_out(result: FitResult) -> None:
    own = f" ({', '.join(result.not_left_out)} as all images have it)" if result.not_left_out else ""
    say(f"each light predicted from the others{own}:")
    rows = [
        [
            image.image,
            f"{left.R_s:.5g}",
            f"{left.sigma:.4g}",
            f"{image.rms_sensor:.3g}",
            f"{image.rms:.3g}",
            "-" if image.iou is None else f"{image.iou:.4f}",
            "-" if image.border is None else f"{image.border:.2g}",
        ]
        for left in result.left_out
        for image in left.images
    ]
    show_table(
        ["image", "R_s", "σ [rad]", "rms [sensor level]", "rms [grey level]", "IoU", "border [px]"], rows
    )
