"""What the report of an inspection shows of each posture: its defects outlined, and the image without highlights."""

from __future__ import annotations

import numpy as np
from PIL import Image

from lightopt.inspection import InspectedPosture, InspectionResult, grey_picture
from lightopt.report._canvas import png_bytes
from lightopt.report._inspection_pictures import enlarged, overlay_image
from lightopt.report._page import Block, Gallery, Picture
from lightopt.report._thumbnail import shrunk

OVERLAY_PX, SMALL_PX = 1600, 480
"""No side of a picture in the report is longer."""

COLUMN_PX = 896
"""A picture of smaller images is made larger by whole factors up to the width that the page gives it."""


def image_blocks(result: InspectionResult) -> list[Block]:
    """A picture of each posture, and of those that have one the image without highlights and its uncertainty."""
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
                caption=f"{caption}; {shown.legend}.",
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
                caption=shown.legend,
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
