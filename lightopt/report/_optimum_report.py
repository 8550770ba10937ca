"""The report of ``lightopt optimize``: the answer first, then what it rests on."""

from __future__ import annotations

from lightopt.design import Draft
from lightopt.report._optimum_answer import answer_blocks, scores_table
from lightopt.report._optimum_facts import fact_blocks
from lightopt.report._optimum_pictures import curve_blocks, drawing_blocks, image_blocks
from lightopt.report._optimum_plan import (
    blind_tables,
    defect_blocks,
    exposure_blocks,
    posture_blocks,
    trust_blocks,
)
from lightopt.report._optimum_surface import surface_blocks
from lightopt.report._page import Page, Section
from lightopt.report._page_html import page_html


def optimum_report(draft: Draft) -> str:
    """The report of an optimisation as HTML; for :func:`lightopt.design.optimize`."""
    return page_html(optimum_page(draft))


def optimum_page(draft: Draft) -> Page:
    """The report of an optimisation as plain values."""
    sections = [
        Section(heading="What the images show", blocks=surface_blocks(draft)),
        Section(heading="Blind spots", blocks=blind_tables(draft)),
        Section(heading="Defects", blocks=defect_blocks(draft)),
        Section(heading="Postures", blocks=posture_blocks(draft)),
        Section(heading="Exposures", blocks=exposure_blocks(draft)),
        Section(heading="Images of the best set", blocks=image_blocks(draft)),
        Section(heading="Where the lights stand", blocks=drawing_blocks(draft)),
        Section(heading="How flat the top is", blocks=curve_blocks(draft)),
        Section(heading="How exact the angles must be", blocks=trust_blocks(draft)),
        Section(heading="Scores", blocks=[scores_table(draft)]),
        Section(heading="What was assumed", blocks=fact_blocks(draft)),
    ]
    return Page(
        title=f"Where the lights go: {draft.part.name}",
        subtitle=f"{draft.part.name} on {draft.rig.name}, lightopt {draft.document['provenance']['lightopt']}",
        lead=answer_blocks(draft),
        sections=[section for section in sections if section.blocks],
    )
