"""A canvas of smooth lines and areas: drawn at three times the resolution, then averaged."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from lightopt.core.errors import InputError
from lightopt.images import write_bytes_atomic

FINE = 3
"""Resolution of what is drawn, relative to the finished picture."""

Points = NDArray[np.float64]
"""Places on the picture, x to the right and y down [px of the finished picture], shape (n, 2)."""


class Canvas:
    """A white picture to draw on.

    Parameters
    ----------
    width, height
        Of the finished picture [px].
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._image = Image.new("RGB", (width * FINE, height * FINE), "#ffffff")
        self._draw = ImageDraw.Draw(self._image, "RGBA")  # RGBA: blends translucent colours

    def line(
        self, points: Points, *, colour: str, width: float = 1.5, dash: tuple[float, float] | None = None
    ) -> None:
        """Draw a polyline; `width` and the lengths of dash and gap in [px]."""
        for piece in [np.asarray(points, dtype=np.float64)] if dash is None else _dashes(points, dash):
            if len(piece) > 1:
                self._draw.line(
                    _fine(piece),
                    fill=ImageColor.getrgb(colour),
                    width=max(1, round(width * FINE)),
                    joint="curve",
                )

    def polygon(
        self, points: Points, *, fill: str | None = None, outline: str | None = None, width: float = 1.5
    ) -> None:
        """Draw an area; a fill of the form ``#rrggbbaa`` is translucent."""
        if fill is not None:
            self._draw.polygon(_fine(points), fill=ImageColor.getrgb(fill))
        if outline is not None:
            self.line(np.concatenate([points, points[:2]]), colour=outline, width=width)

    def disc(self, centre: Points, radius: float, *, fill: str, outline: str | None = None) -> None:
        """Draw a disc around a place of shape (2,); radius in [px]."""
        turns = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        ring = centre + radius * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        self.polygon(ring, fill=fill, outline=outline)

    def arrow(self, points: Points, *, colour: str, width: float = 2.0, head: float = 13.0) -> None:
        """Draw a polyline that ends in an arrow head of the given length [px]; a short line gets a smaller one."""
        points = np.asarray(points, dtype=np.float64)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        length = float(steps.sum())
        if length < 1.0:
            return
        head = min(head, 0.6 * length)
        tip = points[-1]
        travelled = np.concatenate([[0.0], np.cumsum(steps)])
        base = _at(points, travelled, length - head)
        along = (tip - base) / max(float(np.linalg.norm(tip - base)), 1e-9)
        across = np.array([-along[1], along[0]]) * 0.36 * head
        shaft = np.concatenate([points[travelled < length - head], (base + 0.2 * head * along)[None]])
        self.line(shaft, colour=colour, width=width)
        self.polygon(np.stack([tip, base + across, base + 0.2 * head * along, base - across]), fill=colour)

    def paste(self, picture: NDArray[np.uint8], left: int, top: int) -> None:
        """Lay a picture over the canvas.

        Parameters
        ----------
        picture
            RGBA, shape (rows, columns, 4), at :data:`FINE` times the resolution.
        left, top
            Its corner, in pixels of that resolution.
        """
        layer = Image.fromarray(picture)
        self._image.paste(layer, (left, top), layer)

    def finished(self) -> Image.Image:
        """The picture so far at its final resolution, RGB; text goes onto this."""
        return self._image.reduce(FINE)


def check_png_path(path: str | Path) -> Path:
    """The path of a picture to write.

    Raises
    ------
    InputError
        When it does not end in ``.png``.
    """
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are written as PNG; expected a name that ends in .png")
    return path


def write_picture(path: Path, image: Image.Image, *, overwrite: bool = True) -> Path:
    """Write an RGB picture as PNG, whole or not at all; the same picture gives the same bytes.

    Raises
    ------
    InputError
        When the file cannot be written, or one of other content is there and `overwrite` is False.
    """
    write_bytes_atomic(path, png_bytes(image), overwrite=overwrite)
    return path


def png_bytes(image: Image.Image) -> bytes:
    """A picture as the bytes of a PNG file; the same picture gives the same bytes."""
    data = io.BytesIO()
    image.save(data, format="PNG", compress_level=6)
    return data.getvalue()


def _fine(points: Points) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in np.asarray(points) * FINE]


def _at(points: Points, travelled: Points, length: float) -> Points:
    return np.array([np.interp(length, travelled, points[:, axis]) for axis in (0, 1)])


def _dashes(points: Points, dash: tuple[float, float]) -> Sequence[Points]:
    points = np.asarray(points, dtype=np.float64)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    total, (on, off) = float(travelled[-1]), dash
    pieces: list[Points] = []
    for i in range(math.ceil(total / (on + off))):
        start, end = i * (on + off), min(i * (on + off) + on, total)
        inner = points[(travelled > start) & (travelled < end)]
        ends = [_at(points, travelled, length) for length in (start, end)]
        pieces.append(np.concatenate([ends[0][None], inner, ends[1][None]]))
    return pieces
