"""What ``lightopt inspect`` says on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from lightopt.cli._terminal import say, show_table
from lightopt.core.errors import percent

if TYPE_CHECKING:
    from lightopt.inspection import Calibration, Inspection, Verdict


def show_calibration(calibration: Calibration, rate: float) -> None:
    """The greatest score of each good set, the threshold, and the rates that these sets bear."""
    from lightopt.inspection import least_rate

    rows = [
        [name, *(f"{posture.peaks[i]:.1f}" for posture in calibration.postures)]
        for i, name in enumerate(calibration.sets)
    ]
    rows.append(["threshold", *(f"{posture.threshold(rate):.1f}" for posture in calibration.postures)])
    show_table(["greatest score", *(str(posture.posture) for posture in calibration.postures)], rows)
    count = len(calibration.sets)
    say(
        f"{count} good sets hold a rate of {rate:g}, the share of good parts with a false alarm in a posture; they "
        f"would hold {least_rate(count):.3g}"
    )


def show_truth(summary: dict[str, Any]) -> None:
    """Recall, false alarms and the size that is detected, from :func:`lightopt.inspection.summarise`."""
    alarms, hidden, area = summary["false_alarms_per_posture"], summary["hidden"], summary["roc_auc"]
    why = " (out of view, at an edge, or narrower than a pixel)" if hidden else ""
    say(
        f"{summary['found']} of {summary['defects']} defects found, {len(hidden)} shown by no pixel to judge{why}; "
        f"{alarms:g} false alarm{'' if alarms == 1.0 else 's'} per posture; area under the pixels' ROC "
        f"{'-' if area is None else area}"
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


def show_inspection(result: Inspection, verdict: Verdict) -> None:
    """Defects, where the part lies, what was inspected, and the verdict."""
    from lightopt.inspection import TOLD_DISC
    from lightopt.report import dark_text, defect_table, placement_text, surface_notes, surface_table

    if result.defects:
        table = defect_table(result, verdict)
        show_table(table.header, table.rows, numbers_from=table.numbers_from)
    if result.placement is not None and (place := placement_text(result.placement)):
        say(f"the part lies off where its file has it by {place}")
    table = surface_table(result)
    show_table(table.header, table.rows, numbers_from=table.numbers_from)
    for sentence in surface_notes(result):
        say(sentence)
    say(f"{TOLD_DISC} is found on {percent(verdict.finds)} of the visible surface{dark_text(verdict)}")
    say(f"{verdict.word}: {verdict.told}")
