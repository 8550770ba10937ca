"""What ``lightopt inspect`` writes and prints: pictures, reports and tables of inspected sets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lightopt.cli._terminal import echo, show_progress, show_table
from lightopt.core.errors import percent

if TYPE_CHECKING:
    from lightopt.config import PartConfig, RigConfig
    from lightopt.inspection import (
        BatchFolder,
        BatchRow,
        Calibration,
        InspectedSet,
        InspectionFolder,
        InspectionResult,
        SetEvaluation,
        Verdict,
    )


@dataclass(frozen=True, kw_only=True)
class Output:
    """What is the same for all sets."""

    rig: RigConfig
    part: PartConfig
    report: bool
    threads: int | None
    quiet: bool
    verbose: bool


MOST_DEFECTS = 6  # rows of the table of defects without `--verbose`; defects.csv has all of them


def write_set(output: Output, folder: InspectionFolder, inspected: InspectedSet, *, summarised: bool) -> BatchRow:
    """Print a result, write its files, and the evaluation where it is `summarised` for this set alone."""
    from lightopt.images import posture_folder
    from lightopt.inspection import REPORT_NAME, TRUTH_NAME, BatchRow, summarise, truth_text
    from lightopt.report.inspection import defect_overlay, inspection_report

    result, verdict = inspected.result, inspected.verdict
    assert result is not None
    assert verdict is not None
    summary = summarise([inspected.evaluation]) if summarised and inspected.evaluation is not None else None
    if not output.quiet:  # before the pictures, which take longer than the inspection did
        if summarised:
            _show_inspection(result, verdict, verbose=output.verbose)
        else:
            echo(f"{inspected.name}: {verdict.word}: {verdict.explanation}")
    with show_progress(quiet=output.quiet) as progress:
        for number, posture in enumerate(result.postures):
            if progress is not None:
                progress(f"pictures of posture {posture.view.posture}", number / len(result.postures))
            folder.write_posture(posture)
            path = folder.place(f"{posture_folder(posture.view.posture)}/defects.png")
            defect_overlay(path, posture, result.defects)
    more: list[Path] = []
    if summary is not None:
        more.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
    if output.report:
        page = inspection_report(
            result, verdict, part=output.part.name, rig=output.rig.name, provenance=folder.made_from, truth=summary
        )
        more.append(folder.write_text(REPORT_NAME, page))
    _show_written(output, summary, [*folder.write(result, verdict), *more])
    report = f"{inspected.name}/{REPORT_NAME}" if output.report else ""
    return BatchRow(name=inspected.name, report=report, defects=len(result.defects), verdict=verdict)


def write_batch(
    output: Output, folder: BatchFolder, rows: Sequence[BatchRow], evaluations: Sequence[SetEvaluation] | None
) -> None:
    """Write the files above the folders of several sets."""
    from lightopt import __version__
    from lightopt.inspection import REPORT_NAME, TRUTH_NAME, summarise, truth_text
    from lightopt.report.inspection import batch_report

    summary = None if evaluations is None else summarise(evaluations)
    written: list[Path] = []
    if summary is not None:
        written.append(folder.write_text(TRUTH_NAME, truth_text(summary)))
    if output.report:
        page = batch_report(rows, part=output.part.name, rig=output.rig.name, version=__version__, truth=summary)
        written.append(folder.write_text(REPORT_NAME, page))
    written.insert(0, folder.finish({"sets": [row.as_dict() for row in rows]}))
    _show_written(output, summary, written)


def _show_written(output: Output, summary: Mapping[str, Any] | None, written: Sequence[Path]) -> None:
    if output.quiet:
        return
    if summary is not None:
        _show_evaluation(summary, verbose=output.verbose)
    for path in written:
        echo(f"{path}")


def show_batch(rows: Sequence[BatchRow], *, minutes: float) -> None:
    """How many parts are OK, and how long a part took."""
    refused = sum(row.verdict is None for row in rows)
    good = sum(row.verdict.good for row in rows if row.verdict is not None)
    others = f", {refused} not inspected" if refused else ""
    echo(f"{len(rows)} parts, {good} OK{others}; {len(rows) / max(minutes, 1e-9):.3g} parts per minute")


def show_calibration(calibration: Calibration, rate: float) -> None:
    """The greatest score of each good set, the threshold, and the rates that these sets can hold."""
    from lightopt.inspection import least_rate

    rows = [
        [name, *(f"{posture.peaks[i]:.1f}" for posture in calibration.postures)]
        for i, name in enumerate(calibration.sets)
    ]
    rows.append(["threshold", *(f"{posture.threshold(rate):.1f}" for posture in calibration.postures)])
    show_table(["greatest score", *(str(posture.posture) for posture in calibration.postures)], rows)
    count = len(calibration.sets)
    echo(
        f"{count} good sets hold a rate of {rate:g}, the share of good parts with a false alarm in a posture; they "
        f"would hold {least_rate(count):.3g}"
    )


def _show_evaluation(summary: Mapping[str, Any], *, verbose: bool) -> None:
    # recall, false alarms and the size that is detected, from lightopt.inspection.summarise
    alarms, hidden, area = summary["false_alarms_per_posture"], summary["hidden"], summary["roc_auc"]
    why = " (out of view, at an edge, or narrower than a pixel)" if hidden else ""
    echo(
        f"{summary['found']} of {summary['defects']} defects found, {len(hidden)} shown by no pixel to judge{why}; "
        f"{alarms:g} false alarm{'' if alarms == 1.0 else 's'} per posture; area under the pixels' ROC "
        f"{'-' if area is None else area}"
    )
    if not verbose:
        return
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


def _show_inspection(result: InspectionResult, verdict: Verdict, *, verbose: bool) -> None:
    # the verdict, defects, where the part lies, what was inspected
    from lightopt.inspection import REFERENCE_DEFECT
    from lightopt.report.inspection import dark_text, defect_table, placement_text, surface_notes, surface_table

    echo(f"{verdict.word}: {verdict.explanation}")
    if result.defects:
        table = defect_table(result, verdict)
        rows = table.rows if verbose else table.rows[:MOST_DEFECTS]
        show_table(table.header, rows, numbers_from=table.numbers_from)
        if len(rows) < len(table.rows):
            echo(f"and {len(table.rows) - len(rows)} more; --verbose shows them")
    if result.placement is not None and (place := placement_text(result.placement)):
        echo(f"the part lies off its nominal place by {place}")
    echo(f"{REFERENCE_DEFECT} is found on {percent(verdict.finds)} of the visible surface{dark_text(verdict)}")
    if verbose:
        table = surface_table(result)
        show_table(table.header, table.rows, numbers_from=table.numbers_from)
        for sentence in surface_notes(result):
            echo(sentence)
