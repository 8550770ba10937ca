"""The reports of ``lightopt inspect``: of one part, the verdict first; of a batch, a row for each part."""

from collections.abc import Mapping, Sequence
from typing import Any

from lightopt import inspection
from lightopt.core.errors import counted, percent
from lightopt.report._page import Answer, Facts, Note, Page, Section, Table, Warnings, page_html
from lightopt.report.inspection._pictures import image_blocks, marked_part
from lightopt.report.inspection._tables import dark_text, defect_table, placement_text, surface_table, truth_blocks


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

    part, rig: Names.
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
    rate, limits = options["false_alarms"], verdict.limits
    reference = inspection.REFERENCES[result.reference]
    detector = inspection.InspectOptions(detector=options["detector"], reference=result.reference).scored_by
    alarms = f"{rate:g} " + (
        "of good parts with a false alarm in a posture" if "calibration" in inputs else "per posture"
    )
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
        ("false-alarm rate", alarms),
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

    part, rig: Names.
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
