from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._inspect_sets import Wanted, inspect_batch, inspect_one
from lightopt.cli._inspect_tables import show_calibration
from lightopt.cli._options import Force, Out, PartFile, Quiet, RigFile, Threads, make_folder
from lightopt.cli._terminal import say, show_share
from lightopt.core.errors import CheckFailed, InputError, counted

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet
    from lightopt.inspection import Detector, Fusion, InspectOptions


DEFAULT_FALSE_ALARMS = 0.05

Images = Annotated[
    list[Path],
    typer.Argument(metavar="IMAGES…", help="Image sets of one part each: folder or manifest.json."),
]


def inspect(
    rig: RigFile,
    part: PartFile,
    images: Images,
    out: Out,
    detector: Annotated[
        str,
        typer.Option(metavar="NAME", help="residual: measured against predicted; or template. [residual]"),
    ] = "residual",
    fusion: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Of the synthetic image: paper, median, minimum, second-largest; or none. [paper]",
        ),
    ] = "paper",
    false_alarms: Annotated[
        float | None,
        typer.Option(
            metavar="N",
            help="From 1e-9 to 1: how many per posture, where only noise differs; with a calibration the share of good "
            "parts with one in a posture. [0.05]",
        ),
    ] = None,
    seen_by: Annotated[
        int, typer.Option(metavar="K", help="A defect shows in so many images of a posture. [2]")
    ] = 2,
    no_shift: Annotated[
        bool, typer.Option("--no-shift", help="The part lies exactly where its file has it.")
    ] = False,
    calibrate: Annotated[
        bool,
        typer.Option(
            "--calibrate",
            help="IMAGES are of good parts: learn from them, and write calibration.json to DIR.",
        ),
    ] = False,
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="From --calibrate: holds the rate of false alarms on good parts."),
    ] = None,
    truth: Annotated[
        bool,
        typer.Option(
            "--truth",
            help="Hold the result against the sets' labels, or the defects of the part file that they were taken by: "
            "recall, false alarms, ROC, detection curve.",
        ),
    ] = False,
    fail_on_defect: Annotated[
        bool, typer.Option("--fail-on-defect", help="Exit status 1 where a part is NG.")
    ] = False,
    no_report: Annotated[bool, typer.Option("--no-report", help="Do not write report.html.")] = False,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Find defects in IMAGES of PART, and say where they are.

    Writes report.html, defects.json, .csv and .ply, the synthetic image without highlights with its uncertainty, scores
    and an overlay for each posture. Several sets, as of several parts, get a folder each. OK or NG is by the limits
    under inspection: in PART. With --calibrate the sets are of good parts, and what they teach is written instead.

    Example: lightopt inspect rig.yaml part.yaml captured/ -o inspected
    """
    from lightopt.images import read_image_set
    from lightopt.inspection import InspectOptions, read_calibration

    learned = None if calibration is None else read_calibration(calibration)
    if false_alarms is None:
        false_alarms = DEFAULT_FALSE_ALARMS if learned is None else learned.rate
    options = InspectOptions(
        detector=cast("Detector", detector),
        fusion=None if fusion == "none" else cast("Fusion", fusion),
        false_alarms=false_alarms,
        seen_by=seen_by,
        shift=not no_shift,
        threads=threads,
    )
    problems = options.problems()
    if threads is not None and threads < 1:
        problems.append(f"--threads: expected at least 1, found {threads}")
    if calibrate:
        given = {"--calibration": learned is not None, "--truth": truth, "--fail-on-defect": fail_on_defect}
        problems += [
            f"{name} is of an inspection, and --calibrate makes none" for name, is_ in given.items() if is_
        ]
    if problems:
        raise InputError(*problems)
    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    sets = [read_image_set(path) for path in images]
    if calibrate:
        _calibrate(loaded_rig, loaded_part, sets, out, options, force=force, quiet=quiet)
        return
    if learned is not None:
        learned.refuse_others(loaded_rig, loaded_part, options)
    wanted = Wanted(
        rig=loaded_rig,
        part=loaded_part,
        options=options,
        calibration=learned,
        truth=truth,
        report=not no_report,
        force=force,
        quiet=quiet,
    )
    rows = [inspect_one(wanted, sets[0], out)] if len(sets) == 1 else inspect_batch(wanted, sets, out)
    refused = [row.name for row in rows if row.verdict is None]
    bad = [
        f"{image_set.folder}: NG, {'; '.join(row.verdict.reasons)}"
        for image_set, row in zip(sets, rows, strict=True)
        if row.verdict is not None and not row.verdict.good
    ]
    if refused:
        told = f"{len(refused)} of {counted(len(sets), 'set')} not inspected: {', '.join(refused)}"
        raise InputError(*(bad if fail_on_defect else ()), told)
    if bad and fail_on_defect:
        raise CheckFailed(*bad)


def _calibrate(
    rig: RigConfig,
    part: PartConfig,
    sets: list[ImageSet],
    out: Path,
    options: InspectOptions,
    *,
    force: bool,
    quiet: bool,
) -> None:
    from lightopt.inspection import CalibrationFolder, calibrate, inspection_provenance, refuse_too_few

    refuse_too_few(len(sets), options)
    folder = CalibrationFolder(out, inspection_provenance(rig, part, sets, options), force=force)
    make_folder(out)
    with show_share(quiet=quiet) as progress:
        calibration = calibrate(rig, part, sets, options=options, progress=progress)
    path = folder.write(calibration)
    if not quiet:
        show_calibration(calibration, options.false_alarms)
        say(f"{path}")
