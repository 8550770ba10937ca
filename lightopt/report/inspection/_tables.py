"""What an inspection found and what it could see, as tables: the same cells on the terminal and in the report.

And its evaluation against ground truth: recall, false alarms, curves of detection.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightopt.core.errors import percent
from lightopt.estimate.registration import Placement
from lightopt.inspection import CONTRASTS, InspectionResult, PostureCoverage, SurfaceCoverage, Verdict
from lightopt.rendering import GRAZING_DEG
from lightopt.report._drawing import COLOURS, SOFT, chart, figure_image, fixed_style, name_lines
from lightopt.report._images import png_bytes
from lightopt.report._page import Block, Facts, Note, Picture, Table

LINE_COLOURS = (*COLOURS[1:], COLOURS[0])
POINTS = 60
MARGIN = 1.3  # curves are drawn from the smallest size over this to the largest times this


def defect_table(result: InspectionResult, verdict: Verdict) -> Table:
    """A row for each defect, the highest score first."""
    rows = [
        [
            str(defect.number),
            defect.best.kind,
            " ".join(defect.lights) or "-",
            "yes" if defect.number in verdict.counting else "no",
            ", ".join(f"{x:.2f}" for x in defect.best.position),
            f"{defect.size[0]:.2f} × {defect.size[1]:.2f}",
            f"{defect.area:.3g}",
            percent(defect.greatest_contrast, 0),
            f"{defect.best.score:.1f}",
            str(len(defect.detections)),
        ]
        for defect in result.defects
    ]
    header = ["", "kind", "lights", "counts", "position [mm]", "size [mm]", "area [mm²]", "contrast", "score"]
    return Table(
        header=[*header, "postures"],
        rows=rows,
        numbers_from=4,
        caption="Positions are in the coordinates of the mesh file. The score is −log₁₀ of the probability that noise "
        "alone looks as much like a defect. The lights are those that show the defect by themselves, by four standard "
        "deviations or more. If they are fewer than required, several images together exceed the noise.",
    )


def surface_table(result: InspectionResult) -> Table:
    """A row for each posture, and one for all: the surface by what each place can show, and by why it shows nothing.

    Columns from the fourth on are classes: each place is in one of them.
    """
    every = result.surface
    gap = every.missing > 0.0

    def row(name: str, cover: PostureCoverage | SurfaceCoverage, missing: float) -> list[str]:
        areas = [cover.inspected, *cover.classes, cover.edge, cover.saturated, cover.shadow]
        areas += [missing] if gap else []
        shares = [percent(area / max(cover.seen, 1e-9)) for area in areas]
        return [name, f"{cover.seen:.0f}", *shares, percent(cover.left_out)]

    rows = [row(str(p.view.posture), p.coverage, 0.0) for p in result.postures]
    if len(rows) > 1 or gap:
        rows.append(row("all postures", every, every.missing))
    header = ["posture", "seen [mm²]", "inspected", *(f"from {100.0 * c:g} %" for c in CONTRASTS)]
    header += ["stronger", "glints", "edges", "saturated", "in shadow", *(["no images"] if gap else []), "left out"]
    return Table(header=header, rows=rows, caption=" ".join(surface_notes(result)))


def surface_notes(result: InspectionResult) -> list[str]:
    """What the columns of :func:`surface_table` stand for, and what else there is to say of the surface; sentences."""
    every = result.surface
    seen = max(every.seen, 1e-9)
    legend = (
        f"Shares of the surface that the camera sees at up to {GRAZING_DEG:g}° to its normal. Left out: the rest, as a "
        "share of all that it sees. The inspected surface is divided by the smallest change of the light at which an "
        "even disc of 5 px is found half of the time, then surface that shows only stronger changes (stronger), and "
        "dark surface that shows only glints. The surface that was not inspected is divided by reason. The shares of "
        "all classes except left out add up to 100 %."
    )
    notes = [legend]
    if every.fewer > 0.0:
        notes.append(
            f"{percent(every.fewer / seen)} is lit in fewer images than must show a defect. There a defect must show "
            "in these images alone."
        )
    if len(result.postures) > 1 or every.missing > 0.0:
        never = percent(1.0 - (every.seen + every.grazing) / max(every.area, 1e-9))
        notes.append(
            "All postures: each place counts once, with the posture that shows it best. The verdict refers to this "
            f"row. {never} of the part's {every.area:.0f} mm² is never seen."
        )
    if every.missing > 0.0:
        notes.append("No images: seen only in postures of the part file of which the set has no images.")
    return notes


def dark_text(verdict: Verdict) -> str:
    """The share of the visible surface that shows only glints, as the end of a sentence; empty where none does."""
    return f"; {percent(verdict.glints)} is dark and shows only glints" if verdict.glints > 0.0 else ""


def placement_text(placement: Placement) -> str:
    """How far a part lies off its place, of what the images determine: shifts [mm] and rotations [°], with signs."""
    found = placement.as_dict()
    forms = {"x_mm": "{} mm in x", "y_mm": "{} mm in y", "turn_deg": "rotated by {}°", "z_mm": "{} mm in z"}
    forms |= {f"tilt_{axis}_deg": f"tilted by {{}}° about {axis}" for axis in "xy"}
    # adding 0 makes a nought of what is rounded to minus nought
    words = [
        form.format(f"{round(float(f'{found[key]}'), 3) + 0.0:+.3f}") for key, form in forms.items() if key in found
    ]
    return ", ".join(itertools.compress(words, placement.observable))


def truth_blocks(summary: Mapping[str, Any]) -> list[Block]:
    """The summary of :func:`lightopt.inspection.summarise`, for people."""
    area = summary["roc_auc"]
    hidden = ", ".join(summary["hidden"])
    facts = [
        ("found", f"{summary['found']} of {summary['defects']} defects in view"),
        (
            "without an evaluable pixel",
            f"{hidden}: out of view, at an edge, or narrower than a pixel" if hidden else "none",
        ),
        ("false alarms", f"{summary['false_alarms_per_posture']:g} per posture"),
        ("area under the pixels' ROC", "-" if area is None else f"{area:.4f}"),
    ]
    rows = [[row["kind"], f"{row['size_mm']:g}", str(row["defects"]), str(row["found"])] for row in summary["recall"]]
    caption = "Size is the square root of length times width."
    recall = Table(header=["kind", "size [mm]", "defects", "found"], rows=rows, caption=caption)
    return [Facts(rows=facts), recall, detection_table(summary), _chart(summary)]


def detection_table(summary: Mapping[str, Any]) -> Table:
    """A row for each kind of defect: how many were found, and of what size on."""
    return Table(
        header=["kind", "defects", "found", "a90 [mm]", "a90/95 [mm]"],
        rows=[
            [kind, str(curve["defects"]), str(curve["found"]), *map(_shown, (curve["a90"], curve["a90_95"]))]
            for kind, curve in summary["detection"].items()
        ],
        caption="a90 is the size found 90 % of the time by logistic regression on ln size, a90/95 its upper bound of "
        "95 % confidence; a dash where hits and misses do not determine it.",
    )


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
        probability = 1.0 / (1.0 + np.exp(-(curve["intercept"] + curve["steepness"] * np.log(x))))
        panel.plot(x, probability, color=colour, label=kind)
    name_lines(panel)
    return Picture(
        png=png_bytes(figure_image(figure)),
        alt=f"Curves of detection against size: {', '.join(curves)}; dots are single defects",
    )


def _shown(size: float | None) -> str:
    return "-" if size is None else f"{size:.3g}"
