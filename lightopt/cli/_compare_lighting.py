from __future__ import annotations

from functools import partial
from pathlib import Path

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
        None, metavar="N", help="Choose the N best postures for each system from its stage's range."
    ),
    exposures: str | None = system_option(
        None, metavar="X,…", help="Candidate relative exposure times in addition to 1, such as 1/16,1/4,4,16."
    ),
    step: float = system_option(10.0, metavar="DEG", help="Step of the angles within the lights' ranges."),
    min_images: int = system_option(2, metavar="K", min=1, help="Number of images that must show a defect."),
    false_alarms: float = system_option(0.05, metavar="N", help="False alarms per posture, the same for all systems."),
    patches: int = system_option(2000, metavar="N", min=1, help="Target number of visible surface patches."),
    tolerances: bool = system_option(
        True, "--tolerances/--no-tolerances", help="Compute how far lights and part may be off."
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
    from lightopt.design import OptimizeOptions, PlanOptions

    names = [] if preset is None else [name.strip() for name in preset.split(",")]
    files = rigs or []
    if names:
        camera_of = load_rig(files[0]) if files else None
        files = [*files, *comparison.preset_files(names, out / "presets", camera_of=camera_of, force=force)]
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
    with run_context(threads) as run:
        found = comparison.compare_lighting(
            files, part, out, options=options, plan=plan, tolerances=tolerances, force=force, run=run
        )
    echo(comparison.answer_text(found))
    show_page_table(comparison.systems_table(found))
    for one in found.unusable:
        echo_warning(f"{one.name} cannot be used: {'; '.join(one.messages)}")
    if VERBOSE.get():
        echo(comparison.systems_table(found).caption)
    echo_paths(*found.paths)
