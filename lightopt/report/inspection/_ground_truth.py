"""Evaluation of an inspection against ground truth: recall, false alarms, curves of detection."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightopt.report._charts import COLOURS, chart, name_lines
from lightopt.report._drawing import SOFT, figure_image, fixed_style
from lightopt.report._images import png_bytes
from lightopt.report._page import Block, Facts, Note, Picture, Table

LINE_COLOURS = (*COLOURS[1:], COLOURS[0])
POINTS = 60
MARGIN = 1.3  # curves are drawn from the smallest size over this to the largest times this


def truth_blocks(summary: Mapping[str, Any]) -> list[Block]:
    """The summary of :func:`lightopt.inspection.summarise`, for people."""
    area = summary["roc_auc"]
    facts = Facts(
        rows=[
            ("found", f"{summary['found']} of {summary['defects']} defects in view"),
            (
                "shown by no pixel to judge",
                f"{', '.join(summary['hidden'])}: out of view, at an edge, or narrower than a pixel"
                if summary["hidden"]
                else "none",
            ),
            ("false alarms", f"{summary['false_alarms_per_posture']:g} per posture"),
            ("area under the pixels' ROC", "-" if area is None else f"{area:.4f}"),
        ]
    )
    recall = Table(
        header=["kind", "size [mm]", "defects", "found"],
        rows=[
            [row["kind"], f"{row['size_mm']:g}", str(row["defects"]), str(row["found"])] for row in summary["recall"]
        ],
        caption="Size is the square root of length times width.",
    )
    curves = Table(
        header=["kind", "defects", "found", "a90 [mm]", "a90/95 [mm]"],
        rows=[
            [kind, str(curve["defects"]), str(curve["found"]), *map(_shown, (curve["a90"], curve["a90_95"]))]
            for kind, curve in summary["detection"].items()
        ],
        caption="a90 is the size found 90 % of the time by logistic regression on ln size, a90/95 its upper bound of "
        "95 % confidence; - where hits and misses do not tell it.",
    )
    return [facts, recall, curves, _chart(summary)]


@fixed_style()
def _chart(summary: Mapping[str, Any]) -> Block:
    each: Sequence[Mapping[str, Any]] = summary["each"]
    curves = {kind: c for kind, c in summary["detection"].items() if c["steepness"] is not None}
    if not curves or not each:
        return Note(text="No curve of detection: too few defects, or hits and misses that do not rise with size.")
    sizes = np.array([one["size_mm"] for one in each], np.float64)
    x = np.geomspace(sizes.min() / MARGIN, sizes.max() * MARGIN, POINTS)
    figure, (panel,) = chart(
        title="Probability of detection", x_label="size of the defect [mm]", labels=["found: 1, missed: 0"], log_x=True
    )
    panel.plot(sizes, [float(one["found"]) for one in each], "o", color=SOFT)
    for (kind, curve), colour in zip(curves.items(), itertools.cycle(LINE_COLOURS)):
        panel.plot(x, _curve(curve, x), color=colour, label=kind)
    name_lines(panel)
    return Picture(
        png=png_bytes(figure_image(figure)),
        alt=f"Curves of detection against size: {', '.join(curves)}; dots are single defects",
    )


def _curve(curve: Mapping[str, Any], x: np.ndarray) -> np.ndarray:
    return 1.0 / (1.0 + np.exp(-(curve["intercept"] + curve["steepness"] * np.log(x))))


def _shown(size: float | None) -> str:
    return "-" if size is None else f"{size:.3g}"
