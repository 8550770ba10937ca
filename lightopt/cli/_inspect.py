from __future__ import annotations

from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, cast

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._inspect_output import Output, show_batch, show_calibration, write_batch, write_set
from lightopt.cli._options import (
    Force,
    MinImages,
    Out,
    PartFile,
    Quiet,
    Register,
    Report,
    RigFile,
    Threads,
    Verbose,
    make_folder,
    model_option,
    output_option,
)
from lightopt.cli._terminal import echo, echo_error, echo_warning, show_progress
from lightopt.core.errors import CheckFailed, InputError, counted
from lightopt.core.run_context import RunContext, StageShare

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet
    from lightopt.inspection import BatchRow, Calibration, Fusion, InspectOptions


DEFAULT_FALSE_ALARMS = 0.05
calibration_option = partial(typer.Option, rich_help_panel="Calibration with good parts")

Images = Annotated[
    list[Path], typer.Argument(metavar="IMAGES…", help="Image sets of one part each: folder or manifest.json.")
]


def inspect(
    rig: RigFile,
    part: PartFile,
    images: Images,
    out: Out,
    detector: Annotated[
        str,
        model_option(
            metavar="residual|template",
            help="Measured against predicted levels; or dots and lines in the synthetic image.",
        ),
    ] = "residual",
    fusion: Annotated[
        str,
        model_option(
            metavar="paper|median|minimum|second-largest|none",
            help="Rule that makes the synthetic image without highlights.",
        ),
    ] = "paper",
    false_alarms: Annotated[
        float | None,
        model_option(
            metavar="N",
            help="False alarms per posture where only noise differs, from 1e-9 to 1; with --calibration the share of "
            "good parts with a false alarm in a posture.",
            show_default="0.05",
        ),
    ] = None,
    min_images: MinImages = 2,
    register: Register = True,
    calibrate: Annotated[
        bool,
        calibration_option(
            "--calibrate", help="Learn from IMAGES, which are of good parts, and write calibration.json."
        ),
    ] = False,
    calibration: Annotated[
        Path | None,
        calibration_option(metavar="FILE", help="calibration.json of good parts; holds the false-alarm rate on them."),
    ] = None,
    evaluate: Annotated[
        bool,
        output_option(
            "--evaluate",
            help="Compare the result with ground truth, which is the sets' labels or the defects of the part file that "
            "they were made with: recall, false alarms, ROC, detection curve.",
        ),
    ] = False,
    fail_on_defect: Annotated[
        bool, output_option("--fail-on-defect", help="Exit status 1 where a part is NG.")
    ] = False,
    report: Report = True,
    force: Force = False,
    threads: Threads = None,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    """Find defects in IMAGES of PART and report where they are.

    Writes report.html, defects.json, .csv and .ply, the synthetic image without highlights with its uncertainty, scores
    and an overlay for each posture. Several sets, as of several parts, get a folder each. OK or NG is by the limits
    under inspection: in PART. With --calibrate the sets are of good parts, and only calibration.json is written.

    Example: lightopt inspect rig.yaml part.yaml captured/ -o inspected
    """
    from lightopt.images import read_image_set
    from lightopt.inspection import InspectOptions, read_calibration

    learned = None if calibration is None else read_calibration(calibration)
    if false_alarms is None:
        false_alarms = DEFAULT_FALSE_ALARMS if learned is None else learned.rate
    options = InspectOptions(
        detector=detector,
        fusion=None if fusion == "none" else cast("Fusion", fusion),
        false_alarms=false_alarms,
        min_images=min_images,
        register=register,
    )
    problems = options.problems()
    if calibrate:
        given = {"--calibration": learned is not None, "--evaluate": evaluate, "--fail-on-defect": fail_on_defect}
        problems += [f"{name}: not with --calibrate, which inspects nothing" for name, is_ in given.items() if is_]
    if problems:
        raise InputError(*problems)
    loaded_rig, loaded_part = load_inputs(rig, part)
    assert loaded_part is not None
    sets = [read_image_set(path) for path in images]
    if calibrate:
        _calibrate(loaded_rig, loaded_part, sets, out, options, threads=threads, force=force, quiet=quiet)
        return
    if learned is not None:
        learned.require_match(loaded_rig, loaded_part, options)
    output = Output(rig=loaded_rig, part=loaded_part, report=report, threads=threads, quiet=quiet, verbose=verbose)
    rows = _inspect(output, sets, out, options, learned, evaluate=evaluate, force=force)
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
    evaluate: bool,
    force: bool,
) -> list[BatchRow]:
    # one set goes to `out`; several go to folders below it, and what is said of all of them to `out`
    from lightopt.inspection import (
        BatchFolder,
        BatchRow,
        InspectionFolder,
        SetEvaluation,
        inspect_batch,
        inspection_provenance,
        set_names,
        truth_sources,
    )

    rig, part, several = output.rig, output.part, len(sets) > 1
    names = set_names(sets, out)
    sources = truth_sources(sets, part) if evaluate else None
    describe = partial(inspection_provenance, rig, part, options=options, calibration=calibration)
    batch = None
    if several:
        made_from = describe(sets)
        made_from["options"]["evaluate"] = evaluate
        batch = BatchFolder(out, made_from, force=force)
    folders = [
        InspectionFolder(out / name if several else out, describe([image_set], before=sets[:number]), force=force)
        for number, (image_set, name) in enumerate(zip(sets, names, strict=True))
    ]
    shown: list[StageShare | None] = [None]

    def progress(stage: str, share: float) -> None:
        if shown[0] is not None:
            shown[0](stage, share)

    results = inspect_batch(
        rig,
        part,
        sets,
        options=options,
        calibration=calibration,
        truth=sources,
        folders=folders,
        run=RunContext(threads=output.threads, progress=progress, warn=echo_warning),
    )
    rows: list[BatchRow] = []
    evaluations: list[SetEvaluation] = []
    begun = monotonic()
    for name, image_set, folder in zip(names, sets, folders, strict=True):
        with show_progress(quiet=output.quiet) as shown[0]:  # ends before the result is printed
            inspected = next(results)
        if inspected.error is not None:
            if not several:
                raise inspected.error
            folder.clear()
            own = f"{image_set.folder}"
            bare = (message.removeprefix(own).lstrip(",: ") for message in inspected.error.messages)
            echo_error(*(f"{name}: not inspected: {message}" for message in bare))
            # results name folders, and not where on this machine they are
            reasons = (message.replace(own, name) for message in inspected.error.messages)
            rows.append(BatchRow(name=name, refused=tuple(reasons)))
            continue
        rows.append(write_set(output, folder, inspected, summarised=not several))
        if inspected.evaluation is not None:
            evaluations.append(inspected.evaluation)
    if batch is not None:
        if not output.quiet:
            show_batch(rows, minutes=(monotonic() - begun) / 60.0)
        write_batch(output, batch, rows, evaluations if evaluate else None)
    return rows


def _calibrate(
    rig: RigConfig,
    part: PartConfig,
    sets: list[ImageSet],
    out: Path,
    options: InspectOptions,
    *,
    threads: int | None,
    force: bool,
    quiet: bool,
) -> None:
    from lightopt.inspection import CalibrationFolder, calibrate, inspection_provenance, require_good_sets

    require_good_sets(len(sets), options)
    folder = CalibrationFolder(out, inspection_provenance(rig, part, sets, options), force=force)
    make_folder(out)
    with show_progress(quiet=quiet) as progress:
        run = RunContext(threads=threads, progress=progress, warn=echo_warning)
        calibration = calibrate(rig, part, sets, options=options, run=run)
    path = folder.write(calibration)
    if not quiet:
        show_calibration(calibration, options.false_alarms)
        echo(f"{path}")
