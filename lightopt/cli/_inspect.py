from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from lightopt.cli._inputs import load_inputs
from lightopt.cli._options import Force, Out, PartFile, Quiet, RigFile, Threads, make_folder
from lightopt.cli._terminal import say, say_warning, show_share, show_table
from lightopt.errors import CheckFailed, InputError

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.images import ImageSet
    from lightopt.inspection import (
        BatchFolder,
        Calibration,
        Detector,
        Fusion,
        InspectedPosture,
        Inspection,
        InspectOptions,
        Predictions,
        TrueSet,
        Verdict,
    )
    from lightopt.report import BatchRow

__all__ = ["inspect"]

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
            help="Per posture, where only noise differs; of good parts with a calibration. [0.05]",
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
            help="Hold the result against the sets' labels, or against the defects that PART names: recall, false "
            "alarms, ROC, detection curve.",
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
    from lightopt.inspection import InspectOptions, Predictions, read_calibration

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
    folders = _folders(sets, out)
    wanted = _Wanted(
        rig=loaded_rig,
        part=loaded_part,
        options=options,
        calibration=learned,
        truth=truth,
        report=not no_report,
        force=force,
        quiet=quiet,
    )
    batch = _batch_folder(wanted, sets, out) if len(sets) > 1 else None
    predictions = Predictions()
    rows: list[BatchRow] = []
    known: list[TrueSet] = []
    begun = monotonic()
    for image_set, folder in zip(sets, folders, strict=True):
        row, true_set = _one(wanted, image_set, folder, predictions, alone=batch is None)
        rows.append(row)
        known += [] if true_set is None else [true_set]
    if batch is not None:
        if not quiet:
            minutes = (monotonic() - begun) / 60.0
            good = sum(row.verdict.good for row in rows)
            say(f"{len(sets)} parts, {good} OK; {len(sets) / max(minutes, 1e-9):.3g} parts per minute")
        _write_batch(wanted, batch, rows, known)
    bad = [
        f"{image_set.folder}: NG, {'; '.join(row.verdict.reasons)}"
        for image_set, row in zip(sets, rows, strict=True)
        if not row.verdict.good
    ]
    if bad and fail_on_defect:
        raise CheckFailed(*bad)


@dataclass(frozen=True, kw_only=True)
class _Wanted:
    """What is the same for all sets."""

    rig: RigConfig
    part: PartConfig
    options: InspectOptions
    calibration: Calibration | None
    truth: bool
    report: bool
    force: bool
    quiet: bool


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
    from lightopt.inspection import CalibrationFolder, calibrate, least_rate, provenance, refuse_too_few

    refuse_too_few(len(sets), options)
    folder = CalibrationFolder(out, provenance(rig, part, sets, options), force=force)
    make_folder(out)
    with show_share(quiet=quiet) as progress:
        calibration = calibrate(rig, part, sets, options=options, progress=progress)
    path = folder.write(calibration)
    if quiet:
        return
    rows = [
        [name, *(f"{posture.peaks[i]:.1f}" for posture in calibration.postures)]
        for i, name in enumerate(calibration.sets)
    ]
    rows.append(
        ["threshold", *(f"{posture.threshold(options.false_alarms):.1f}" for posture in calibration.postures)]
    )
    show_table(["greatest score", *(str(posture.posture) for posture in calibration.postures)], rows)
    say(
        f"{len(sets)} good sets hold {options.false_alarms:g} false alarms per posture, and would hold "
        f"{least_rate(len(sets)):.3g}"
    )
    say(f"{path}")


def _folders(sets: list[ImageSet], out: Path) -> list[Path]:
    if len(sets) == 1:
        return [out]
    names = [image_set.folder.resolve().name for image_set in sets]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"image sets of the same folder name ({', '.join(twice)}): results go to folders of these names in {out}; "
            "rename one, or inspect them one by one"
        )
    return [out / name for name in names]


def _one(
    wanted: _Wanted, image_set: ImageSet, out: Path, predictions: Predictions, *, alone: bool
) -> tuple[BatchRow, TrueSet | None]:
    from lightopt.inspection import (
        REPORT_NAME,
        TRUTH_NAME,
        InspectionFolder,
        compare_with_truth,
        inspect_set,
        judge,
        provenance,
        summarise,
        truth_text,
    )
    from lightopt.report import BatchRow, inspection_report
    from lightopt.scene import place_defects

    rig, part, options = wanted.rig, wanted.part, wanted.options
    made_from = provenance(rig, part, [image_set], options, calibration=wanted.calibration)
    folder = InspectionFolder(out, made_from, force=wanted.force)
    make_folder(out)
    with show_share(quiet=wanted.quiet) as progress:
        result = inspect_set(
            rig,
            part,
            image_set,
            options=options,
            predictions=predictions,
            calibration=wanted.calibration,
            progress=progress,
        )
    known = None
    if wanted.truth:
        placed = place_defects(result.nominal, rig, part)
        known = compare_with_truth(image_set, result, known=placed)
    summary = summarise([known]) if known is not None and alone else None
    verdict = judge(result, part.inspection)
    for posture in result.postures:
        folder.write_posture(posture)
        _overlay(folder, result, posture)
    more: list[Path] = []
    if summary is not None:
        more.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
    if wanted.report:
        page = inspection_report(
            result, verdict, part=part.name, rig=rig.name, provenance=made_from, truth=summary
        )
        more.append(folder.write_text(REPORT_NAME, page))
    written = [*folder.write(result, verdict.as_dict()), *more]
    for text in result.words:
        say_warning(text)
    if not wanted.quiet:
        _show(result, verdict)
        if summary is not None:
            _show_truth(summary)
        for path in written:
            say(f"{path}")
    row = BatchRow(name=image_set.folder.resolve().name, defects=len(result.defects), verdict=verdict)
    return row, known


def _batch_folder(wanted: _Wanted, sets: list[ImageSet], out: Path) -> BatchFolder:
    from lightopt.inspection import BatchFolder, provenance

    made_from = provenance(wanted.rig, wanted.part, sets, wanted.options, calibration=wanted.calibration)
    return BatchFolder(out, {**made_from, "truth": wanted.truth}, force=wanted.force)


def _write_batch(wanted: _Wanted, folder: BatchFolder, rows: list[BatchRow], known: list[TrueSet]) -> None:
    from lightopt import __version__
    from lightopt.inspection import REPORT_NAME, TRUTH_NAME, summarise, truth_text
    from lightopt.report import batch_report

    summary = summarise(known) if wanted.truth else None
    written: list[Path] = []
    if summary is not None:
        written.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
    if wanted.report:
        page = batch_report(
            rows, part=wanted.part.name, rig=wanted.rig.name, version=__version__, truth=summary
        )
        written.append(folder.write_text(REPORT_NAME, page))
    sets = [{"folder": row.name, "defects": row.defects, **row.verdict.as_dict()} for row in rows]
    written.insert(0, folder.finish({"sets": sets}))
    if not wanted.quiet:
        if summary is not None:
            _show_truth(summary)
        for path in written:
            say(f"{path}")


def _overlay(folder: object, result: Inspection, posture: InspectedPosture) -> None:
    from lightopt.images import posture_folder
    from lightopt.inspection import InspectionFolder
    from lightopt.report import defect_overlay

    assert isinstance(folder, InspectionFolder)
    numbers = {
        posture.sightings.index(sighting): defect.number
        for defect in result.defects
        for sighting in defect.sightings
        if sighting in posture.sightings
    }
    path = folder.place(f"{posture_folder(posture.view.posture)}/defects.png")
    defect_overlay(path, posture, numbers)


def _show_truth(summary: dict[str, Any]) -> None:
    say(
        f"{summary['found']} of {summary['defects']} defects found, {len(summary['hidden'])} out of view; "
        f"{summary['false_alarms_per_posture']:g} false alarms per posture; area under the pixels' ROC "
        f"{'-' if summary['roc_auc'] is None else summary['roc_auc']}"
    )
    rows = [
        [
            kind,
            f"{curve['found']} of {curve['defects']}",
            "-" if curve["a90"] is None else f"{curve['a90']:.3g}",
            "-" if curve["a90_95"] is None else f"{curve['a90_95']:.3g}",
        ]
        for kind, curve in summary["detection"].items()
    ]
    show_table(["kind", "found", "a90 [mm]", "a90/95 [mm]"], rows)


def _show(result: Inspection, verdict: Verdict) -> None:
    rows = [
        [
            str(defect.number),
            defect.best.kind,
            ", ".join(f"{x:.2f}" for x in defect.best.position),
            f"{defect.size[0]:.2f} × {defect.size[1]:.2f}",
            f"{defect.area:.3g}",
            f"{100.0 * defect.greatest_contrast:.0f} %",
            f"{defect.best.score:.1f}",
            str(len(defect.sightings)),
        ]
        for defect in result.defects
    ]
    if rows:
        head = ["", "kind", "place [mm]", "size [mm]", "area [mm²]", "contrast", "score", "postures"]
        show_table(head, rows, numbers_from=2)
    if result.placement is not None:
        p = result.placement.as_dict()
        say(
            f"the part lies {p['x_mm']:+.3f} mm in x, {p['y_mm']:+.3f} mm in y and {p['turn_deg']:+.3f}° from where "
            "its file has it"
        )
    for posture in result.postures:
        c = posture.coverage
        whole = max(c.seen, 1e-9) / 100.0
        say(
            f"posture {posture.view.posture}: {c.inspected / whole:.1f} % of {c.seen:.0f} mm² inspected; not: "
            f"{c.edge / whole:.1f} % edges, {c.saturated / whole:.1f} % saturated, {c.shadow / whole:.1f} % dark"
        )
    if len(result.postures) > 1:
        s = result.surface
        whole = max(s.seen, 1e-9) / 100.0
        say(
            f"all postures: {s.inspected / whole:.1f} % of {s.seen:.0f} mm² inspected in one or more; not: "
            f"{s.edge / whole:.1f} % edges, {s.saturated / whole:.1f} % saturated, {s.shadow / whole:.1f} % dark; "
            f"{100.0 * (1.0 - s.seen / max(s.area, 1e-9)):.1f} % of the part's {s.area:.0f} mm² is never seen"
        )
    say(f"{verdict.word}: {'; '.join(verdict.reasons) or 'nothing found that counts'}")
