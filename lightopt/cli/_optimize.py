"""Find the best light positions, and print the answers and plans as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import output_option
from lightopt.cli._terminal import VERBOSE, echo, echo_main_paths, run_context, show_page_table, show_table
from lightopt.core.errors import CheckFailed, counted, refuse

if TYPE_CHECKING:
    from lightopt import design
    from lightopt.config import PartConfig, RigConfig
    from lightopt.design import CalibratedThreshold
    from lightopt.images import Overlap


light_option = partial(typer.Option, rich_help_panel="Light positions")
objective_option = partial(typer.Option, rich_help_panel="Objectives")
posture_option = partial(typer.Option, rich_help_panel="Choice of postures")
exposure_option = partial(typer.Option, rich_help_panel="Choice of exposures")
tolerance_option = partial(typer.Option, rich_help_panel="Tolerance analysis")


def optimize(
    rig: common.RigFile,
    part: common.PartFile,
    out: common.Out,
    posture: common.Postures = None,
    step: float = light_option(5.0, metavar="DEG", help="Step of the angles within the lights' ranges."),
    common_elevation: bool = light_option(
        False, "--common-elevation", help="Use the same elevation for all lights that move in elevation."
    ),
    common_lights: bool = light_option(
        True,
        "--common-lights/--lights-per-posture",
        help="Use one set of light positions for all postures, or one for each, so that the lights are moved "
        "between postures.",
    ),
    max_combinations: int | None = light_option(
        None, metavar="N", help="Stop after about N combinations and report a bound.", show_default="200000000"
    ),
    objective: list[str] | None = objective_option(
        None,
        "--objective",
        metavar="coverage|paper|detectability",
        help="Score of a combination of positions; repeatable. The first one determines the light positions.",
        show_default="coverage, paper",
    ),
    shade_below: str = objective_option(
        "10/255", metavar="SHARE", help="A level is shaded if it exceeds black by less than this share of full scale."
    ),
    min_images: int | None = objective_option(
        None, metavar="K", min=1, help="detectability: number of images that must show a defect.", show_default="2"
    ),
    false_alarms: float | None = objective_option(
        None, metavar="N", help="detectability: expected false alarms per posture, from 1e-9 to 1.", show_default="0.05"
    ),
    calibration: Path | None = objective_option(
        None,
        metavar="FILE",
        help="detectability: take threshold and false-alarm rate from this calibration.json of inspect --calibrate.",
    ),
    choose_postures: int | None = posture_option(
        None, metavar="N", help="Choose the N postures with the best joint detectability. With --target: at most N."
    ),
    target: str | None = posture_option(
        None, metavar="SHARE", help="Choose the fewest postures that reach this detectability, such as 0.95 or 95%."
    ),
    posture_step: float | None = posture_option(
        None, metavar="DEG", help="Step of the candidate postures.", show_default="22.5"
    ),
    allow_outside: float | None = posture_option(
        None,
        metavar="PX",
        help="Pixels by which the part may extend beyond the image in a candidate posture.",
        show_default="10",
    ),
    exposures: str | None = exposure_option(
        None,
        "--exposure",
        metavar="X,…",
        help="Candidate relative exposure times in addition to 1, such as 1/16,1/4,4,16.",
    ),
    exposure_gain: float | None = exposure_option(
        None,
        metavar="POINTS",
        help="Least increase of detectability for each further exposure [percentage points].",
        show_default="1",
    ),
    light_tolerance: float | None = tolerance_option(
        None,
        metavar="DEG",
        help="Report the loss of score if elevation and azimuth of each light are off by up to this angle.",
    ),
    pose_tolerance: float | None = tolerance_option(
        None,
        metavar="DEG",
        help="Report the loss of score if tilt and rotation of the part are off by up to this angle.",
    ),
    tolerance_target: str | None = tolerance_option(
        None,
        metavar="SHARE",
        help="Report the widest tolerances that keep this share of the score.",
        show_default="0.95",
    ),
    points: common.Points = None,
    shadows: common.Shadows = True,
    patches: common.Patches = None,
    keep_matrix: bool = output_option(
        False, "--keep-matrix", help="Write the luminance matrices (matrix.npz), and reuse existing ones."
    ),
    images: bool = output_option(True, "--images/--no-images", help="Render images with the best light positions."),
    report: common.Report = True,
    ranking_rows: int = output_option(100, metavar="N", help="Rows of ranking.csv per posture and objective."),
    force: common.Force = False,
    threads: common.Threads = None,
    workers: int | None = common.workers_option(None, metavar="N", min=1, help=common.WORKERS_HELP, show_default="1"),
    scheduler: common.Scheduler = None,
    slurm: common.Slurm = False,
    kubernetes: common.Kubernetes = False,
) -> None:
    """Find the best positions of RIG's lights for PART by exact search.

    Scores every combination of positions within the lights' ranges by the levels that the camera would deliver.
    Objectives: coverage, the area that is usable (neither shaded nor saturated) in two images or more and saturated in
    at most one; paper, the sum of each patch's usable levels without the highest and lowest; detectability, the share
    of surface × defects of the part's catalogue that the images show above the noise, with blind spots.

    Writes result.json, ranking.csv, rig.optimized.yaml (one per posture if they differ), images with the best light
    positions (images/), maps of overlapping saturated regions (overlap.png), and report.html. Exit status 1 if no
    combination makes any surface usable. --choose-postures and --target choose postures from the stage's range, for one
    set of lights, and write part.planned.yaml; exposures and tolerances refer to the resulting lights and postures.
    With them, --workers, --scheduler, --slurm or --kubernetes spread the plan over other processes, which need the same
    version and no files. Results do not depend on them.

    Without a CAD model, lights are chosen from images of samples: see lightopt optimize --from-images --help.

    Example: lightopt optimize rig.yaml part.yaml -o best --step 5
    """
    chosen_postures = common.parse_postures(posture)
    chosen_points = common.parse_points(points)
    of_full_scale = "of full scale from 0 to 1, such as 10/255 or 0.04"
    shade = common.parse_share(shade_below, option="--shade-below", expected=of_full_scale, limits=(0.0, 1.0))
    choice = choose_postures is not None or target is not None
    of_defects = "detectability" in (objective or ()) or choice or exposures is not None
    tolerance = light_tolerance is not None or pose_tolerance is not None
    places = {"--workers": workers, "--scheduler": scheduler, "--slurm": slurm, "--kubernetes": kubernetes}
    dependent = (
        ("--min-images", min_images, of_defects, "--objective detectability"),
        ("--false-alarms", false_alarms, of_defects, "--objective detectability"),
        ("--calibration", calibration, of_defects, "--objective detectability"),
        ("--posture-step", posture_step, choice, "--choose-postures or --target"),
        ("--allow-outside", allow_outside, choice, "--choose-postures or --target"),
        *((name, value or None, choice, "--choose-postures or --target") for name, value in places.items()),
        ("--exposure-gain", exposure_gain, exposures is not None, "--exposure"),
        ("--tolerance-target", tolerance_target, tolerance, "--light-tolerance or --pose-tolerance"),
    )
    unused = [(option, other) for option, value, used, other in dependent if value is not None and not used]
    refuse(f"{option}: has no effect without {other}" for option, other in unused)
    chosen_exposures = () if exposures is None else common.parse_exposures(exposures)
    shown_share, kept_share = (
        None if text is None else common.parse_share(text, option=option, expected=f"{of}, such as 0.95")
        for text, option, of in (
            (target, "--target", "of the surface above 0 and up to 1"),
            (tolerance_target, "--tolerance-target", "of the score between 0 and 1"),
        )
    )

    from lightopt import design
    from lightopt.batch import other_processes
    from lightopt.core.threads import available_processors
    from lightopt.report.design import blind_pictures, design_report

    where = common.chosen_workers(workers, scheduler, slurm, kubernetes, here=1, system=available_processors())
    tolerances = None
    if tolerance:
        off = {"light_deg": light_tolerance or 0.0, "pose_deg": pose_tolerance or 0.0}
        tolerances = design.Tolerances(**off, **_given(tolerance_target=kept_share))
    plan = design.PlanOptions(
        choose_postures=choose_postures,
        target=shown_share,
        exposures=chosen_exposures,
        tolerances=tolerances,
        **_given(posture_step_deg=posture_step, allow_outside_px=allow_outside, exposure_gain=exposure_gain),
    )
    options = design.OptimizeOptions(
        objectives=tuple(objective or ()),
        step_deg=step,
        common_elevation=common_elevation,
        common_lights=common_lights,
        shade_below=shade,
        postures=chosen_postures,
        points=chosen_points,
        shadows=shadows,
        keep_matrix=keep_matrix,
        images=images,
        report=report,
        rows=ranking_rows,
        **_given(min_images=min_images, false_alarms=false_alarms, patch_budget=patches, limit=max_combinations),
    )
    design.check_options(options, plan)
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    if calibration is not None:
        threshold, rate = _calibrated(calibration, loaded_rig, loaded_part, min_images, false_alarms)
        options = replace(options, threshold=threshold, false_alarms=rate)
    with run_context(threads) as run:
        with other_processes(where, run) as spread:
            result = design.optimize(loaded_rig, loaded_part, out, options=options, plan=plan, force=force, run=spread)
        output = design.write_design(result, blind_pictures=blind_pictures(result), force=force, run=run)
        design.finish_design(output, design_report(output) if options.report else None)
    show_plan(result.plan)
    show_design(output)
    show_commands(result.plan, out)
    messages = [
        f"{', '.join(map(str, one.postures))}: objective {answer.objective.name}: {answer.nothing}"
        for one in result.results
        for answer in one.answers[:1]
        if answer.nothing is not None
    ]
    if messages:
        raise CheckFailed(*messages, f"no rig was written for these postures; see {out / 'result.json'}")


def _given(**options: object) -> dict[str, Any]:
    """The options that were given; the others keep their defaults."""
    return {name: value for name, value in options.items() if value is not None}


def _calibrated(
    path: Path, rig: RigConfig, part: PartConfig, min_images: int | None, false_alarms: float | None
) -> tuple[CalibratedThreshold, float]:
    # the threshold of a calibrated inspection, and its false-alarm rate unless another is wanted
    from lightopt.design import CalibratedThreshold
    from lightopt.inspection import InspectOptions, read_calibration

    learned = read_calibration(path)
    rate = learned.rate if false_alarms is None else false_alarms
    learned.require_match(rig, part, InspectOptions(false_alarms=rate, **_given(min_images=min_images)))
    score = max(posture.threshold(rate) for posture in learned.postures)
    return CalibratedThreshold(score=score, file=path.name, sha256=learned.sha256), rate


Section = Mapping[str, Any]  # of result.json, as the report has it


def show_design(output: design.DesignOutput) -> None:
    """The best sets with every objective's score, and the main files; of a verbose command all tables and files."""
    from lightopt import design
    from lightopt.report.design import best_table, blind_tables, capture_text, defect_tables

    result, best = output.result, best_table(output)
    if best.rows:
        show_page_table(best)
    objectives = [answer.objective for answer in result.results[0].answers]
    said = not best.rows or "chosen_postures" in output.document  # which show_plan prints
    for surface, names in () if said else design.shares_of(objectives).items():
        echo(f"shares of {' and '.join(names)}: of {surface}")
    if VERBOSE.get():
        echo(best.caption)
        if any(one.between_text is not None for one in result.results):
            echo(design.BETWEEN_MEANING)
    for one in result.results:
        texts = [text for text in (one.gain_text, one.between_text) if text is not None]
        for text in texts if len(result.results) == 1 else ["; ".join(texts)] if texts else []:
            echo(text if len(result.results) == 1 else f"posture {one.postures[0]}: {text}")
    if any(one.answers[0].nothing is None for one in result.results):
        echo(f"capture: {capture_text(result)}")
    if VERBOSE.get():
        for out in result.all_candidates.left_out:
            named = zip(design.AXES, design.place_text(out.place).split(", "), strict=False)
            echo(f"left out: {out.light} at {', '.join(map(' '.join, named))}: it {out.reason}")
        if result.patches is not None:
            echo(result.patches.message)
        if result.reused:
            matrices = "matrix" if result.reused == 1 else "matrices"
            echo(f"{result.reused} stored luminance {matrices} reused")
        for table in (*defect_tables(output.document), *blind_tables(output.document)):
            show_page_table(table)
            echo(table.caption)
        if output.overlaps:
            show_overlaps(output.overlaps)
    elif result.blind is not None:
        _, chosen, _ = result.blind.parts[0]
        text = partial(design.share_text, grain=chosen.grain)
        shares = sorted(chosen.by_reason().items())
        reasons = "; ".join(f"{design.blind_text(code, result.blind.lights)} {text(share)}" for code, share in shares)
        echo(f"of {design.BLIND_SHARES_OF}: found {text(chosen.seen)}; {reasons}")
    rigs = {path.name for path in output.paths if path.name.startswith("rig.")}
    main = {"report.html", "result.json", "part.planned.yaml", *rigs}
    echo_main_paths(output.result.folder, output.paths, main=main)


def show_overlaps(overlaps: Sequence[Overlap]) -> None:
    """Saturated pixels of each light and pair of lights, a line per posture and exposure."""
    rows: list[list[str]] = []
    for overlap in overlaps:
        saturated = ", ".join(f"{light} {pixels:,}" for light, pixels in overlap.saturated.items())
        pairs = ", ".join(f"{a} & {b}: {pixels:,}" for (a, b), pixels in overlap.pairs.items() if pixels) or "none"
        rows.append([str(overlap.posture), f"{overlap.exposure:g}", saturated, f"{overlap.pixels:,}", pairs])
    show_table(["posture", "exposure", "saturated px", "in two or more", "overlaps"], rows, numbers_from=9)


def show_plan(result: design.PlanResult) -> None:
    """What a plan shows; of a verbose command also its tables, what the figures mean and how far they hold."""
    from lightopt.design import plan_document
    from lightopt.report.design import exposure_note, exposure_table, tolerance_table

    document = plan_document(result)
    if "chosen_postures" in document:
        _show_postures(document)
    if "exposures" in document:
        planned = document["exposures"]
        if VERBOSE.get():
            show_page_table(exposure_table(planned))
        echo(exposure_note(planned))
        if VERBOSE.get() and "chosen_postures" not in document:
            echo(f"shares of exposures: of {planned['shares_of']}")
    if "tolerances" in document:
        table = tolerance_table(document["tolerances"])
        if VERBOSE.get():
            show_page_table(table)
        else:
            worst, most = (row[-1] for row in table.rows[:2])
            kept = f"the worst corner keeps {worst} of the score, 95 % of random draws keep {most}"
            echo(f"angles off by the tolerances, {table.header[-1]}: {kept}")


def show_commands(result: design.PlanResult, folder: Path) -> None:
    """The commands that carry a plan out; of a verbose command the travel of the stage as well."""
    from lightopt.design import plan_document

    document = plan_document(result)
    if "commands" in document:
        echo(f"commands to carry out the plan, to be run in {folder}:")
        for command in document["commands"]:
            echo(f"  {command}")
        if VERBOSE.get() and len(document["rounds"]) > 1:
            from lightopt.core.transforms import Posture

            for number, one in enumerate(document["rounds"], start=1):
                order = " → ".join(str(Posture.from_dict(posture)) for posture in one["order_of_travel"])
                echo(f"stage, capture {number}: {order}, {one['travel_s']:.1f} s of travel")
            total = sum(one["travel_s"] for one in document["rounds"])
            echo(f"total travel {total:.1f} s, without the returns to (0°, 0°)")


def _show_postures(document: Section) -> None:
    from lightopt.core.transforms import Posture
    from lightopt.design import finding_text, share_text
    from lightopt.report.design import plan_proof, posture_facts, posture_table

    chosen = document["chosen_postures"]
    text = partial(share_text, grain=chosen["patches"]["grain"])
    table = posture_table(chosen, with_exposures=len(chosen["bounds_with_any_of_exposures"]) > 1)
    number = counted(len(chosen["postures"]), "posture")
    meaning = finding_text(chosen["min_images"], chosen["false_alarms"])
    echo(f"{number} of {chosen['candidates']}: {text(chosen['share'])} {meaning}; shares are of {chosen['shares_of']}")
    show_page_table(table)
    _show_spare(chosen, text)
    proof = plan_proof(chosen)
    if not VERBOSE.get():
        echo(proof.partition(". ")[0].removesuffix("."))
        return
    echo(proof)
    echo(table.caption)
    for out in chosen["left_out"]:
        echo(f"left out: posture {Posture.from_dict(out)}: {out['reason']}")
    for name, value in posture_facts(chosen, document.get("rounds", ())):
        echo(f"{name}: {value}")


def _show_spare(chosen: Section, text: partial[str]) -> None:
    # fewer postures than were requested, and postures that hardly add anything
    count, sufficient = len(chosen["postures"]), chosen["postures_to_a_tenth_of_a_point"]
    if chosen["requested"] is not None and count < chosen["requested"] and chosen["target"] is None:
        why = "there are no others" if count == chosen["candidates"] else "no other adds anything with these lights"
        echo(f"{counted(chosen['requested'], 'posture')} requested, {count} chosen: {why}")
    if sufficient < count:
        share = text(chosen["postures"][sufficient - 1]["share"])
        echo(f"--choose-postures {sufficient} is nearly as good: these show {share}")
