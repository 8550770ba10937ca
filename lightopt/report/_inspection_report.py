"""The report of ``lightopt inspect``: the verdict first, then the pictures, the defects, and what was not inspected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from lightopt.config import InspectionConfig
from lightopt.errors import counted, percent
from lightopt.inspection import (
    TOLD_CONTRAST,
    TOLD_DISC,
    InspectedPosture,
    Inspection,
    Verdict,
    grey_picture,
)
from lightopt.report._canvas import png_bytes
from lightopt.report._inspection_pictures import enlarged, overlay_image
from lightopt.report._inspection_surface import marked_part
from lightopt.report._inspection_tables import dark_told, defect_table, placement_told, surface_table
from lightopt.report._page import (
    Answer,
    Block,
    Facts,
    Gallery,
    Note,
    Page,
    Picture,
    Section,
    Table,
    Warnings,
)
from lightopt.report._page_html import page_html
from lightopt.report._thumbnail import shrunk
from lightopt.report._truth_blocks import truth_blocks

__all__ = ["BatchRow", "batch_report", "inspection_page", "inspection_report"]

NOT_INSPECTED = "not inspected"

OVERLAY_PX, SMALL_PX = 1600, 480
"""No side of a picture in the report is longer."""

COLUMN_PX = 896
"""A picture of smaller images is made larger by whole factors up to the width that the page gives it."""


@dataclass(frozen=True, kw_only=True)
class BatchRow:
    """One part of a batch.

    Attributes
    ----------
    name
        Of its folder.
    report
        Its own report, relative to the batch's; empty where it has none.
    defects
        That were found, whether they count or not.
    verdict
        On it; None where it was refused.
    refused
        Why it was not inspected.
    """

    name: str
    report: str = ""
    defects: int = 0
    verdict: Verdict | None = None
    refused: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        if self.verdict is None:
            return {"folder": self.name, "verdict": NOT_INSPECTED, "reasons": list(self.refused)}
        return {"folder": self.name, "defects": self.defects, **self.verdict.as_dict()}

    def cells(self) -> list[str]:
        """Of the batch's table."""
        verdict = self.verdict
        if verdict is None:
            return [self.name, NOT_INSPECTED, "; ".join(self.refused), *"-----"]
        return [
            self.name,
            verdict.word,
            verdict.told,
            str(self.defects),
            str(len(verdict.counting)),
            percent(verdict.inspected),
            percent(verdict.finds),
            percent(verdict.glints),
        ]


def inspection_report(
    result: Inspection,
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
    result: Inspection,
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
        From :func:`lightopt.inspection.provenance`.
    truth
        From :func:`lightopt.inspection.summarise`; None where nothing is known of the part.
    """
    sections = [
        Section(heading="Where the defects are", blocks=[marked_part(result, part)]),
        Section(
            heading="Defects",
            blocks=[defect_table(result, verdict) if result.defects else Note(text="None was found.")],
        ),
        Section(heading="Images", blocks=_images(result)),
        Section(heading="What was inspected", blocks=[surface_table(result)]),
        Section(heading="Against the truth", blocks=[] if truth is None else truth_blocks(truth)),
        Section(heading="How it was inspected", blocks=[_facts(result, verdict, provenance)]),
    ]
    return Page(
        title=f"{verdict.word}: {part}",
        subtitle=f"{part} on {rig}, lightopt {provenance['lightopt']}",
        lead=[_answer(result, verdict), Warnings(texts=result.words)],
        sections=[section for section in sections if section.blocks],
    )


def batch_report(
    rows: Sequence[BatchRow],
    *,
    part: str,
    rig: str,
    version: str,
    truth: Mapping[str, Any] | None = None,
) -> str:
    """The report of several parts as HTML: a row each, whose own report is in its folder.

    Parameters
    ----------
    rows
        In the order of the sets.
    part, rig
        Their names.
    version
        Of lightopt.
    truth
        As :func:`inspection_page` takes it, over all sets.
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
            f"finds {100 * TOLD_CONTRAST:g} %",
            "only glints",
        ],
        rows=[row.cells() for row in rows],
        numbers_from=3,
        caption="A set's name leads to its own report. Inspected: share of the surface that the part's postures show. "
        f"Finds: share of it where {TOLD_DISC} is found half of the time. Only glints: share of it that was inspected, "
        "but is dark.",
        links=[row.report for row in rows],
    )
    told = f"; {counted(refused, 'set')} not inspected" if refused else ""
    sections = [
        Section(heading="Parts", blocks=[table]),
        Section(heading="Against the truth", blocks=[] if truth is None else truth_blocks(truth)),
    ]
    return page_html(
        Page(
            title=f"{counted(len(rows), 'part')}: {part}",
            subtitle=f"{part} on {rig}, lightopt {version}",
            lead=[Answer(figure=f"{good} of {len(rows)}", text=f"parts are OK{told}")],
            sections=[section for section in sections if section.blocks],
        )
    )


def _answer(result: Inspection, verdict: Verdict) -> Answer:
    found = counted(len(result.defects), "defect") if result.defects else "no defects"
    missing = result.surface.missing / max(result.surface.seen, 1e-9)
    rest = f" {percent(missing)} of the visible surface has no images." if missing > 0.0 else ""
    return Answer(
        figure=verdict.word,
        text=f"{verdict.told}. {found.capitalize()} on the {percent(verdict.inspected)} of the visible surface that "
        f"was inspected; {TOLD_DISC} is found on {percent(verdict.finds)}{dark_told(verdict)}.{rest}",
    )


def _images(result: Inspection) -> list[Block]:
    blocks: list[Block] = []
    for posture in result.postures:
        where = posture.view.posture
        times = _times(posture.view.part.shape[::-1], COLUMN_PX)
        picture, shown = overlay_image(posture, result.defects, enlarge=times)
        beneath = (
            "the image without highlights, black off the part and at its edges, which are not judged"
            if posture.synthetic is not None
            else "the least level over the lights, black off the part"
        )
        caption = (
            f"Posture {where}: red for a defect of shape, blue for a stain, orange for what could not be told; beneath "
            f"is {beneath}"
        )
        blocks.append(
            Picture(
                png=_small(picture, OVERLAY_PX),
                alt=f"Posture {where}: the part with its defects outlined and numbered",
                caption=f"{caption}; {shown.told}.",
            )
        )
    rows = [(f"posture {p.view.posture}", pictures) for p in result.postures if (pictures := _synthetic(p))]
    if rows:
        blocks.append(Gallery(header=["without highlights", "its uncertainty"], rows=rows))
    return blocks


def _synthetic(posture: InspectedPosture) -> list[Picture | None]:
    image = posture.synthetic
    if image is None:
        return []
    pictures: list[Picture | None] = []
    for what, level in (
        ("without highlights", image.level),
        ("uncertainty", image.deviation),
    ):
        shown = grey_picture(level, image.mask)
        pictures.append(
            Picture(
                png=_small(_whole(Image.fromarray(shown.grey).convert("RGB"), SMALL_PX), SMALL_PX),
                alt=f"Posture {posture.view.posture}: {what}",
                caption=shown.told,
            )
        )
    return pictures


def _times(size: tuple[int, ...], limit: int) -> int:
    return max(1, limit // max(size))


def _whole(image: Image.Image, limit: int) -> Image.Image:
    return enlarged(image, _times(image.size, limit))


def _small(image: Image.Image, limit: int) -> bytes:
    if max(image.size) <= limit:
        return png_bytes(image)
    return png_bytes(Image.fromarray(shrunk(np.asarray(image, np.uint8), limit=limit)))


def _facts(result: Inspection, verdict: Verdict, provenance: Mapping[str, Any]) -> Facts:
    options: Mapping[str, Any] = provenance["options"]
    seen_by: int = options["seen_by"]
    fewer = any(len(p.view.lights) < seen_by for p in result.postures)
    shows = f"a defect shows in {counted(seen_by, 'image')}"
    rows = [
        ("rig", f"{provenance['rig']['file']}, sha256 {provenance['rig']['sha256'][:16]}"),
        ("part", f"{provenance['part']['file']}, sha256 {provenance['part']['sha256'][:16]}"),
        ("detector", f"{options['detector']}, {shows}{', or in all where there are fewer' if fewer else ''}"),
        ("image without highlights", options["fusion"] or "none"),
        ("false alarms asked for", _rate(options["false_alarms"], calibrated="calibration" in provenance)),
        ("limits", _limits(verdict.limits)),
        ("calibration", provenance.get("calibration", {}).get("file", "none: by the noise of the sensor")),
    ]
    if result.placement is not None:
        x, y, turn = placement_told(result.placement)
        rows.append(("the part lies off its place by", f"{x} in x, {y} in y, turned by {turn}"))
    for posture in result.postures:
        view = posture.view
        gains = ", ".join(f"{name} ×{view.photometry.gains[name]:.4f}" for name in view.lights)
        told = f"threshold {posture.threshold:.2f}; brightness found: {gains}"
        rows.append((f"posture {view.posture}", f"{told}; dark {view.photometry.dark:+.2f} levels"))
    return Facts(rows=rows)


def _limits(limits: InspectionConfig) -> str:
    return (
        f"{counted(limits.most_defects, 'defect')} allowed; one counts from {limits.least_size_mm:g} mm and a contrast "
        f"of {percent(limits.least_contrast)} on; {percent(limits.least_inspected)} of the visible surface or more to "
        "be inspected"
    )


def _rate(rate: float, *, calibrated: bool) -> str:
    return f"in a posture, on a share of {rate:g} of good parts" if calibrated else f"{rate:g} per posture"
