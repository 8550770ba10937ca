"""The report of ``lightopt inspect``: the verdict first, then the pictures, the defects, and what was not inspected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from lightopt.errors import counted
from lightopt.inspection import InspectedPosture, Inspection, Verdict
from lightopt.report._canvas import png_bytes
from lightopt.report._inspection_pictures import deviation_picture, overlay_image, synthetic_picture
from lightopt.report._inspection_surface import marked_part
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

OVERLAY_PX, SMALL_PX = 1600, 480
"""No side of a picture in the report is longer."""


@dataclass(frozen=True, kw_only=True)
class BatchRow:
    """One part of a batch.

    Attributes
    ----------
    name
        Of its folder.
    defects
        That were found, whether they count or not.
    verdict
        On it.
    """

    name: str
    defects: int
    verdict: Verdict


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
        Section(heading="Defects", blocks=_defects(result, verdict)),
        Section(heading="Images", blocks=_images(result)),
        Section(heading="What was inspected", blocks=_surface(result)),
        Section(heading="Against the truth", blocks=[] if truth is None else truth_blocks(truth)),
        Section(heading="How it was inspected", blocks=[_facts(result, provenance)]),
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
    good = sum(row.verdict.good for row in rows)
    table = Table(
        header=["set", "verdict", "defects", "that count", "inspected", "reasons"],
        rows=[
            [
                row.name,
                row.verdict.word,
                str(row.defects),
                str(len(row.verdict.counting)),
                f"{100.0 * row.verdict.inspected:.1f} %",
                "; ".join(row.verdict.reasons),
            ]
            for row in rows
        ],
        numbers_from=2,
        caption="Each set's own report is report.html in the folder of its name.",
    )
    sections = [
        Section(heading="Parts", blocks=[table]),
        Section(heading="Against the truth", blocks=[] if truth is None else truth_blocks(truth)),
    ]
    return page_html(
        Page(
            title=f"{counted(len(rows), 'part')}: {part}",
            subtitle=f"{part} on {rig}, lightopt {version}",
            lead=[Answer(figure=f"{good} of {len(rows)}", text="parts are OK")],
            sections=[section for section in sections if section.blocks],
        )
    )


def _answer(result: Inspection, verdict: Verdict) -> Answer:
    found = counted(len(result.defects), "defect") if result.defects else "no defects"
    told = "; ".join(verdict.reasons) or "nothing found that counts"
    return Answer(
        figure=verdict.word,
        text=f"{told}. {found.capitalize()} on the {100.0 * verdict.inspected:.1f} % of the visible surface that was "
        "inspected.",
    )


def _defects(result: Inspection, verdict: Verdict) -> list[Block]:
    if not result.defects:
        return [Note(text="None was found.")]
    rows = [
        [
            str(defect.number),
            defect.best.kind,
            " ".join(sorted({light for s in defect.sightings for light in s.contrast})) or "-",
            "yes" if defect.number in verdict.counting else "no",
            ", ".join(f"{x:.2f}" for x in defect.best.position),
            f"{defect.size[0]:.2f} × {defect.size[1]:.2f}",
            f"{defect.area:.3g}",
            f"{100.0 * defect.greatest_contrast:.0f} %",
            f"{defect.best.score:.1f}",
            str(len(defect.sightings)),
        ]
        for defect in result.defects
    ]
    header = ["", "kind", "lights", "counts", "place [mm]", "size [mm]", "area [mm²]", "contrast", "score"]
    return [
        Table(
            header=[*header, "postures"],
            rows=rows,
            numbers_from=4,
            caption="Places are in the coordinates of the mesh file. The score is −log₁₀ of the probability that noise "
            "alone looks as much like a defect; lights are those that show it by themselves.",
        )
    ]


def _images(result: Inspection) -> list[Block]:
    blocks: list[Block] = []
    numbers = {id(s): defect.number for defect in result.defects for s in defect.sightings}
    for posture in result.postures:
        where = posture.view.posture
        own = {i: numbers[id(sighting)] for i, sighting in enumerate(posture.sightings)}
        blocks.append(
            Picture(
                png=_small(overlay_image(posture, own), OVERLAY_PX),
                alt=f"Posture {where}: the part with its defects outlined and numbered",
                caption=f"Posture {where}: red for shape, blue for stain, orange for what could not be told.",
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
    for what, (picture, white) in (
        ("without highlights", synthetic_picture(image)),
        ("uncertainty", deviation_picture(image)),
    ):
        pictures.append(
            Picture(
                png=_small(picture, SMALL_PX),
                alt=f"Posture {posture.view.posture}: {what}",
                caption=f"white: {white:.3g} grey levels",
            )
        )
    return pictures


def _small(image: Image.Image, limit: int) -> bytes:
    if max(image.size) <= limit:
        return png_bytes(image)
    return png_bytes(Image.fromarray(shrunk(np.asarray(image, np.uint8), limit=limit)))


def _surface(result: Inspection) -> list[Block]:
    def share(part: float, whole: float) -> str:
        return f"{100.0 * part / max(whole, 1e-9):.1f} %"

    covers = [(str(p.view.posture), p.coverage) for p in result.postures]
    contrasts = list(covers[0][1].sensitivity) if covers else []
    rows = [
        [
            name,
            f"{c.seen:.0f}",
            *(share(area, c.seen) for area in (c.inspected, c.edge, c.saturated, c.shadow)),
            *(share(c.sensitivity[contrast], c.seen) for contrast in contrasts),
        ]
        for name, c in covers
    ]
    finds = [f"finds {100.0 * contrast:g} %" for contrast in contrasts]
    return [
        Table(
            header=["posture", "seen [mm²]", "inspected", "edges", "saturated", "dark", *finds],
            rows=rows,
            caption="Shares of the surface that the camera sees in the posture: what was inspected, and why the rest "
            "was not. Finds: where an even disc of 5 px that changes the light by so much is found half of the time.",
        )
    ]


def _facts(result: Inspection, provenance: Mapping[str, Any]) -> Facts:
    options: Mapping[str, Any] = provenance["options"]
    rows = [
        ("rig", f"{provenance['rig']['file']}, sha256 {provenance['rig']['sha256'][:16]}"),
        ("part", f"{provenance['part']['file']}, sha256 {provenance['part']['sha256'][:16]}"),
        ("detector", f"{options['detector']}, a defect shows in {options['seen_by']} images"),
        ("image without highlights", options["fusion"] or "none"),
        ("false alarms asked for", f"{options['false_alarms']:g} per posture"),
        ("calibration", provenance.get("calibration", {}).get("file", "none: by the noise of the sensor")),
    ]
    if result.placement is not None:
        p = result.placement.as_dict()
        place = f"{p['x_mm']:+.3f} mm in x, {p['y_mm']:+.3f} mm in y, turned by {p['turn_deg']:+.3f}°"
        rows.append(("the part lies off its place by", place))
    for posture in result.postures:
        view = posture.view
        gains = ", ".join(f"{name} ×{view.photometry.gains[name]:.4f}" for name in view.lights)
        told = f"threshold {posture.threshold:.2f}; brightness found: {gains}"
        rows.append((f"posture {view.posture}", f"{told}; dark {view.photometry.dark:+.2f} levels"))
    return Facts(rows=rows)
