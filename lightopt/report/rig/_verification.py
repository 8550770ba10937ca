"""The report of ``lightopt verify``: the answer, the causes, each light, pictures of what differs; runs over time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lightopt.core.arrays import Float32
from lightopt.estimate.verification import Finding, LightComparison, Verification
from lightopt.images.comparison import diverging
from lightopt.report._drawing import COLOURS, MARK, chart, figure_image, fixed_style, label_whole_numbers, name_lines
from lightopt.report._images import png_bytes, shrunk, write_picture
from lightopt.report._page import Answer, Facts, Gallery, Note, Page, Picture, Section, Table, Warnings, page_html

FULL_COLOUR = 10.0  # standard deviations
MOST_PX = 300  # no side of a picture is longer


def findings_table(result: Verification) -> Table:
    """Causes with their sizes and limits, those that exceed them first."""

    def cells(one: Finding) -> list[str]:
        return [one.cause, one.amount, one.limit_text, "beyond" if one.exceeds else "within"]

    return Table(header=["cause", "size", "limit", ""], rows=[cells(one) for one in result.findings], numbers_from=4)


def lights_table(result: Verification) -> Table:
    """Predicted against captured, a row for each light."""

    def cells(one: LightComparison) -> list[str]:
        overlap = "-" if one.overlap is None else f"{one.overlap:.3f}"
        rest = (one.offset_px, one.offset_deg, one.residual, one.explained)
        return [one.light, overlap, *("-" if value is None else f"{value:.2f}" for value in rest)]

    return Table(
        header=["light", "overlap (IoU)", "offset [px]", "offset [°]", "residual/noise", "explained"],
        rows=[cells(one) for one in result.lights],
        caption="Overlap of saturated areas; offset of the highlights, in the image and as a direction of light; "
        "residual over noise, and the same with the causes in the prediction.",
    )


def verification_report(result: Verification, *, part: str, rig: str, provenance: Mapping[str, Any]) -> str:
    """The report as HTML; `part` and `rig` are names, `provenance` is that of the result folder."""
    remedies = [f"To tell {f.cause}: {f.remedy}." for f in result.findings if f.remedy]
    unseen = "Not observable in these images: " + (", ".join(result.unseen) or "nothing") + "."
    inputs: Mapping[str, Any] = provenance["inputs"]
    facts = [(name, f"{inputs[name]['file']}, sha256 {inputs[name]['sha256'][:16]}") for name in ("rig", "part")]
    facts.append(("compared with", "a known good set" if "baseline" in inputs else "the model"))
    facts += [(f"limit {name}", f"{value:g}") for name, value in vars(result.limits).items()]
    word = "Within tolerances" if result.within_tolerances else "Out of tolerances"
    causes = findings_table(result) if result.findings else Note(text="Nothing differs.")
    sections = [
        Section(heading="Causes", blocks=[causes, *(Note(text=text) for text in (*remedies, unseen))]),
        Section(heading="Lights", blocks=[lights_table(result)]),
        Section(heading="What differs", blocks=[_gallery(result, 0, "as the rig file has it")]),
        Section(heading="What the causes leave", blocks=[_gallery(result, 1, "with the causes")]),
        Section(heading="Inputs and limits", blocks=[Facts(rows=facts)]),
    ]
    lead = [Answer(figure=word, text=result.answer), Warnings(texts=result.warnings)]
    subtitle = f"{part} on {rig}, lightopt {provenance['lightopt']}"
    return page_html(Page(title=f"{word}: {rig}", subtitle=subtitle, lead=lead, sections=sections))


def _gallery(result: Verification, number: int, what: str) -> Gallery:
    lights = list(dict.fromkeys(light for _, light, _ in result.differences))
    rows = dict.fromkeys((posture, exposure) for posture, _, exposure in result.differences)
    several = len({exposure for _, exposure in rows}) > 1
    table: list[tuple[str, list[Picture | None]]] = []
    for posture, exposure in rows:
        found = [result.differences.get((posture, light, exposure)) for light in lights]
        pictures = [_picture(one, number, light) for one, light in zip(found, lights, strict=True)]
        table.append((f"posture {posture}{f' ×{exposure:g}' if several else ''}", pictures))
    return Gallery(
        header=lights,
        rows=table,
        caption=f"Captured minus predicted {what}: blue darker, red brighter, full colour at {FULL_COLOUR:g} standard "
        "deviations of noise and model; white where equal, saturated or off the part.",
    )


def _picture(difference: Float32 | None, number: int, light: str) -> Picture | None:
    if difference is None:
        return None
    pixels = shrunk(diverging(np.clip(difference[number] / FULL_COLOUR, -1.0, 1.0)), limit=MOST_PX)
    return Picture(png=png_bytes(Image.fromarray(pixels)), alt=f"captured minus predicted, {light}")


@fixed_style()
def history_chart(rows: Sequence[Mapping[str, str]], path: Path) -> Path:
    """Draw the rows of ``append_history``: faults as shares of their limits, offset and residual of each light."""
    labels = ("size of each fault over its limit", "offset of the highlights [px]", "residual over noise")
    figure, panels = chart(title="Verifications of the rig", x_label="run", labels=labels)
    kinds = (("/limit", 0.0), (" offset_px", math.nan), (" residual", math.nan))
    for panel, (suffix, missing) in zip(panels, kinds, strict=True):
        names = list(dict.fromkeys(name for row in rows for name in row if name.endswith(suffix)))
        for number, name in enumerate(names):
            values = [float(row.get(name) or missing) for row in rows]
            label, color = name.removesuffix(suffix), COLOURS[number % len(COLOURS)]
            panel.plot(range(1, len(rows) + 1), values, ".-", color=color, label=label)
        if names:
            name_lines(panel)
    panels[0].axhline(1.0, color=MARK, linestyle="--")
    label_whole_numbers(panels[-1].xaxis)
    return write_picture(path, figure_image(figure))
