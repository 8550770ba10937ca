"""A legend below a picture whose colours mean something."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from lightopt.core.errors import percent
from lightopt.design import LegendRow
from lightopt.report._typeface import Typeface

SMALLEST, LARGEST = 13, 26
"""Sizes of the text [px]; in between a fiftieth of the picture's width."""


def with_legend(picture: NDArray[np.uint8], title: str, rows: Sequence[LegendRow]) -> NDArray[np.uint8]:
    """A picture with a title and a legend below it, on white; it is made wider where they need more room.

    Parameters
    ----------
    picture
        Red, green and blue, shape (height, width, 3); its pixels stay where they are.
    title
        One line, of the whole legend.
    rows
        Colours, what they stand for, and how much that is.
    """
    height, width = picture.shape[:2]
    type_ = Typeface(min(LARGEST, max(SMALLEST, width // 50)))
    gap, line = type_.size, type_.line_height + type_.size // 3
    most = max(len(row.colours) for row in rows)
    # swatches, label, share: in columns
    label = gap + most * (type_.size + gap // 3) + gap // 2
    share = label + max(type_.width(row.label) for row in rows) + gap
    end = share + type_.width(percent(1.0))
    sheet = Image.new(
        "RGB",
        (max(width, end + gap, type_.width(title) + 2 * gap), height + gap + (len(rows) + 1) * line + gap),
        "#ffffff",
    )
    sheet.paste(Image.fromarray(picture), (0, 0))
    draw = ImageDraw.Draw(sheet)
    baseline = height + gap + type_.cap_height
    type_.paint(sheet, gap, baseline, title, fill="#1c1f24")
    for row in rows:
        baseline += line
        top = baseline - type_.cap_height - type_.size // 6
        for k, colour in enumerate(row.colours):
            left = gap + k * (type_.size + gap // 3)
            box = (left, top, left + type_.size, top + type_.size)
            draw.rectangle(box, fill=colour, outline="#5c636e")
        type_.paint(sheet, label, baseline, row.label, fill="#1c1f24")
        type_.paint(sheet, end, baseline, row.amount, fill="#1c1f24", align="right")
    return np.asarray(sheet)
