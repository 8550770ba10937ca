"""Pictures of an inspection: the defects drawn over what the camera saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from lightopt.inspection import KIND_COLOURS, FoundDefect, GreyPicture, InspectedPosture, Kind, grey_picture
from lightopt.report._canvas import write_picture
from lightopt.report._typeface import Typeface

BOX_MARGIN_PX = 3
LABEL_SIZE, LABEL_GAP_PX = 15, 3
LABEL_SHARE, LINE_SHARE = 1 / 43, 1 / 800
"""Numbers are at least this share of the picture's width, lines of boxes about this: a wide picture is looked at from
afar."""

LABEL_COLOURS: Final[Mapping[Kind, tuple[int, int, int]]] = {
    "shape": (255, 120, 100),
    "stain": (130, 185, 255),
    "unknown": (255, 195, 70),
}
"""Lighter, to be read on black."""


def defect_overlay(path: Path, posture: InspectedPosture, defects: Sequence[FoundDefect]) -> Path:
    """Write the picture that :func:`overlay_image` makes as PNG, as large as the images, into a folder that exists."""
    return write_picture(path, overlay_image(posture, defects)[0])


def overlay_image(
    posture: InspectedPosture, defects: Sequence[FoundDefect], *, enlarge: int = 1
) -> tuple[Image.Image, GreyPicture]:
    """The posture's image without highlights, with the outlines and numbers of its defects.

    Red for shape, blue for stain, orange for what could not be told of the defect, whichever posture told it. Where no
    such image was made, the least level of each pixel.

    Parameters
    ----------
    posture
        Of an inspection.
    defects
        Of the inspection.
    enlarge
        Pixels are made squares of so many; lines and numbers are as the picture's width asks for.

    Returns
    -------
    :
        The picture, and what is beneath its marks.
    """
    if posture.synthetic is not None:
        level, mask = posture.synthetic.level, posture.synthetic.mask
    else:
        level, mask = np.minimum(posture.view.level, posture.view.limit).min(axis=0), posture.view.part
    shown = grey_picture(level, mask)
    rgb = np.repeat(shown.grey[..., None], 3, axis=2)
    found = {id(detection): defect for defect in defects for detection in defect.detections}
    for index, detection in enumerate(posture.detections):
        rgb[_rim(posture.labels == index + 1)] = KIND_COLOURS[found[id(detection)].best.kind]
    image = enlarged(Image.fromarray(rgb), enlarge)
    line = max(1, round(LINE_SHARE * image.width))
    draw, face = ImageDraw.Draw(image), Typeface(max(LABEL_SIZE, round(LABEL_SHARE * image.width)))
    for detection in posture.detections:
        defect = found[id(detection)]
        colour = KIND_COLOURS[defect.best.kind]
        left, top, right, bottom = (enlarge * side for side in detection.box_px)
        m = BOX_MARGIN_PX * enlarge
        draw.rectangle([left - m, top - m, right + m - 1, bottom + m - 1], outline=colour, width=line)
        x, baseline = _label_place(
            image, face, str(defect.number), (left - m, top - m, right + m, bottom + m)
        )
        fill = "#{:02x}{:02x}{:02x}".format(*LABEL_COLOURS[defect.best.kind])
        face.paint(image, x, baseline, str(defect.number), fill=fill, halo="#000000")
    return image, shown


def enlarged(image: Image.Image, times: int) -> Image.Image:
    """A picture whose pixels are squares of so many."""
    return image.resize((times * image.width, times * image.height), Image.Resampling.NEAREST)


def _label_place(
    image: Image.Image, face: Typeface, text: str, box: tuple[int, int, int, int]
) -> tuple[float, float]:
    # left end and baseline: beside the box, on its other side where there is no room, and never beyond the picture
    left, top, right, _ = box
    width = face.width(text) + LABEL_GAP_PX
    x = right + LABEL_GAP_PX if right + LABEL_GAP_PX + width <= image.width else left - width
    x = min(max(x, LABEL_GAP_PX), image.width - width)
    baseline = min(max(top + face.cap_height, face.cap_height + LABEL_GAP_PX), image.height - LABEL_GAP_PX)
    return float(x), float(baseline)


def _rim(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    padded = np.pad(mask, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask & ~inner
