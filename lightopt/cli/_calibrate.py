from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lightopt.cli import _common as common
from lightopt.cli._terminal import echo, echo_paths, run_context

if TYPE_CHECKING:
    from lightopt.config import RigConfig


def calibrate(
    rig: common.RigFile,
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Calibration folder: targets.yaml and image sets.", show_default=False),
    ],
    plan: bool = common.output_option(
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
    from lightopt.report import calibration_lines, calibration_report

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
        echo(f"not shown by these images, and as filed: {', '.join(found.unobservable)}")
    if found.board is not None and found.board.next_posture is not None:
        gain = found.board.next_posture
        echo(f"a view at {gain.posture} would help most: {found.board.predicted_rms:.2g} → {gain.predicted_rms:.2g} px")
    echo_paths(*written)


def _plan(loaded: RigConfig, folder: Path, *, force: bool) -> None:
    from lightopt.estimate.rig_calibration import plan_calibration
    from lightopt.report import board_sheet

    planned = plan_calibration(loaded, folder, force=force)
    if planned.board is not None:
        for suffix in (".pdf", ".png"):
            board_sheet(planned.board, folder / f"board{suffix}")
    echo(f"{planned.images} images to capture, and two sets of one posture for the sensor")
    for number, text in enumerate((*planned.targets, "capture and calibrate:"), start=1):
        echo(f"{number}. {text}")
    for command in planned.commands:
        echo(f"  {command}")
