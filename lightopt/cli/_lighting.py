"""Commands that choose lights other than by a part on one rig: among lighting systems, or from images of samples."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._terminal import VERBOSE, echo, echo_paths, echo_warning, run_context, show_page_table
from lightopt.core.errors import InputError

system_option = partial(typer.Option, rich_help_panel="Adjustment of each system")


def compare_lighting(
    part: common.PartFile,
    out: common.Out,
    rigs: list[Path] | None = typer.Argument(None, metavar="RIG", help="Rig files, one per lighting system."),
    preset: str | None = typer.Option(
        None,
        metavar="NAME,…",
        help="Sample systems to compare as well: four-panel, bars, ring-quadrants, low-ring, dome-quadrants, "
        "flat-dome, tunnel, coaxial, spot, led-array, display, binary-stripes, grid-backlight, dome-sines.",
    ),
    posture: common.Postures = None,
    choose_postures: int | None = system_option(
        None, metavar="N", help="Choose the N best postures of each system from its stage's range."
    ),
    exposures: str | None = system_option(
        None,
        "--exposure",
        metavar="X,…",
        help="Candidate relative exposure times in addition to 1, such as 1/16,1/4,4,16.",
    ),
    step: float = system_option(10.0, metavar="DEG", help="Step of the angles within the lights' ranges."),
    min_images: int = system_option(2, metavar="K", min=1, help="Number of images that must show a defect."),
    false_alarms: float = system_option(0.05, metavar="N", help="False alarms per posture, the same for all systems."),
    patches: int = system_option(2000, metavar="N", min=1, help="Target number of visible surface patches."),
    tolerances: bool = system_option(
        True,
        "--tolerances/--no-tolerances",
        help="Analyse tolerances: the angles by which lights and part may be off at 95 % of the score. Takes time.",
    ),
    points: common.Points = None,
    report: bool = output_option(True, "--report/--no-report", help="Write a report for each system as well."),
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Compare lighting systems by the defects that they show on PART.

    Adjusts each system as well as it can be: positions within the ranges of its rig file, exposures and postures where
    requested. All are judged by the same catalogue of defects, those of PART, and the same rate of false alarms. A
    system that cannot be used, such as a light in the camera's view, is listed with the reason.

    Writes report.html, comparison.csv and comparison.json, and the design of each system to a folder of its name. The
    rig files of presets are copied to presets/, with the pixels and the sensor of the first RIG.

    Example: lightopt compare-lighting part.yaml rig.yaml --preset dome-quadrants,coaxial -o compared
    """
    from lightopt import comparison
    from lightopt.config import load_rig
    from lightopt.design import OptimizeOptions, PlanOptions, check_options

    names = [] if preset is None else [name.strip() for name in preset.split(",")]
    chosen_exposures = () if exposures is None else common.parse_exposures(exposures)
    if posture is not None and choose_postures is not None:
        raise InputError("--posture: cannot be combined with --choose-postures; omit one or the other")
    options = OptimizeOptions(
        objectives=("detectability",),
        step_deg=step,
        postures=common.parse_postures(posture),
        points=common.parse_points(points),
        min_images=min_images,
        false_alarms=false_alarms,
        patch_budget=patches,
        report=report,
    )
    plan = PlanOptions(choose_postures=choose_postures, exposures=chosen_exposures)
    check_options(options, plan)
    comparison.check_presets(names)
    common.options_are_read()
    files = rigs or []
    if names:
        camera_of = load_rig(files[0]) if files else None
        files = [*files, *comparison.preset_files(names, out / "presets", camera_of=camera_of, force=force)]
    with run_context(threads) as run:
        found = comparison.compare_lighting(
            files, part, out, options=options, plan=plan, tolerances=tolerances, force=force, run=run
        )
    echo(comparison.answer_text(found))
    show_page_table(comparison.systems_table(found))
    for name, messages in found.unusable.items():
        echo_warning(f"{name} cannot be used: {'; '.join(messages)}")
    if VERBOSE.get():
        echo(comparison.systems_table(found).caption)
    echo_paths(*found.paths)


sample_option = partial(typer.Option, rich_help_panel="Samples")
choice_option = partial(typer.Option, rich_help_panel="Choice of images")
Sets = Annotated[
    list[Path],
    typer.Argument(metavar="SETS", help="Image sets of good and defective samples: folders or manifest.json."),
]
MOST_DEFECTS = 8  # shown without `--verbose`


def optimize_from_images(
    sets: Sets,
    out: common.Out,
    region: Path | None = sample_option(
        None,
        "--region",
        metavar="PNG",
        help="Picture that is not 0 where the part is to be inspected.",
        show_default="where the part is seen",
    ),
    images: int | None = choice_option(
        None, "--images", "-k", metavar="N", min=1, help="Number of images to take of a part.", show_default="4"
    ),
    mix: bool = choice_option(False, "--mix", help="Show several lights in an image, each with a weight."),
    false_alarms: float = choice_option(
        0.05, metavar="N", help="Expected false alarms per posture, from 1e-9 to 1: when a defect counts as found."
    ),
    max_combinations: int = choice_option(
        50_000_000, metavar="N", min=1, help="Stop after about N choices of lights and report a bound."
    ),
    rig: Path | None = output_option(
        None, "--rig", metavar="RIG", help="Rig file of the lights; written with the programme as rig.optimized.yaml."
    ),
    compare: Path | None = output_option(
        None,
        "--compare",
        metavar="SET",
        help="Image set captured with this programme, to compare with the synthesised images.",
    ),
    report: common.Report = True,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Choose lights from images of samples, without a CAD model.

    SETS are rendered or captured with one light (or segment, or LED) at a time, of samples at the same place of the
    image: good ones, and defective ones with masks. A set's mask is masks/posture_θ_φ.png beside its manifest, or
    mask.png for a single posture: 0 where the sample is good, anything else on defects; pixels that touch are one
    defect. Sets that were rendered with defects need none. A set without a mask is a good sample.

    Finds the N lights whose images show the defects best, by exact search with a bound, and how long to expose them;
    with --mix the weights of lights that are on together. Writes result.json, programme.yaml (the programme of a rig
    file, for capture), the images as they would look (images/), and report.html. See docs/how-to/from-images.md.

    Example: lightopt optimize --from-images good-1 good-2 good-3 scratched dented -k 4 -o chosen
    """
    from lightopt.design import (
        FromImagesOptions,
        agreement_text,
        finish_from_images,
        from_images_answer,
        optimize_from_images as choose,
        write_from_images,
    )
    from lightopt.report.design import chosen_table, defects_table, from_images_report, scores_table

    if files := [path.name for path in sets if path.suffix.lower() in (".yaml", ".yml")]:
        raise InputError(f"{', '.join(files)}: lights are chosen from image sets; --rig names a rig file")
    number = {} if images is None else {"images": images}
    options = FromImagesOptions(**number, mix=mix, false_alarms=false_alarms, limit=max_combinations)
    with run_context(threads) as run:
        result = choose(sets, options=options, region=region, rig=rig, captured=compare, run=run)
        output = write_from_images(result, out, force=force, run=run)
        page = from_images_report(result) if report else None
        paths = finish_from_images(output, result, page)
    default = f"; {options.images} is the default of -k" if images is None else ""
    echo(f"{' '.join(from_images_answer(result))}{default}")
    for table in (chosen_table(result), scores_table(result)):
        show_page_table(table)
    show_page_table(defects_table(result), most=MOST_DEFECTS)
    if result.agreement is not None:
        echo(agreement_text(*result.agreement))
    echo_paths(*paths)
