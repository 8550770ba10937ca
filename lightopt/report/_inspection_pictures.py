"""Pictures of an inspection: the defects drawn over what the camera saw."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from lightopt.inspection import InspectedPosture, SyntheticImage
from lightopt.report._canvas import write_picture
from lightopt.report._typeface import Typeface

__all__ = ["COLOURS", "defect_overlay", "deviation_picture", "overlay_image", "synthetic_picture"]

BOX_MARGIN_PX = 4
LABEL_SIZE = 15
COLOURS = {"shape": (230, 60, 40), "stain": (60, 130, 230), "unknown": (240, 170, 30)}


def defect_overlay(path: Path, posture: InspectedPosture, numbers: Mapping[int, int]) -> Path:
    """Write the picture that :func:`overlay_image` makes as PNG, into a folder that exists."""
    return write_picture(path, overlay_image(posture, numbers))


def overlay_image(posture: InspectedPosture, numbers: Mapping[int, int]) -> Image.Image:
    """The posture's image without highlights, with the outlines and numbers of its defects.

    Red for shape, blue for stain, orange for what could not be told. Where no such image was made, the least level of
    each pixel.

    Parameters
    ----------
    posture
        Of an inspection.
    numbers
        Number of the defect by the index of its sighting.
    """
    if posture.synthetic is not None:
        level, mask = posture.synthetic.level, posture.synthetic.mask
    else:
        level, mask = np.minimum(posture.view.level, posture.view.limit).min(axis=0), posture.view.part
    rgb, _ = _grey(level, mask)
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
    return image


def synthetic_picture(image: SyntheticImage) -> tuple[Image.Image, float]:
    """The image without highlights, and the level that is shown white [grey level]."""
    rgb, white = _grey(image.level, image.mask)
    return Image.fromarray(rgb), white


def deviation_picture(image: SyntheticImage) -> tuple[Image.Image, float]:
    """How uncertain the image without highlights is, and the deviation that is shown white [grey level]."""
    rgb, white = _grey(image.deviation, image.mask)
    return Image.fromarray(rgb), white


def _grey(level: NDArray[np.float32], mask: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], float]:
    white = max(float(np.percentile(level[mask], 99.9)), 1e-6) if mask.any() else 1.0
    grey = (255.0 * np.clip(level / white, 0.0, 1.0) + 0.5).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=2), white


def _rim(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    padded = np.pad(mask, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return mask & ~inner
