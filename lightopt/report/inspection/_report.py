"""The reports of ``lightopt inspect``: of one part, the verdict first; of a batch, a row for each part.

What an inspection found and could see, and its evaluation, are tables with the same cells on the terminal.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lightopt import inspection
from lightopt.core.errors import counted, percent
from lightopt.estimate.registration import Placement
from lightopt.rendering import GRAZING_DEG
from lightopt.report._page import Answer, Block, Facts, Note, Page, Picture, Section, Table, Warnings, page_html
from lightopt.report._pictures import COLOURS, SOFT, chart, figure_image, fixed_style, name_lines, png_bytes
from lightopt.report.inspection._pictures import image_blocks, marked_part

LINE_COLOURS = (*COLOURS[1:], COLOURS[0])
POINTS = 60
MARGIN = 1.3  # curves are drawn from the smallest size over this to the largest times this


def inspection_report(
    result: inspection.InspectionResult,
    verdict: inspection.Verdict,
    *,
    part: str,
    rig: str,
    provenance: Mapping[str, Any],
    truth: Mapping[str, Any] | None,
) -> str:
    """The report of an inspection as HTML.

    provenance: From :func:`lightopt.inspection.inspection_provenance`.
    truth: From :func:`lightopt.inspection.summarise`; None where nothing is known of the part.
    """
    defects = defect_table(result, verdict) if result.defects else Note(text="No defect was found.")
    sections = [
        Section(heading="Positions of the defects", blocks=[marked_part(result, part)]),
        Section(heading="Defects", blocks=[defects]),
        Section(heading="Images", blocks=image_blocks(result)),
        Section(heading="Inspected surface", blocks=[surface_table(result)]),
        Section(heading="Comparison with ground truth", blocks=[] if truth is None else truth_blocks(truth)),
        Section(heading="Inputs and settings", blocks=[_facts(result, verdict, provenance)]),
    ]
    lead = [_answer(result, verdict), Warnings(texts=result.warnings)]
    subtitle = f"{part} on {rig}, lightopt {provenance['lightopt']}"
    return page_html(Page(title=f"{verdict.word}: {part}", subtitle=subtitle, lead=lead, sections=sections))


def _answer(result: inspection.InspectionResult, verdict: inspection.Verdict) -> Answer:
    found = counted(len(result.defects), "defect") if result.defects else "no defects"
    missing = result.surface.missing / max(result.surface.seen, 1e-9)
    rest = f" {percent(missing)} of the visible surface has no images." if missing > 0.0 else ""
    return Answer(
        figure=verdict.word,
        text=f"{verdict.explanation}. {found.capitalize()} on the {percent(verdict.inspected)} of the visible surface "
        f"that was inspected; {inspection.REFERENCE_DEFECT} is found on {percent(verdict.finds)}"
        f"{dark_text(verdict)}.{rest}",
    )


def _facts(result: inspection.InspectionResult, verdict: inspection.Verdict, provenance: Mapping[str, Any]) -> Facts:
    """Files, detector, limits, and what was found of the part's place and the brightness."""
    inputs: Mapping[str, Any] = provenance["inputs"]
    options: Mapping[str, Any] = provenance["options"]
    min_images: int = options["min_images"]
    fewer = any(len(p.view.lights) < min_images for p in result.postures)
    limits = verdict.limits
    reference = inspection.REFERENCES[result.reference]
    detector = inspection.InspectOptions(detector=options["detector"], reference=result.reference).scored_by
    counting = (
        f"at most {counted(limits.most_defects, 'defect')} of {limits.least_size_mm:g} mm or more and a contrast of "
        f"{percent(limits.least_contrast)} or more; at least {percent(limits.least_inspected)} of the visible surface "
        "inspected"
    )
    shows = f"a defect must show in {counted(min_images, 'image')}"
    without = {"file": "none; the threshold follows from the sensor's noise"}
    calibration = inputs.get("calibration", without)["file"]
    rows = [
        ("rig", f"{inputs['rig']['file']}, sha256 {inputs['rig']['sha256'][:16]}"),
        ("part", f"{inputs['part']['file']}, sha256 {inputs['part']['sha256'][:16]}"),
        ("compared with", f"{reference.basis}{f': {reference.limits}' if reference.limits else ''}"),
        ("detector", f"{detector}, {shows}{', or in all images where there are fewer' if fewer else ''}"),
        ("image without highlights", options["fusion"] or "none"),
        ("false-alarm rate", _alarms_text(provenance)),
        ("limits", counting),
        ("calibration", calibration),
    ]
    if result.placement is not None:
        place = placement_text(result.placement) or "cannot be determined; assumed as in the part file"
        rows.append(("displacement of the part", place))
    for posture in result.postures:
        view = posture.view
        gains = ", ".join(f"{name} ×{view.photometry.gains[name]:.4f}" for name in view.lights)
        found = f"threshold {posture.threshold:.2f}; fitted gains: {gains}"
        rows.append((f"posture {view.posture}", f"{found}; dark {view.photometry.dark:+.2f} levels"))
    return Facts(rows=rows)


def batch_report(
    rows: Sequence[inspection.BatchRow], *, part: str, rig: str, version: str, truth: Mapping[str, Any] | None
) -> str:
    """The report of several parts as HTML: a row each, in the order of the sets.

    truth: As :func:`inspection_report` takes it, over all sets.
    """
    good = sum(row.verdict is not None and row.verdict.good for row in rows)
    refused = sum(row.verdict is None for row in rows)
    finds = f"finds {100 * inspection.REFERENCE_CONTRAST:g} %"
    table = Table(
        header=["set", "verdict", "reasons", "defects", "that count", "inspected", finds, "only glints"],
        rows=[_cells(row) for row in rows],
        numbers_from=3,
        caption="A set's name leads to its own report. Inspected: share of the surface that the part's postures show. "
        f"Finds: share of it where {inspection.REFERENCE_DEFECT} is found half of the time. "
        "Only glints: share of it that was inspected, but is dark.",
        links=[row.report for row in rows],
    )
    rest = f"; {counted(refused, 'set')} not inspected" if refused else ""
    sections = [
        Section(heading="Parts", blocks=[table]),
        Section(heading="Comparison with ground truth", blocks=[] if truth is None else truth_blocks(truth)),
    ]
    title, subtitle = f"{counted(len(rows), 'part')}: {part}", f"{part} on {rig}, lightopt {version}"
    lead = [Answer(figure=f"{good} of {len(rows)}", text=f"parts are OK{rest}")]
    return page_html(Page(title=title, subtitle=subtitle, lead=lead, sections=sections))


def _cells(row: inspection.BatchRow) -> list[str]:
    verdict = row.verdict
    if verdict is None:
        return [row.name, row.word, "; ".join(row.refused), *"-----"]
    shares = map(percent, (verdict.inspected, verdict.finds, verdict.glints))
    return [row.name, row.word, verdict.explanation, str(row.defects), str(len(verdict.counting)), *shares]


def threshold_text(result: inspection.InspectionResult, provenance: Mapping[str, Any]) -> str:
    """The threshold of the score, over all postures, and the false-alarm rate that it is for."""
    low, *_, high = sorted([posture.threshold for posture in result.postures] * 2)
    values = f"{low:.1f}" if f"{low:.1f}" == f"{high:.1f}" else f"{low:.1f} to {high:.1f}"
    return f"{values} ({_alarms_text(provenance)})"


def _alarms_text(provenance: Mapping[str, Any]) -> str:
    rate = f"{provenance['options']['false_alarms']:g}"
    if "calibration" in provenance["inputs"]:
        return f"{rate} of good parts with a false alarm in a posture"
    return f"{rate} false alarms per posture"


def _kind_text(kind: str, named: str | None) -> str:
    # with the kind by the catalogue, which says more of a shape
    return kind if named in (None, kind) else f"{kind}: {named}"


def _contrast_text(contrast: float) -> str:
    # "-" where no light shows the defect by itself
    return percent(contrast, 0 if contrast >= 0.1 else 1) if contrast else "-"


def defect_table(result: inspection.InspectionResult, verdict: inspection.Verdict) -> Table:
    """A row for each defect, the highest score first."""
    thresholds = {posture.view.posture: posture.threshold for posture in result.postures}
    rows = [
        [
            str(defect.number),
            _kind_text(defect.best.kind, None if defect.best.named is None else defect.best.named.kind),
            " ".join(defect.lights) or "-",
            "yes" if defect.number in verdict.counting else "no",
            ", ".join(f"{x:.2f}" for x in defect.best.position),
            f"{defect.size[0]:.2f} × {defect.size[1]:.2f}",
            f"{defect.area:.3g}",
            _contrast_text(defect.greatest_contrast),
            f"{defect.best.score:.1f}",
            f"{thresholds[defect.best.posture]:.1f}",
            str(len(defect.detections)),
        ]
        for defect in result.defects
    ]
    header = ["", "kind", "lights", "counts", "position [mm]", "size [mm]", "area [mm²]", "contrast", "score"]
    return Table(
        header=[*header, "threshold", "postures"],
        rows=rows,
        numbers_from=4,
        caption="Positions are in the coordinates of the mesh file. The score is −log₁₀ of the probability that noise "
        "alone looks as much like a defect; a defect exceeds the threshold. The contrast is the largest under one of "
        "the lights; a dash where none shows the defect by itself. The lights are those that show the defect by "
        "themselves, by four standard deviations or more. If they are fewer than required, several images together "
        "exceed the noise.",
    )


def surface_table(result: inspection.InspectionResult) -> Table:
    """A row for each posture, and one for all: the surface by what each place can show, and by why it shows nothing.

    Columns from the fourth on are classes: each place is in one of them.
    """
    every = result.surface
    gap = every.missing > 0.0

    def row(name: str, cover: inspection.PostureCoverage | inspection.SurfaceCoverage, missing: float) -> list[str]:
        areas = [cover.inspected, *cover.classes, cover.edge, cover.saturated, cover.shadow]
        areas += [missing] if gap else []
        shares = [percent(area / max(cover.seen, 1e-9)) for area in areas]
        return [name, f"{cover.seen:.0f}", *shares, percent(cover.left_out)]

    rows = [row(str(p.view.posture), p.coverage, 0.0) for p in result.postures]
    if len(rows) > 1 or gap:
        rows.append(row("all postures", every, every.missing))
    header = ["posture", "seen [mm²]", "inspected", *(f"from {100.0 * c:g} %" for c in inspection.CONTRASTS)]
    header += ["stronger", "glints", "edges", "saturated", "in shadow", *(["no images"] if gap else []), "left out"]
    return Table(header=header, rows=rows, caption=" ".join(surface_notes(result)))


def surface_notes(result: inspection.InspectionResult) -> list[str]:
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


def dark_text(verdict: inspection.Verdict) -> str:
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
    unseen = f"{hidden}: out of view, at an edge, or narrower than a pixel" if hidden else "none"
    facts = [
        ("found", f"{summary['found']} of {summary['defects']} defects in view"),
        ("missed", "; ".join(missed_defects(summary)) or "none"),
        ("without an evaluable pixel", unseen),
        ("false alarms", f"{summary['false_alarms_per_posture']:g} per posture"),
        ("area under the pixels' ROC", "-" if area is None else f"{area:.4f}"),
    ]
    rows = [[row["kind"], f"{row['size_mm']:g}", str(row["defects"]), str(row["found"])] for row in summary["recall"]]
    caption = "Size is the square root of length times width."
    recall = Table(header=["kind", "size [mm]", "defects", "found"], rows=rows, caption=caption)
    return [Facts(rows=facts), recall, detection_table(summary), _chart(summary)]


def missed_defects(summary: Mapping[str, Any]) -> list[str]:
    """Known defects that were not found, each with its kind and size, and its set where there are several."""
    several = len(summary["sets"]) > 1
    return [
        f"{one['set'] + ': ' if several else ''}{one['name']} ({one['kind']}, {one['size_mm']:.2g} mm)"
        for one in summary["each"]
        if not one["found"]
    ]


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
    alt = f"Curves of detection against size: {', '.join(curves)}; dots are single defects"
    return Picture(png=png_bytes(figure_image(figure)), alt=alt)


def _shown(size: float | None) -> str:
    return "-" if size is None else f"{size:.3g}"
