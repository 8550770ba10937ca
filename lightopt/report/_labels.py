"""Labels beside the things they name: none on another, and as little as possible on lines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from lightopt.report._typeface import Typeface

Box = tuple[float, float, float, float]
"""Left, top, right, bottom [px]."""

_DIRECTIONS = 24
_RADII = (6, 12, 20, 30, 44, 62, 85, 115, 155, 210, 280, 370, 480, 620, 800)
"""Distances from a label to its anchor that are tried [px]."""

_SPACE = 4
"""Least distance of two labels [px]."""

_LEADER = 34
"""From this distance on a thin line leads from the anchor to the label [px]."""

_INK_COST = 450.0
_TURN_COST = 16.0
"""What a label wholly on lines, or on the side opposite to the preferred one, costs in px of distance."""


@dataclass(frozen=True, kw_only=True)
class Label:
    """What to write, and where it belongs.

    Attributes
    ----------
    text
        One line.
    anchor
        The place named [px].
    colour
        Of the text.
    away
        Preferred direction from the anchor to the label, any length; None for any.
    """

    text: str
    anchor: tuple[float, float]
    colour: str
    away: tuple[float, float] | None = None


@dataclass(frozen=True)
class PlacedLabel:
    """A label and the box that it fills."""

    label: Label
    box: Box


def ink_of(image: Image.Image) -> NDArray[np.float64]:
    """How much is drawn at each pixel of an RGB picture, 0 (white) to 1, shape (rows, columns)."""
    darkness = 255 - np.asarray(image).min(axis=2)
    # pale areas are as good as paper
    return np.clip((darkness.astype(np.float64) - 24.0) / 100.0, 0.0, 1.0)


def place_labels(
    labels: Sequence[Label],
    typeface: Typeface,
    *,
    ink: NDArray[np.float64],
    bounds: Box,
    keep_out: Sequence[Box] = (),
) -> tuple[PlacedLabel, ...]:
    """Find room for labels, one after the other; one for which there is none at all is left out.

    Parameters
    ----------
    labels
        The important ones first.
    typeface
        That they will be written in.
    ink
        From :func:`ink_of`, of the whole picture.
    bounds
        Where labels may stand [px].
    keep_out
        Boxes that no label may touch [px].
    """
    sums = np.zeros((ink.shape[0] + 1, ink.shape[1] + 1))
    sums[1:, 1:] = ink.cumsum(axis=0).cumsum(axis=1)
    taken = list(keep_out)
    placed: list[PlacedLabel] = []
    for label in labels:
        size = (typeface.width(label.text), typeface.cap_height + 2 * typeface.descent)
        best: tuple[float, Box] | None = None
        for box, distance, turn in _candidates(label, size):
            if best is not None and distance > best[0]:
                break  # all further ones cost more
            if not _inside(box, bounds) or any(_touch(box, other) for other in taken):
                continue
            cost = distance + _TURN_COST * turn + _INK_COST * _mean(sums, box)
            if best is None or cost < best[0]:
                best = cost, box
        if best is not None:
            placed.append(PlacedLabel(label, best[1]))
            taken.append(best[1])
    return tuple(placed)


def paint_labels(image: Image.Image, placed: Sequence[PlacedLabel], typeface: Typeface) -> None:
    """Write placed labels, with leaders to anchors that are far."""
    draw = ImageDraw.Draw(image)
    for item in placed:
        x, y = item.label.anchor
        left, top, right, bottom = item.box
        nearest = (min(max(x, left), right), min(max(y, top), bottom))
        if math.dist((x, y), nearest) > _LEADER:
            draw.line([(x, y), nearest], fill="#8a919b", width=1)
    for item in placed:
        left, _, _, bottom = item.box
        typeface.paint(
            image, left, bottom - typeface.descent, item.label.text, fill=item.label.colour, halo="#ffffff"
        )


def _candidates(label: Label, size: tuple[int, int]) -> Iterator[tuple[Box, float, float]]:
    """Boxes around the anchor, near ones first, with their distance and how far they turn from the preferred side."""
    x, y = label.anchor
    width, height = size
    for radius in _RADII:
        for i in range(_DIRECTIONS):
            angle = 2.0 * math.pi * i / _DIRECTIONS
            ux, uy = math.cos(angle), math.sin(angle)
            # whole pixels, so that the box found is the box written
            left = round(x + ux * radius + (ux - 1.0) * 0.5 * width)
            top = round(y + uy * radius + (uy - 1.0) * 0.5 * height)
            turn = 0.0
            if label.away is not None and (length := math.hypot(*label.away)) > 0.0:
                turn = 0.5 - 0.5 * (ux * label.away[0] + uy * label.away[1]) / length
            yield (left, top, left + width, top + height), float(radius), turn


def _inside(box: Box, bounds: Box) -> bool:
    return box[0] >= bounds[0] and box[1] >= bounds[1] and box[2] <= bounds[2] and box[3] <= bounds[3]


def _touch(a: Box, b: Box) -> bool:
    return a[0] < b[2] + _SPACE and b[0] < a[2] + _SPACE and a[1] < b[3] + _SPACE and b[1] < a[3] + _SPACE


def _mean(sums: NDArray[np.float64], box: Box) -> float:
    """Mean ink in a box of whole pixels, from the ink's integral image."""
    left, top, right, bottom = (int(side) for side in box)
    left, top = max(left, 0), max(top, 0)
    right, bottom = min(right, sums.shape[1] - 1), min(bottom, sums.shape[0] - 1)
    if right <= left or bottom <= top:
        return 1.0
    total = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return float(total) / ((right - left) * (bottom - top))
