"""The report of ``lightopt inspect``: the verdict first, then the pictures, the defects, and what was not inspected."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from lightopt.core.errors import counted, percent
from lightopt.inspection import REFERENCE_DEFECT, InspectionResult, Verdict
from lightopt.report._inspection_facts import inspection_facts
from lightopt.report._inspection_images import image_blocks
from lightopt.report._inspection_surface import marked_part
from lightopt.report._inspection_tables import dark_told, defect_table, surface_table
from lightopt.report._page import Answer, Note, Page, Section, Warnings
from lightopt.report._page_html import page_html
from lightopt.report._truth_blocks import truth_blocks


def inspection_report(
    result: InspectionResult,
    verdict: Verdict,
    *,
    part: str,
    rig: str,
    provenance: Mapping[str, Any],
    truth: Mapping[str, Any] | None = None,
) -> str:
    """The report of an inspection as HTML; takes what :func:`inspection_page` takes."""
    return page_html(inspection_page(result, verdict, part=part, rig=rig, provenance=provenance, truth=truth))


def inspection_page(
    result: InspectionResult,
    verdict: Verdict,
    *,
    part: str,
    rig: str,
    provenance: Mapping[str, Any],
    truth: Mapping[str, Any] | None = None,
) -> Page:
    """The report of an inspection as plain values.

    Parameters
    ----------
    result, verdict
        Of one set of images.
    part, rig
        Their names.
    provenance
        From :func:`lightopt.inspection.inspection_provenance`.
    truth
        From :func:`lightopt.inspection.summarise`; None where nothing is known of the part.
    """
    sections = [
        Section(heading="Where the defects are", blocks=[marked_part(result, part)]),
        Section(
            heading="Defects",
            blocks=[defect_table(result, verdict) if result.defects else Note(text="None was found.")],
        ),
        Section(heading="Images", blocks=image_blocks(result)),
        Section(heading="What was inspected", blocks=[surface_table(result)]),
        Section(heading="Against the truth", blocks=[] if truth is None else truth_blocks(truth)),
        Section(heading="How it was inspected", blocks=[inspection_facts(result, verdict, provenance)]),
    ]
    return Page(
        title=f"{verdict.word}: {part}",
        subtitle=f"{part} on {rig}, lightopt {provenance['lightopt']}",
        lead=[_answer(result, verdict), Warnings(texts=result.warnings)],
        sections=[section for section in sections if section.blocks],
    )


def _answer(result: InspectionResult, verdict: Verdict) -> Answer:
    found = counted(len(result.defects), "defect") if result.defects else "no defects"
    missing = result.surface.missing / max(result.surface.seen, 1e-9)
    rest = f" {percent(missing)} of the visible surface has no images." if missing > 0.0 else ""
    return Answer(
        figure=verdict.word,
        text=f"{verdict.explanation}. {found.capitalize()} on the {percent(verdict.inspected)} of the visible surface "
        f"that was inspected; {REFERENCE_DEFECT} is found on {percent(verdict.finds)}{dark_told(verdict)}.{rest}",
    )
