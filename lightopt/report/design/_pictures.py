"""Pictures of a design: the images of the best set, the rig, and the score against the angles."""

import itertools
from pathlib import Path

from PIL import Image

from lightopt.design import Curve, DesignOutput, DetectabilityObjective, SetResult
from lightopt.images import ImageEntry, ImageSet, read_image_set, read_png
from lightopt.report._charts import COLOURS, chart, name_lines
from lightopt.report._contact_sheet import entry_thumbnail, light_position, saturation_text
from lightopt.report._drawing import figure_image, fixed_style, printable
from lightopt.report._images import png_bytes, shrunk
from lightopt.report._page import Block, Gallery, Note, Picture
from lightopt.report.design._plan import postures_text

SIDE = 300  # longest side of an image in the report [px]


def image_blocks(output: DesignOutput) -> list[Block]:
    """The images that the camera would deliver, a row for each posture, and where their highlights overlap."""
    sets = [read_image_set(output.result.folder / one["folder"], verify=False) for one in output.document["images"]]
    if not sets:
        return [Note(text="Not rendered: images were switched off.")]
    maps = {
        (overlap.posture, overlap.exposure): (output.result.folder / listed["map"], overlap.pixels)
        for listed, overlap in zip(output.document["overlaps"], output.overlaps, strict=True)
    }
    rows: list[tuple[str, list[Picture | None]]] = []
    for images in sets:
        shots = dict.fromkeys((entry.posture, entry.exposure) for entry in images.images)
        levels = {entry.exposure for entry in images.images}
        for posture, exposure in shots:
            own = [one for one in images.images if (one.posture, one.exposure) == (posture, exposure)]
            pictures = [_picture(images, one) for one in own]
            # one light has no others for its highlights to overlap with
            together = [_overlap(*maps[posture, exposure])] if maps else []
            at = f", exposure {exposure:.9g}" * (levels != {1.0})
            rows.append((f"posture {posture}{at}", [*pictures, *together]))
    which = "the planned exposures" if output.document.get("exposures") else "exposure 1"
    right = " On the right: blue where one image is saturated, red where several are." * bool(maps)
    header = [*output.result.candidates.names, *(["highlights together"] if maps else [])]
    caption = (
        f"What the camera would deliver at {which}; red: saturated pixels.{right} Images are averaged down, counts are "
        "of the full ones."
    )
    return [Gallery(header=header, rows=rows, caption=caption)]


def _picture(images: ImageSet, entry: ImageEntry) -> Picture:
    small = entry_thumbnail(images, entry, SIDE)
    return Picture(
        png=png_bytes(Image.fromarray(small.picture)),
        alt=f"{entry.light} at {light_position(entry)}",
        caption=f"{light_position(entry)}; {saturation_text(small)}",
    )


def _overlap(path: Path, pixels: int) -> Picture:
    return Picture(
        png=png_bytes(Image.fromarray(shrunk(read_png(path, colour=True), limit=SIDE))),
        alt="Map of the highlights",
        caption=f"{pixels:,} px saturated in two or more",
    )


def curve_blocks(output: DesignOutput) -> list[Block]:
    """The score against the angles, one chart for each set and kind of angle."""
    blocks: list[Block] = []
    for result in output.result.results:
        for axis in ("elevation", "azimuth"):
            curves = [curve for curve in result.curves if curve.axis == axis]
            if curves:
                blocks.append(_chart(result, axis, curves))
    if blocks:
        text = (
            "The score as one light moves and all else stays as in the best set; or, where it says so, with all lights "
            "that move at the same elevation. Where a curve stays near the best score the choice is free."
        )
        blocks.insert(0, Note(text=text))
    return blocks


@fixed_style()
def _chart(result: SetResult, axis: str, curves: list[Curve]) -> Picture:
    best = result.answers[0]
    where = postures_text(result.postures)
    area = best.objective.share_of is not None
    surface = f"inspectable surface{' × defects' * isinstance(best.objective, DetectabilityObjective)}"
    label = f"% of the {surface}" if area else best.objective.unit
    figure, (panel,) = chart(
        title=f"{best.objective.name}, {where}", x_label=f"{axis} [°]", labels=[f"score [{label}]"]
    )
    for curve, colour in zip(curves, itertools.cycle(COLOURS)):
        scores = [_value(result, score) for score in curve.scores]
        panel.plot(curve.angles_deg, scores, ".-", color=colour, label=printable(curve.name))
    name_lines(panel)
    names = ", ".join(curve.name for curve in curves)
    return Picture(png=png_bytes(figure_image(figure)), alt=f"Score against {axis} for {where}: {names}")


def _value(result: SetResult, score: int) -> float:
    share = result.answers[0].objective.share_of_whole(score, result.area)
    return float(score) if share is None else 100.0 * share
