"""The report of ``lightopt optimize``: the answer first, then what it is based on."""

from __future__ import annotations

from lightopt.design import DesignOutput
from lightopt.report._optimum_answer import answer_blocks, scores_table
from lightopt.report._optimum_facts import fact_blocks
from lightopt.report._optimum_pictures import curve_blocks, drawing_blocks, image_blocks
from lightopt.report._optimum_plan import (
    blind_tables,
    defect_blocks,
    exposure_blocks,
    posture_blocks,
    tolerance_blocks,
)
from lightopt.report._optimum_surface import surface_blocks
from lightopt.report._page import Page, Section
from lightopt.report._page_html import page_html


def optimum_report(output: DesignOutput) -> str:
    """The report of an optimisation as HTML; for :func:`lightopt.design.finish_design`."""
    return page_html(optimum_page(output))


def optimum_page(output: DesignOutput) -> Page:
    """The report of an optimisation as plain values."""
    sections = [
        Section(heading="What the images show", blocks=surface_blocks(output)),
        Section(heading="Blind spots", blocks=blind_tables(output)),
        Section(heading="Defects", blocks=defect_blocks(output)),
        Section(heading="Postures", blocks=posture_blocks(output)),
        Section(heading="Exposures", blocks=exposure_blocks(output)),
        Section(heading="Images of the best set", blocks=image_blocks(output)),
        Section(heading="Where the lights stand", blocks=drawing_blocks(output)),
        Section(heading="How flat the top is", blocks=curve_blocks(output)),
        Section(heading="How exact the angles must be", blocks=tolerance_blocks(output)),
        Section(heading="Scores", blocks=[scores_table(output)]),
        Section(heading="What was assumed", blocks=fact_blocks(output)),
    ]
    rig, part = output.result.rig, output.result.part
    return Page(
        title=f"Where the lights go: {part.name}",
        subtitle=f"{part.name} on {rig.name}, lightopt {output.document['provenance']['lightopt']}",
        lead=answer_blocks(output),
        sections=[section for section in sections if section.blocks],
    )
