from __future__ import annotations

import itertools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from lightopt.cli import _common as common
from lightopt.cli._common import hardware_option, output_option, selection_option
from lightopt.cli._terminal import echo, echo_error, run_context, show_table
from lightopt.core.errors import InputError, Interrupted, collected, counted, refuse

if TYPE_CHECKING:
    from lightopt.rig.capture import CapturePlan, CaptureResult


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
