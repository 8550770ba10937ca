from __future__ import annotations

from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, cast

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._inspect_output import Output, show_batch, show_calibration, write_batch, write_set
from lightopt.cli._options import Force, Out, PartFile, Quiet, RigFile, Threads, make_folder
from lightopt.cli._terminal import say, say_error, say_warning, show_share
from lightopt.core.errors import CheckFailed, InputError, counted

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet
    from lightopt.inspection import Calibration, Detector, Fusion, InspectOptions
    from lightopt.report.inspection import BatchRow


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
        bool, typer.Option("--no-shift", help="Skip registration; assume nominal placement.")
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
    """Find defects in IMAGES of PART and report where they are.

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
        learned.require_match(loaded_rig, loaded_part, options)
    output = Output(rig=loaded_rig, part=loaded_part, report=not no_report, quiet=quiet)
    rows = _inspect(output, sets, out, options, learned, truth=truth, force=force)
    refused = [row.name for row in rows if row.verdict is None]
    bad = [
        f"{image_set.folder}: NG, {'; '.join(row.verdict.reasons)}"
        for image_set, row in zip(sets, rows, strict=True)
        if row.verdict is not None and not row.verdict.good
    ]
    if refused:
        summary = f"{len(refused)} of {counted(len(sets), 'set')} not inspected: {', '.join(refused)}"
        raise InputError(*(bad if fail_on_defect else ()), summary)
    if bad and fail_on_defect:
        raise CheckFailed(*bad)


def _inspect(
    output: Output,
    sets: list[ImageSet],
    out: Path,
    options: InspectOptions,
    calibration: Calibration | None,
    *,
    truth: bool,
    force: bool,
) -> list[BatchRow]:
    # one set goes to `out`; several go to folders below it, and what is said of all of them to `out`
    from lightopt.inspection import (
        BatchFolder,
        InspectionFolder,
        SetEvaluation,
        inspect_batch,
        inspection_provenance,
        set_names,
        truth_sources,
    )
    from lightopt.report.inspection import BatchRow

    rig, part, several = output.rig, output.part, len(sets) > 1
    names = set_names(sets, out)
    sources = truth_sources(sets, part) if truth else None
    describe = partial(inspection_provenance, rig, part, options=options, calibration=calibration)
    batch = None
    if several:
        made_from = describe(sets)
        made_from["options"]["truth"] = truth
        batch = BatchFolder(out, made_from, force=force)
    folders = [
        InspectionFolder(
            out / name if several else out, describe([image_set], before=sets[:number]), force=force
        )
        for number, (image_set, name) in enumerate(zip(sets, names, strict=True))
    ]
    results = inspect_batch(
        rig,
        part,
        sets,
        options=options,
        calibration=calibration,
        truth=sources,
        folders=folders,
        progress=partial(show_share, quiet=output.quiet),
    )
    rows: list[BatchRow] = []
    evaluations: list[SetEvaluation] = []
    begun = monotonic()
    for name, image_set, folder in zip(names, sets, folders, strict=True):
        if several and not output.quiet:
            say(f"{name}:")
        inspected = next(results)
        if inspected.error is not None:
            if not several:
                raise inspected.error
            folder.clear()
            own = f"{image_set.folder}"
            bare = (message.removeprefix(own).lstrip(",: ") for message in inspected.error.messages)
            say_error(*(f"{name}: not inspected: {message}" for message in bare))
            # results name folders, and not where on this machine they are
            reasons = (message.replace(own, name) for message in inspected.error.messages)
            rows.append(BatchRow(name=name, refused=tuple(reasons)))
            continue
        for text in inspected.warnings:
            say_warning(f"{name}: {text}" if several else text)
        rows.append(write_set(output, folder, inspected, summarised=not several))
        if inspected.evaluation is not None:
            evaluations.append(inspected.evaluation)
    if batch is not None:
        if not output.quiet:
            show_batch(rows, minutes=(monotonic() - begun) / 60.0)
        write_batch(output, batch, rows, evaluations if truth else None)
    return rows


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
    from lightopt.inspection import CalibrationFolder, calibrate, inspection_provenance, require_good_sets

    require_good_sets(len(sets), options)
    folder = CalibrationFolder(out, inspection_provenance(rig, part, sets, options), force=force)
    make_folder(out)
    with show_share(quiet=quiet) as progress:
        calibration = calibrate(rig, part, sets, options=options, progress=progress)
    path = folder.write(calibration)
    if not quiet:
        show_calibration(calibration, options.false_alarms)
        say(f"{path}")
