"""The report of a batch of ``lightopt inspect``: how many parts are OK, and a row for each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from lightopt.core.errors import counted, percent
from lightopt.inspection import REFERENCE_CONTRAST, REFERENCE_DEFECT, BatchRow
from lightopt.report._page import Answer, Page, Section, Table
from lightopt.report._page_html import page_html
from lightopt.report._truth_blocks import truth_blocks


def batch_report(
    rows: Sequence[BatchRow],
    *,
    part: str,
    rig: str,
    version: str,
    truth: Mapping[str, Any] | None = None,
) -> str:
    """The report of several parts as HTML: a row each, in the order of the sets.

    Parameters
    ----------
    part, rig
        Their names.
    version
        Of lightopt.
    truth
        As :func:`inspection_report` takes it, over all sets.
    """
    good = sum(row.verdict is not None and row.verdict.good for row in rows)
    refused = sum(row.verdict is None for row in rows)
    table = Table(
        header=[
            "set",
            "verdict",
            "reasons",
            "defects",
            "that count",
            "inspected",
            f"finds {100 * REFERENCE_CONTRAST:g} %",
            "only glints",
        ],
        rows=[_cells(row) for row in rows],
        numbers_from=3,
        caption="A set's name leads to its own report. Inspected: share of the surface that the part's postures show. "
        f"Finds: share of it where {REFERENCE_DEFECT} is found half of the time. Only glints: share of it that was "
        "inspected, but is dark.",
        links=[row.report for row in rows],
    )
    rest = f"; {counted(refused, 'set')} not inspected" if refused else ""
    sections = [
        Section(heading="Parts", blocks=[table]),
        Section(heading="Against the truth", blocks=[] if truth is None else truth_blocks(truth)),
    ]
    return page_html(
        Page(
            title=f"{counted(len(rows), 'part')}: {part}",
            subtitle=f"{part} on {rig}, lightopt {version}",
            lead=[Answer(figure=f"{good} of {len(rows)}", text=f"parts are OK{rest}")],
            sections=[section for section in sections if section.blocks],
        )
    )


def _cells(row: BatchRow) -> list[str]:
    verdict = row.verdict
    if verdict is None:
        return [row.name, row.word, "; ".join(row.refused), *"-----"]
    return [
        row.name,
        row.word,
        verdict.explanation,
        str(row.defects),
        str(len(verdict.counting)),
        percent(verdict.inspected),
        percent(verdict.finds),
        percent(verdict.glints),
    ]
