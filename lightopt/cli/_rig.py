"""Commands that run and measure a rig, and tell whether it has changed."""

from __future__ import annotations

import itertools
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import hardware_option, model_option, output_option, selection_option
from lightopt.cli._terminal import VERBOSE, echo, echo_error, echo_paths, run_context, show_page_table, show_table
from lightopt.core.errors import CheckFailed, InputError, Interrupted, collected, counted, refuse

if TYPE_CHECKING:
    from lightopt.config import RigConfig
    from lightopt.estimate.verification import Verification
    from lightopt.rig.capture import CapturePlan, CaptureResult


MOST_ROWS = 4  # of each table without `--verbose`; verify.json has all of them


def verify(
    rig: common.RigFile,
    part: common.PartFile,
    images: common.Images,
    out: common.Out,
    baseline: Path | None = model_option(
        None, metavar="SET", help="Known good image set of the same part: report what has changed since."
    ),
    plan: Path | None = model_option(
        None,
        metavar="FILE",
        help="result.json of optimize --light-tolerance or --pose-tolerance: its tolerances are limits.",
    ),
    limit: list[str] | None = model_option(
        None,
        "--limit",
        metavar="NAME=VALUE",
        help="Change a limit; repeatable. Names: gain, exposure (such as 3%), black (levels), part_mm, part_deg, "
        "camera_mm, camera_deg, panel_mm, panel_deg, blur_px.",
        show_default="see docs/how-to/verify.md",
    ),
    register: common.Register = True,
    history: Path | None = output_option(
        None, metavar="DIR", help="Add a row for this run to history.csv in DIR, and draw history.png."
    ),
    report: common.Report = True,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Compare captured IMAGES with the prediction and name what has changed on the rig.

    Reports for each light the overlap of the saturated areas, the offset of the highlights, and the residual over the
    noise. Names the causes with their sizes: gain of a light, exposure, black level, lights exchanged, panel, part or
    camera moved, focus, dust. Writes verify.json and report.html. Exit status 1 if the rig has left its tolerances.

    Example: lightopt verify rig.yaml part.yaml captured/ -o verified --history verified/history
    """
    from lightopt.estimate import verification
    from lightopt.images import read_image_set
    from lightopt.report.rig import history_chart, verification_report

    given = _limits(limit or [])
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    planned = {} if plan is None else verification.plan_limits(plan, loaded_rig)
    limits = verification.VerifyLimits(**{**planned, **given})
    image_set = read_image_set(images)
    good = None if baseline is None else read_image_set(baseline)
    folder = verification.verify_folder(
        out, loaded_rig, loaded_part, image_set, baseline=good, limits=limits, register=register, force=force
    )
    with run_context(threads) as run:
        result = verification.verify_set(
            loaded_rig, loaded_part, image_set, baseline=good, limits=limits, register=register, run=run
        )
    run.warn(*result.warnings)
    _show(result)
    written: list[Path] = []
    if report:
        page = verification_report(result, part=loaded_part.name, rig=loaded_rig.name, provenance=folder.made_from)
        written.append(folder.write_text(verification.REPORT_NAME, page))
    written.insert(0, folder.finish(result.as_dict()))
    if history is not None:
        name = image_set.folder.resolve().name
        rows = verification.append_history(history, result, name=name, when=datetime.now(timezone.utc))
        written += [history / verification.HISTORY_NAME, history_chart(rows, history / "history.png")]
    echo_paths(*written)
    if not result.within_tolerances:
        raise CheckFailed(result.answer)


def _limits(given: list[str]) -> dict[str, float]:
    from lightopt.estimate.verification import VerifyLimits

    names = tuple(vars(VerifyLimits()))
    values: dict[str, float] = {}
    for text in given:
        name, _, value = text.partition("=")
        if name not in names:
            raise InputError(f'--limit: expected NAME=VALUE with a name of {", ".join(names)}, found "{text}"')
        if name in ("gain", "exposure"):
            expected = "of the brightness, such as 3%"
            values[name] = common.parse_share(value, option=f"--limit {name}", expected=expected)
            continue
        try:
            values[name] = float(value)
        except ValueError:
            raise InputError(f'--limit {name}: expected a number, found "{value}"') from None
    return values


def _show(result: Verification) -> None:
    from lightopt.report.rig import findings_table, lights_table

    echo(result.answer if result.within_tolerances else "the rig has left its tolerances")
    if result.findings:
        show_page_table(findings_table(result), most=MOST_ROWS)
    for finding in result.findings[: None if VERBOSE.get() else MOST_ROWS]:
        if finding.remedy:
            echo(f"to tell {finding.cause}: {finding.remedy}")
    show_page_table(lights_table(result), most=MOST_ROWS)
    if not VERBOSE.get() and max(len(result.findings), len(result.lights)) > MOST_ROWS:
        echo("--verbose shows all rows")


def calibrate(
    rig: common.RigFile,
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Calibration folder: targets.yaml and image sets.", show_default=False),
    ],
    plan: bool = output_option(
        False, "--plan", help="Write what to capture: targets.yaml, a board to print, parts with postures, commands."
    ),
    report: common.Report = True,
    force: common.Force = False,
    threads: common.Threads = None,
) -> None:
    """Measure camera, stage, panels and sensor of RIG from images of targets on its stage.

    Reads the image sets in FOLDER that are there: board (a printed ChArUco board: camera and stage axes), ball (a
    bearing ball: position, direction and size of each panel), plate (a matt white plate: gains, fall-off, vignetting),
    sensor-a and sensor-b (two captures alike, with dark frames: noise, black level). Writes rig.calibrated.yaml,
    calibration.json and report.html into FOLDER. Boards need the extra: pip install 'lightopt[opencv]'.

    Example: lightopt calibrate rig.yaml calibration --plan
    """
    from lightopt.config import load_rig

    loaded = load_rig(rig)
    if plan:
        _plan(loaded, folder, force=force)
        return
    from lightopt.estimate.rig_calibration import REPORT_NAME, calibrate_rig, figures, write_calibration
    from lightopt.images import write_text_atomic
    from lightopt.report.rig import calibration_lines, calibration_report

    with run_context(threads) as run:
        found = calibrate_rig(loaded, folder, run=run)
    run.warn(*found.warnings)
    written = [*write_calibration(found, force=force)]
    if report:
        write_text_atomic(folder / REPORT_NAME, calibration_report(found, figures(found)), overwrite=force)
        written.append(folder / REPORT_NAME)
    for what, text in calibration_lines(found):
        echo(f"{what}: {text}")
    if found.unobservable:
        echo(f"not shown by these images, and near the rig file: {', '.join(found.unobservable)}")
    if found.board is not None and found.board.next_posture is not None:
        posture, rms = found.board.next_posture
        echo(f"a view at {posture} would help most: {found.board.predicted_rms:.2g} → {rms:.2g} px")
    echo_paths(*written)


def _plan(loaded: RigConfig, folder: Path, *, force: bool) -> None:
    from lightopt.estimate.rig_calibration import plan_calibration
    from lightopt.report.rig import board_sheet

    planned = plan_calibration(loaded, folder, force=force)
    if planned.board is not None:
        for suffix in (".pdf", ".png"):
            board_sheet(planned.board, folder / f"board{suffix}")
    echo(f"{planned.images} images to capture, and two sets of one posture for the sensor")
    for number, text in enumerate((*planned.targets, "capture and calibrate:"), start=1):
        echo(f"{number}. {text}")
    for command in planned.commands:
        echo(f"  {command}")


def capture(
    rig: common.RigFile,
    part: common.PartFile,
    out: Path | None = typer.Option(None, "--out", "-o", metavar="DIR", help="Output folder; optional with --dry-run."),
    light: common.Lights = None,
    posture: common.Postures = None,
    exposures: common.Exposures = "1",
    average: int = selection_option(1, metavar="N", min=1, help="Average N frames per image."),
    seed: int | None = selection_option(
        None, metavar="N", min=0, help="Seed of the virtual bench's noise.", show_default="as the rig file says, or 1"
    ),
    dark: bool = selection_option(False, "--dark", help="Also capture dark frames, and subtract them in the EXR."),
    home: bool = hardware_option(False, "--home", help="Home the stage first."),
    check_lights: bool = hardware_option(
        True, "--check-lights/--no-check-lights", help="Verify that each image is lit by its own light."
    ),
    check_repeatability: bool = hardware_option(
        False, "--check-repeatability", help="Repeat the first image at the end, to detect lost steps of the stage."
    ),
    dry_run: bool = hardware_option(False, "--dry-run", help="Print every step with its time; open no device."),
    resume: bool = output_option(False, "--resume", help="Capture only the images missing from an existing set."),
    sheet: common.Sheet = False,
    serial_log: common.SerialLog = None,
    force: common.Force = False,
) -> None:
    """Capture an image of PART on RIG for each light, posture and exposure.

    Writes the camera's PNGs, a linear EXR per light and posture, and manifest.json. Other commands read the folder like
    a rendered image set. If RIG has no hardware section, the virtual bench is used: simulated devices, and a camera
    that renders the part. All lights are switched off at the start, at the end, after an error and after Ctrl-C.

    Example: lightopt capture rig.yaml part.yaml -o captured --exposure 1,1/16
    """
    if out is None and not dry_run:
        raise InputError("--out: expected a folder for the image set; it is optional with --dry-run only")

    from lightopt.rig.capture import CaptureOptions, capture as take, check_devices, check_folder, make_plan

    options = CaptureOptions(
        lights=tuple(light) if light else None,
        postures=common.parse_postures(posture),
        exposures=common.parse_exposures(exposures),
        average=average,
        dark=dark,
        home=home,
        check=check_lights,
        check_repeatability=check_repeatability,
        seed=seed,
    )
    loaded_rig, loaded_part = common.load_inputs(rig, part)
    existing: dict[str, Any] = {"resume": resume, "force": force}
    if dry_run:
        plan = make_plan(loaded_rig, loaded_part, options)
        _show_plan(plan)  # before devices that are missing are reported
        problems: list[str] = []
        with collected(problems):
            check_devices(loaded_rig, plan.wiring, plan)
        with collected(problems):
            if out is not None:
                check_folder(out, loaded_rig, loaded_part, plan, **existing)
        refuse(problems)
        return
    assert out is not None
    try:
        with run_context() as run:
            done = take(loaded_rig, loaded_part, out, options=options, **existing, serial_log=serial_log, run=run)
    except Interrupted as stopped:
        echo_error(*stopped.messages, label="")
        raise
    _show_result(done)
    if sheet:
        title = f"{loaded_part.name} on {loaded_rig.name}, captured"
        common.add_sheets(out, loaded_rig, exposures=options.exposures, title=title, force=force)


def _show_plan(plan: CapturePlan) -> None:
    if not plan.wiring.given:
        echo("no hardware section in the rig file: using the virtual bench")
    steps = list(plan.steps())
    *starts, end = itertools.accumulate((step.seconds for step in steps), initial=0.0)
    rows = [(f"{at:.2f}", f"{step.seconds:.2f}", str(step)) for at, step in zip(starts, steps, strict=True)]
    show_table(("at [s]", "takes [s]", "step"), rows, numbers_from=3)
    renders = ", plus the time for opening and rendering" if plan.wiring.camera_is_virtual else ""
    travel = sum(step.seconds for step in steps if step.kind == "move")
    way = f", {travel:.1f} s of them travel" if plan.wiring.hardware.stage is not None else ""
    echo(f"{counted(len(plan.keys), 'image')} in {end:.0f} s{way}{renders}; no device was opened or moved")


def _show_result(done: CaptureResult) -> None:
    if done.replaced:
        echo(f"replaced the existing image set ({counted(done.replaced, 'file')})")
    there = done.images - done.taken
    were_there = f" ({there} of them existed already)" if there else ""
    echo(f"{counted(done.images, 'image')}{were_there} in {done.seconds:.0f} s")
    if done.retries:
        echo(f"{counted(done.retries, 'command')} had to be sent again; the manifest lists them by image")
    echo(f"{done.folder / 'manifest.json'}")
    if done.virtual_bench:
        echo("all devices were simulated (VIRTUAL BENCH): the rig file has no hardware section")
