from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import AS_PART, AS_RIG, model_option, output_option
from lightopt.cli._terminal import VERBOSE, echo, echo_paths, flag, run_context, show_table
from lightopt.core.errors import CheckFailed, refuse

if TYPE_CHECKING:
    from lightopt.config import RigConfig
    from lightopt.estimate.reflectance import FitOptions, FitResult, FittedValue
    from lightopt.images import ResultFolder


paper_option = partial(typer.Option, rich_help_panel="The paper's procedure (--method paper)")

_METHOD_HELP = "Maximum likelihood, or the procedure of the paper (docs/how-to/fitting.md)."
Method = Annotated[Literal["likelihood", "paper"], typer.Option(metavar="likelihood|paper", help=_METHOD_HELP)]
_FREE_HELP = "Also fit the gain of each light, or the dark level; repeatable."
Free = Annotated[list[str] | None, model_option("--free", metavar="gain|dark", help=_FREE_HELP)]
Pixels = Annotated[int, model_option(metavar="N", min=1000, help="Target number of pixels, over all images.")]
_NOISE_HELP = "Write the noise measured in the images to rig.fitted.yaml."
WriteNoise = Annotated[bool, output_option("--write-noise", help=_NOISE_HELP)]
_UNCONVERGED_HELP = "Exit with status 0 even if the fit did not converge."
AllowUnconverged = Annotated[bool, output_option("--allow-unconverged", help=_UNCONVERGED_HELP)]
Model = Literal["torrance-sparrow", "ggx", "two-lobe", "auto"]
Diffuse = Literal["lambert", "exponent", "oren-nayar"]


def fit_diffuse(
    rig: common.RigFile,
    part: common.PartFile,
    images: common.Images,
    out: common.Out,
    method: Method = "likelihood",
    register: common.Register = False,
    free: Free = None,
    points: common.Points = None,
    pixels: Pixels = 1_500_000,
    lambda_d: float = paper_option(0.01, metavar="LEVEL", help="λ_d: tolerance of the mean brightness."),
    start_rd: float = paper_option(10.0, metavar="LEVEL", help="Starting value of R_d."),
    highlight_margin: float = paper_option(
        20.0, metavar="DEG", help="Least angle between a used pixel's normal and any normal that mirrors a panel."
    ),
    write_noise: WriteNoise = False,
    allow_unconverged: AllowUnconverged = False,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Fit the diffuse coefficient R_d to the pixels of IMAGES outside all highlights.

    Writes part.fitted.yaml (PART with the fitted value) and fit.json. With --free or --write-noise it also writes
    rig.fitted.yaml. With --method paper it also writes a chart, fit.png.

    Example: lightopt fit-diffuse rig.yaml part.yaml captured/ -o fitted
    """
    from lightopt.estimate.reflectance import FitOptions, PaperOptions

    paper = PaperOptions(lambda_d=lambda_d, R_d_start=start_rd, away=math.radians(highlight_margin))
    options = FitOptions(method=method, register=register, pixels=pixels, write_noise=write_noise, paper=paper)
    options = _complete("diffuse", options, free, points)
    _run("diffuse", (rig, part, images, out), options, force, threads, allow_unconverged)


def fit_specular(
    rig: common.RigFile,
    part: common.PartFile,
    images: common.Images,
    out: common.Out,
    method: Method = "likelihood",
    joint: bool = model_option(False, "--joint", help="Fit R_d as well, instead of taking it from PART."),
    register: common.Register = False,
    free: Free = None,
    points: str | None = model_option(
        None,
        metavar="M,…",
        help=f"{common.POINTS_HELP} With a list such as 1,4,9, fit each number and select the best.",
        show_default=AS_RIG,
    ),
    pixels: Pixels = 1_500_000,
    model: Model | None = model_option(
        None,
        metavar="|".join(get_args(Model)),
        help="Form of the specular lobe; auto: the one that predicts left-out lights best.",
        show_default=AS_PART,
    ),
    diffuse: Diffuse | None = model_option(
        None,
        metavar="|".join(get_args(Diffuse)),
        help="Form of the diffuse component. exponent, oren-nayar: fit the exponent or the roughness as well.",
        show_default=AS_PART,
    ),
    validate: bool = model_option(
        True, "--validate/--no-validate", help="Cross-validate: predict each light from the others."
    ),
    lambda_s1: float = paper_option(0.005, metavar="SHARE", help="λ_s1: tolerance of the number of saturated pixels."),
    lambda_s2: float = paper_option(0.05, metavar="SHARE", help="λ_s2: tolerance of the total specular brightness."),
    start_rs: float = paper_option(255.0, metavar="LEVEL", help="Starting value of R_s."),
    start_sigma: float = paper_option(0.01, metavar="RAD", help="Starting value of σ."),
    sigma_step: float = paper_option(0.0025, metavar="RAD", help="σ_step: increment of σ."),
    write_noise: WriteNoise = False,
    allow_unconverged: AllowUnconverged = False,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Fit the specular coefficient R_s and the roughness σ to IMAGES. Take R_d from PART, or fit it too with --joint.

    Writes part.fitted.yaml (PART with the fitted values), fit.json, a chart of the fit over σ (fit.png), and pictures
    of measured minus predicted levels (left-out/), in which each light is predicted from the other lights. With --free
    or --write-noise it also writes rig.fitted.yaml.

    Example: lightopt fit-specular rig.yaml part.yaml captured/ -o fitted --joint
    """
    from lightopt.estimate.reflectance import FitOptions, PaperOptions

    start = {"sigma_start": start_sigma, "R_s_start": start_rs}
    paper = PaperOptions(lambda_s1=lambda_s1, lambda_s2=lambda_s2, sigma_step=sigma_step, **start)
    options = FitOptions(method=method, register=register, pixels=pixels, write_noise=write_noise, paper=paper)
    options = replace(options, joint=joint, validate=validate, model=model, diffuse=diffuse)
    options = _complete("specular", options, free, points)
    _run("specular", (rig, part, images, out), options, force, threads, allow_unconverged)


def _run(
    kind: Literal["diffuse", "specular"],
    paths: tuple[Path, Path, Path, Path],
    options: FitOptions,
    force: bool,
    threads: int | None,
    allow_unconverged: bool,
) -> None:
    from lightopt.estimate.reflectance import fit_diffuse, fit_folder, fit_specular, write_fit
    from lightopt.images import make_folder, read_image_set
    from lightopt.report import fit_chart

    rig, part, images, out = paths
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    image_set = read_image_set(images)
    arguments: dict[str, Any] = {**vars(options), "kind": kind, "paper": vars(options.paper)}
    folder = fit_folder(out, loaded_rig, loaded_part, image_set, arguments, force=force)
    make_folder(out)
    with run_context(threads) as run:
        if kind == "diffuse":
            result = fit_diffuse(loaded_rig, loaded_part, image_set, options=options, run=run)
        else:
            save = _save_residuals(folder, loaded_rig)
            result = fit_specular(loaded_rig, loaded_part, image_set, options=options, save_prediction=save, run=run)
    chart = fit_chart(result, lambda: folder.place("fit.png"))
    written = write_fit(folder, result, loaded_rig, loaded_part)
    _show(result)
    echo_paths(*written, *([chart] if chart else []))
    if not (result.converged or allow_unconverged):
        raise CheckFailed("the fit did not converge; its files were written. To accept it, use --allow-unconverged")


def _complete(kind: str, options: FitOptions, free: Sequence[str] | None, points: str | None) -> FitOptions:
    """The options with what else is fitted and the numbers of points; InputError where they exclude each other."""
    from lightopt.config import points_problem
    from lightopt.estimate.reflectance import PaperOptions

    wrong = [name for name in free or () if name not in ("gain", "dark")]
    problems = [f'--free: expected gain or dark, found "{name}"' for name in wrong]
    texts = [] if points is None else [text.strip() for text in points.split(",")]
    if kind == "diffuse" and len(texts) > 1:
        problems.append("--points: fit-diffuse takes one number of points; fit-specular compares several")
    chosen = tuple(m for text in texts if (m := common.parse_points(text)) is not None)
    problems += [f"--points: {problem}" for m in chosen if (problem := points_problem(m)) is not None]
    problems += options.paper.problems()
    if options.method == "likelihood":
        usual = vars(PaperOptions())
        changed = [flag(name) for name, value in vars(options.paper).items() if value != usual[name]]
        problems += [f"{name}: has no effect without --method paper" for name in changed]
    elif options.model == "auto":
        problems.append("--method paper: knows one Gaussian lobe; omit --model auto")
    elif free or options.joint or options.register:
        problems.append("--method paper: cannot be combined with --free, --joint or --register")
    elif options.write_noise:
        problems.append("--method paper: estimates no noise; omit --write-noise")
    refuse(problems)
    return replace(options, gain="gain" in (free or ()), dark="dark" in (free or ()), points=chosen)


def _save_residuals(folder: ResultFolder, rig: RigConfig) -> Callable[[Any, Any], None]:
    # a picture of measured minus predicted for each image that was left out
    from lightopt.images import png_name
    from lightopt.report import residual_picture
    from lightopt.scene import build_sensor

    sensor = build_sensor(rig.camera)
    scale = {"saturated_from": float(sensor.saturated_from), "full": float(sensor.max_level)}

    def save(seen: Any, levels: Any) -> None:
        name = png_name(seen.light, seen.posture, seen.exposure).replace("/", "_")
        residual_picture(folder.place(f"left-out/{name}"), measured=seen.levels, predicted=levels, **scale)

    return save


def _show(result: FitResult) -> None:
    from lightopt.estimate.reflectance import format_interval

    rows = []
    fits = [("", result), *((f"{one.name}: ", one.result) for one in result.regions if one.result is not None)]
    for prefix, fit in fits:
        for value in fit.values:
            fitted = value.name in (*fit.fitted, "half_angle_rad")
            if prefix and value.name not in fit.fitted and not VERBOSE.get():
                continue
            held = "" if fitted else "as in the file"
            error = f"{value.standard_error:.2g}" if value.standard_error else ""
            interval = held if value.interval is None else format_interval(value.interval) or held
            rows.append([prefix + value.name, f"{value.value:.6g}", error, interval])
    show_table(["", "value", "std. error", "95 % interval"], rows)
    if result.highlights is not None:
        r_s, sigma = result.highlights
        echo(f"R_s {r_s:.6g} and σ {sigma:.4g} rad were fitted only to locate the highlights; they are not written")
    if result.paper is not None:
        echo(f"from {result.paper.image}; this method gives no uncertainty")
    if result.correlation is not None:
        echo(f"correlation of ln R_s and ln σ: {result.correlation:.3f}")
    if result.gains is not None:
        echo("gains: " + ", ".join(_with_error(gain) for gain in result.gains.values()))
    if result.dark is not None:
        echo(_with_error(result.dark).replace("black_level", "black level:"))
    if result.write_noise and (noise := result.noise) is not None:
        figures = (
            ("read noise {:.3g} ± {:.1g} levels", noise.read_noise_levels, noise.read_noise_standard_error),
            ("{:.4g} ± {:.2g} electrons per level", noise.electrons_per_level, noise.electrons_standard_error),
        )
        if parts := [text.format(value, error) for text, value, error in figures if value is not None]:
            echo("noise written: " + ", ".join(parts))
    if (p := result.placement) is not None:
        turn, error = math.degrees(p.turn), math.degrees(p.errors[2])
        echo(
            f"placement: the part is displaced by {p.x:+.3f} mm in x, {p.y:+.3f} mm in y and rotated by {turn:+.3f}° "
            f"(standard errors {p.errors[0]:.1g} mm, {p.errors[1]:.1g} mm, {error:.1g}°)"
        )
    if (q := result.quality) is not None:
        echo(
            f"{result.observations:,} levels of {result.pixels:,} pixels; residual {q.rms:.3g} sensor levels rms ("
            f"noise {q.floor:.2g}), {100.0 * q.epsilon:.2f} % of the pixels are outliers"
        )
    if result.models:
        _show_models(result)
    if result.rows:
        _show_points(result)
    if result.left_out:
        _summarise_left_out(result)
        if VERBOSE.get():
            _show_left_out(result)


def _with_error(value: FittedValue) -> str:
    if value.interval is None:
        return f"{value.name} {value.value:.4g} (held)"
    return f"{value.name} {value.value:.6g} ± {value.standard_error:.2g}"


def _show_points(result: FitResult) -> None:
    areas = ["area [px]", "measured", "perimeter [px]", "measured"]
    head = ["m", "R_d", "R_s", "σ [rad]", *areas, "likelihood", ""]
    rows: list[list[str]] = []
    for row in result.rows:
        found = [str(row.points), f"{row.R_d:.4g}", f"{row.R_s:.6g}", f"{row.sigma:.4g}"]
        found += [f"{row.area:,}", f"{row.measured_area:,}", f"{row.perimeter:,.0f}", f"{row.measured_perimeter:,.0f}"]
        likelihood = "-" if row.likelihood is None else f"{row.likelihood:.5f}"
        rows.append([*found, likelihood, "selected" if row.points == result.points else ""])
    show_table(head, rows, numbers_from=0)


def _show_models(result: FitResult) -> None:
    rows: list[list[str]] = []
    for row in result.models:
        selected = "selected" if row.model == result.model.name else ""
        if row.rms is None or row.likelihood is None:
            rows.append([row.model, "-", "-", "not determined by these images"])
        else:
            rows.append([row.model, f"{row.rms:.3g}", f"{row.likelihood:.5f}", selected])
    show_table(["model", "left-out lights [sensor level rms]", "likelihood", ""], rows)


def _summarise_left_out(result: FitResult) -> None:
    images = [image for left in result.left_out for image in left.images]
    worst = max(images, key=lambda image: image.rms_sensor)
    overlaps = [image.iou for image in images if image.iou is not None]
    own = f" ({', '.join(result.not_left_out)} from all images)" if result.not_left_out else ""
    least = f", saturated areas overlap by {min(overlaps):.3f} (IoU) or more" if overlaps else ""
    echo(
        f"each light predicted from the others{own}: residual {worst.rms_sensor:.3g} sensor levels rms at most "
        f"({worst.image}){least}"
    )


def _show_left_out(result: FitResult) -> None:
    rows: list[list[str]] = []
    for left in result.left_out:
        for image in left.images:
            iou = "-" if image.iou is None else f"{image.iou:.4f}"
            border = "-" if image.border is None else f"{image.border:.2g}"
            levels = f"{image.rms_sensor:.3g}", f"{image.rms:.3g}"
            rows.append([image.image, f"{left.R_s:.5g}", f"{left.sigma:.4g}", *levels, iou, border])
    show_table(["image", "R_s", "σ [rad]", "rms [sensor level]", "rms [grey level]", "IoU", "border [px]"], rows)
