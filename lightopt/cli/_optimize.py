from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._optimize_tables import show_design
from lightopt.cli._options import (
    Force,
    NoShadows,
    Out,
    PartFile,
    Patches,
    Points,
    Postures,
    Quiet,
    RigFile,
    Threads,
    parse_points,
    parse_posture,
    parse_share,
)
from lightopt.cli._plan_options import given, plan_options
from lightopt.cli._plan_tables import show_plan
from lightopt.cli._terminal import say, say_warning, show_table, show_time_left
from lightopt.core.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from lightopt.design import DesignResult, TargetNotReached


def optimize(
    rig: RigFile,
    part: PartFile,
    out: Out,
    step: Annotated[
        float, typer.Option(metavar="DEG", help="Step of the angles within the lights' ranges.")
    ] = 5.0,
    objective: Annotated[
        list[str] | None,
        typer.Option(
            "--objective",
            metavar="NAME",
            help="coverage, paper or detectability; repeatable, the first decides where the lights go. "
            "[coverage, paper]",
        ),
    ] = None,
    seen_in: Annotated[
        int | None,
        typer.Option(metavar="K", help="detectability: images that must show a defect. [1]"),
    ] = None,
    threshold: Annotated[
        float | None,
        typer.Option(
            metavar="T",
            help="detectability: a defect changes the level by T times the sensor's noise or more. [5]",
        ),
    ] = None,
    common_elevation: Annotated[
        bool,
        typer.Option("--common-elevation", help="All lights that move in elevation stand at the same one."),
    ] = False,
    common_lights: Annotated[
        bool,
        typer.Option("--common-lights", help="The lights stand the same for all postures; the sum decides."),
    ] = False,
    shade_below: Annotated[
        str,
        typer.Option(
            metavar="SHARE",
            help="Levels less than this share of full scale above black are shaded, such as 10/255.",
        ),
    ] = "10/255",
    posture: Postures = None,
    points: Points = None,
    no_shadows: NoShadows = False,
    patches: Patches = None,
    keep_matrix: Annotated[
        bool,
        typer.Option("--keep-matrix", help="Keep the luminance matrices; the same command then reuses them."),
    ] = False,
    no_images: Annotated[
        bool, typer.Option("--no-images", help="Do not render the images of the best set.")
    ] = False,
    no_report: Annotated[bool, typer.Option("--no-report", help="Do not write report.html.")] = False,
    rows: Annotated[
        int, typer.Option(metavar="N", help="Combinations in ranking.csv, per posture and objective.")
    ] = 100,
    max_combinations: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Stop after about N combinations (a box that is halved counts as 20000) and give a bound. [200000000]",
        ),
    ] = None,
    choose_postures: Annotated[
        int | None,
        typer.Option(metavar="N", help="Choose the N postures that show most of the surface together."),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(metavar="SHARE", help="Choose as few postures as show this share, such as 0.95 or 95%."),
    ] = None,
    posture_step: Annotated[
        float | None, typer.Option(metavar="DEG", help="Step of the postures to choose from. [22.5]")
    ] = None,
    allow_outside: Annotated[
        float | None,
        typer.Option(
            metavar="PX", help="How far the part may leave the view in a posture to choose from. [10]"
        ),
    ] = None,
    exposures: Annotated[
        str | None,
        typer.Option(
            metavar="X,…",
            help="Exposures offered to the plan, such as 1/16,1/4,1,4,16; taken where they add enough.",
        ),
    ] = None,
    exposure_gain: Annotated[
        float | None,
        typer.Option(metavar="POINTS", help="What a further exposure of a posture has to add, in %. [1]"),
    ] = None,
    tolerance_deg: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Say how far the score falls when each light is off by that much."),
    ] = None,
    pose_tolerance_deg: Annotated[
        float | None, typer.Option(metavar="DEG", help="The same when the part is off in tilt and rotation.")
    ] = None,
    tolerance_target: Annotated[
        str | None,
        typer.Option(metavar="SHARE", help="Share of the score that the widest tolerances keep. [0.95]"),
    ] = None,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Find where the lights of RIG go for PART: the best combination of their positions, exactly.

    Every combination of the positions that the lights' ranges allow is scored on the levels that the camera would
    deliver. coverage is the area that two images or more show usably, neither shaded nor saturated, and at most one
    saturated; paper is the sum of each patch's middle levels; detectability is the share of the surface × defects of
    the part's catalogue that the images show above the noise, with its blind spots and why they are blind. Writes
    result.json, ranking.csv, rig.optimized.yaml (one per posture where they differ), the images of the best set, the
    map of their overlapping highlights, and report.html, a page that needs no network. Exit status 1 where no
    combination leaves anything usable.

    --choose-postures and --target choose postures from the stage's range, with one set of light positions for all, by
    detectability; part.planned.yaml has them. --exposures and the tolerances look at the answer, whichever way it was
    found.

    Example: lightopt optimize rig.yaml part.yaml -o best --step 5 --common-lights
    """
    chosen_postures = tuple(parse_posture(text) for text in posture) if posture else None
    chosen_points = None if points is None else parse_points(points)
    share = _parse_shade(shade_below)
    of_defects = "detectability" in (objective or ()) or not (choose_postures is target is exposures is None)
    for option, value in (("--seen-in", seen_in), ("--threshold", threshold)):
        if value is not None and not of_defects:
            raise InputError(f"{option} is of --objective detectability, which was not given")

    plan = plan_options(
        choose_postures=choose_postures,
        target=target,
        posture_step=posture_step,
        allow_outside=allow_outside,
        exposures=exposures,
        exposure_gain=exposure_gain,
        tolerance_deg=tolerance_deg,
        pose_tolerance_deg=pose_tolerance_deg,
        tolerance_target=tolerance_target,
    )

    from lightopt.core.run_context import RunContext
    from lightopt.design import OptimizeOptions, TargetNotReached, finish_design, write_design
    from lightopt.design import optimize as design
    from lightopt.report import blind_pictures, design_report

    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    options = OptimizeOptions(
        objectives=tuple(objective or ()),
        step_deg=step,
        common_elevation=common_elevation,
        common_lights=common_lights,
        shade_below=share,
        postures=chosen_postures,
        points=chosen_points,
        shadows=not no_shadows,
        keep_matrix=keep_matrix,
        images=not no_images,
        report=not no_report,
        rows=rows,
        **given(seen_in=seen_in, contrast=threshold, patch_budget=patches, limit=max_combinations),
    )
    try:
        with show_time_left("searching", quiet=quiet) as progress:
            run = RunContext(
                threads=threads, progress=progress, inform=None if quiet else say, warn=say_warning
            )
            result = design(loaded_rig, loaded_part, out, options=options, plan=plan, force=force, run=run)
            output = write_design(result, blind_pictures=blind_pictures(result), force=force, run=run)
            finish_design(output, design_report(output) if options.report else None)
    except TargetNotReached as error:
        if not quiet:
            _show_reachable(error)
        raise
    if not quiet:
        show_design(output)
        show_plan(result.plan, out)
    _require_usable(result, out)


def _parse_shade(text: str) -> float:
    expected = "of full scale from 0 to 1, such as 10/255 or 0.04"
    value = parse_share(text, option="--shade-below", expected=expected)
    if not 0.0 <= value <= 1.0:
        raise InputError(f'--shade-below: expected a share {expected}, found "{text}"')
    return value


def _show_reachable(error: TargetNotReached) -> None:
    # what each number of postures shows
    from lightopt.design import share_text

    rows = [
        (
            f"{number}",
            str(step.posture),
            *(share_text(share, error.grain, short_of=error.target) for share in (step.share, step.bound)),
        )
        for number, step in enumerate(error.steps, start=1)
    ]
    show_table(("postures", "the last of them", "show at least", "with these lights at most"), rows)
    say(
        "at least: what these postures show, chosen one after the other with one set of lights for all of them; "
        "--choose-postures N places the lights for N, and may choose others"
    )


def _require_usable(result: DesignResult, out: Path) -> None:
    messages = [
        f"{', '.join(map(str, one.postures))}: objective {answer.objective.name}: {answer.nothing}"
        for one in result.results
        for answer in one.answers[:1]
        if answer.nothing is not None
    ]
    if messages:
        raise CheckFailed(
            *messages, f"no rig was written for these postures; {out / 'result.json'} says the same"
        )
