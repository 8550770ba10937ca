"""The project's conventions as a drawing, made with the functions that everything else uses."""

from __future__ import annotations

from pathlib import Path

from PIL import Image, ImageDraw

from lightopt.report._canvas import Canvas, check_png_path, write_picture
from lightopt.report._frames_panels import FramePanel, frame_panels
from lightopt.report._labels import Box, Label, ink_of, paint_labels, place_labels
from lightopt.report._rig_elements import INK, SOFT
from lightopt.report._typeface import Typeface

COLUMNS = 3
PANEL = (590, 560)
MARGIN, HEAD, FOOT = 26, 56, 92
"""Around a panel's picture: its border, its title above and its text below [px]."""


def frames_drawing(path: str | Path) -> Path:
    """Draw the conventions: directions, elevation beyond the zenith, panels, camera with roll, pixels, postures.

    Every arrow comes from :mod:`lightopt.core.transforms` and :mod:`lightopt.scene`: the drawing shows what the program
    does.

    Parameters
    ----------
    path
        The PNG to make or to replace, in a folder that exists.

    Returns
    -------
    pathlib.Path
        The file written.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    path = check_png_path(path)
    panels = frame_panels()
    rows = -(-len(panels) // COLUMNS)
    canvas = Canvas(COLUMNS * PANEL[0], rows * PANEL[1])
    boxes = [_box(index) for index in range(len(panels))]
    labels = [panel.draw(canvas, box) for panel, box in zip(panels, boxes, strict=True)]
    image = canvas.finished()
    ink = ink_of(image)
    typeface = Typeface(20)
    _paint_rules(image, rows)
    for panel, box, own in zip(panels, boxes, labels, strict=True):
        _paint_text(image, panel, box)
        outer: Box = (box[0] - 14, box[1] - 8, box[2] + 14, box[3] + 8)
        paint_labels(image, place_labels(_ordered(own), typeface, ink=ink, bounds=outer), typeface)
    return write_picture(path, image)


def _ordered(labels: list[Label]) -> list[Label]:
    """Those that care for a side first: the others give way."""
    return sorted(labels, key=lambda label: label.away is None)


def _box(index: int) -> Box:
    left, top = (index % COLUMNS) * PANEL[0], (index // COLUMNS) * PANEL[1]
    return left + MARGIN, top + HEAD, left + PANEL[0] - MARGIN, top + PANEL[1] - FOOT


def _paint_rules(image: Image.Image, rows: int) -> None:
    draw = ImageDraw.Draw(image)
    for column in range(1, COLUMNS):
        x = column * PANEL[0]
        draw.line([(x, MARGIN), (x, image.height - MARGIN)], fill="#dfe3e8", width=1)
    for row in range(1, rows):
        y = row * PANEL[1]
        draw.line([(MARGIN, y), (image.width - MARGIN, y)], fill="#dfe3e8", width=1)


def _paint_text(image: Image.Image, panel: FramePanel, box: Box) -> None:
    title, text = Typeface(22), Typeface(17)
    title.paint(image, box[0], box[1] - HEAD + MARGIN + title.cap_height, panel.title, fill=INK)
    y = box[3] + 14 + text.cap_height
    for line in panel.text:
        text.paint(image, box[0], y, line, fill=SOFT)
        y += text.line_height
