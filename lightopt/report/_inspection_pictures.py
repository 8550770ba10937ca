"""Pictures of an inspection: the defects drawn over what the camera saw."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from lightopt.inspection import InspectedPosture
from lightopt.report._canvas import write_picture
from lightopt.report._typeface import Typeface

__all__ = ["defect_overlay"]

BOX_MARGIN_PX = 4
LABEL_SIZE = 15
COLOURS = {"shape": (230, 60, 40), "stain": (60, 130, 230), "unknown": (240, 170, 30)}


def defect_overlay(path: Path, posture: InspectedPosture, numbers: Mapping[int, int]) -> Path:
    """Write a PNG of the posture's darkest image without highlights, with the outlines and numbers of its defects.

    Red for shape, blue for stain, orange for what could not be told.

    Parameters
    ----------
    path
        In a folder that exists.
    posture
        Of an inspection.
    numbers
        Number of the defect by the index of its sighting.
    """
    if posture.synthetic is not None:
        level, mask = posture.synthetic.level, posture.synthetic.mask
    else:
        level, mask = np.minimum(posture.view.level, posture.view.limit).min(axis=0), posture.view.part
    white = float(np.percentile(level[mask], 99.9)) if mask.any() else 1.0
    grey = np.clip(level / max(white, 1e-6), 0.0, 1.0)
    rgb = np.repeat((255.0 * grey + 0.5).astype(np.uint8)[..., None], 3, axis=2)
    for index, sighting in enumerate(posture.sightings):
        rgb[_rim(posture.labels == index + 1)] = COLOURS[sighting.kind]
    image = Image.fromarray(rgb)
    draw, face = ImageDraw.Draw(image), Typeface(LABEL_SIZE)
    for index, sighting in enumerate(posture.sightings):
        left, top, right, bottom = sighting.box_px
        colour = COLOURS[sighting.kind]
        m = BOX_MARGIN_PX
        draw.rectangle([left - m, top - m, right + m - 1, bottom + m - 1], outline=colour)
        face.paint(
            image,
            right + m + 3.0,
            max(top - m + 11.0, 12.0),
            str(numbers[index]),
            fill="#{:02x}{:02x}{:02x}".format(*colour),
            align="left",
        )
    return write_picture(path, image)


def _rim(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    padded = np.pad(mask, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask & ~inner
