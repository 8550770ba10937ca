"""Text with Pillow's own scalable font, and the few letters of the field that it lacks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from PIL import Image, ImageDraw, ImageFont

from lightopt.core.errors import InputError

SUB_START = "\x0e"
SUB_END = "\x0f"
"""What is between them is set as a subscript; control characters, which no name shown to people contains."""

_SUB_SIZE = 0.72
_SUB_DROP = 0.2
_STEM = 0.078
"""Width of an upright stroke of the font [em]."""

_FINE = 8
"""Drawn letters are antialiased from this many times the resolution."""

Stroke = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class _Drawn:
    """A letter of strokes: its advance and polylines in [em], origin on the baseline, y upwards."""

    advance: float
    strokes: tuple[Stroke, ...]


def _ellipse(x: float, y: float, rx: float, ry: float) -> Stroke:
    turns = [2.0 * math.pi * i / 48 for i in range(49)]
    return tuple((x + rx * math.cos(t), y + ry * math.sin(t)) for t in turns)


def _drawn_letter(character: str) -> _Drawn | None:
    """Greek letters and signs that the font lacks, on its metrics: x-height 0.54, digits 0.70, descender −0.20 em."""
    if character == "θ":
        return _Drawn(0.56, (_ellipse(0.28, 0.35, 0.205, 0.335), ((0.085, 0.35), (0.475, 0.35))))
    if character == "φ":
        return _Drawn(0.66, (_ellipse(0.33, 0.265, 0.255, 0.245), ((0.33, 0.69), (0.33, -0.18))))
    if character == "ρ":
        stem = ((0.105, -0.18), (0.105, 0.265))
        return _Drawn(0.60, (_ellipse(0.32, 0.265, 0.215, 0.245), stem))
    if character == "×":
        return _Drawn(0.58, (((0.11, 0.10), (0.47, 0.46)), ((0.11, 0.46), (0.47, 0.10))))
    if character == "−":
        return _Drawn(0.58, (((0.07, 0.28), (0.51, 0.28)),))
    return None


def sub(letter: str, index: str) -> str:
    """A letter with a subscript, for :meth:`Typeface.paint`."""
    return f"{letter}{SUB_START}{index}{SUB_END}"


@dataclass(frozen=True)
class _Run:
    text: str
    lowered: bool
    drawn: _Drawn | None


def _runs(text: str) -> list[_Run]:
    """Split text where the font, the size or the way of drawing changes."""
    runs: list[_Run] = []
    lowered = False
    for character in text:
        if character in (SUB_START, SUB_END):
            lowered = character == SUB_START
            continue
        # a name from a foreign file may hold anything; the font shows a box for what it cannot
        shown = character if character.isprintable() else "\ufffd"
        drawn = _drawn_letter(shown)
        last = runs[-1] if runs else None
        if drawn is None and last is not None and last.drawn is None and last.lowered == lowered:
            runs[-1] = _Run(last.text + shown, lowered, None)
        else:
            runs.append(_Run(shown, lowered, drawn))
    return runs


class Typeface:
    """Pillow's built-in font at one size.

    Parameters
    ----------
    size
        Of an em [px].

    Raises
    ------
    InputError
        When Pillow was built without FreeType.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._font = _load(size)
        self._small = _load(round(size * _SUB_SIZE))

    @property
    def line_height(self) -> int:
        """Distance of baselines [px]."""
        return round(1.3 * self.size)

    @property
    def cap_height(self) -> int:
        """Height of capitals and digits above the baseline [px]."""
        return round(0.7 * self.size)

    @property
    def descent(self) -> int:
        """How far letters reach below the baseline [px]."""
        return round(0.21 * self.size)

    def width(self, text: str) -> int:
        """Advance of a line of text [px]."""
        return sum(self._advance(run) for run in _runs(text))

    def fit(self, text: str, width: float) -> str:
        """The text, its end replaced by an ellipsis where it is wider than `width` [px]."""
        if self.width(text) <= width:
            return text
        for end in range(len(text) - 1, 0, -1):
            shortened = text[:end].rstrip() + "…"
            if self.width(shortened) <= width:
                return shortened
        return "…"

    def paint(
        self,
        image: Image.Image,
        x: float,
        baseline: float,
        text: str,
        *,
        fill: str,
        align: Literal["left", "centre", "right"] = "left",
        halo: str | None = None,
    ) -> None:
        """Write a line of text.

        Parameters
        ----------
        image
            RGB picture to write on.
        x, baseline
            Where the line starts, has its middle or ends, by `align`, and where its letters stand [px].
        text
            One line; subscripts between :data:`SUB_START` and :data:`SUB_END`.
        fill
            Colour.
        halo
            Colour of a border around the letters that sets them off from what they stand on.
        """
        share = {"left": 0.0, "centre": 0.5, "right": 1.0}[align]
        start = round(x - share * self.width(text))
        for border, colour in ((max(2, self.size // 7), halo), (0, fill)):
            if colour is None:
                continue
            at = start
            for run in _runs(text):
                self._paint_run(image, at, round(baseline), run, colour, border)
                at += self._advance(run)

    def _advance(self, run: _Run) -> int:
        if run.drawn is not None:
            return round(run.drawn.advance * self._em(run))
        return round((self._small if run.lowered else self._font).getlength(run.text))

    def _em(self, run: _Run) -> float:
        return self.size * (_SUB_SIZE if run.lowered else 1.0)

    def _paint_run(
        self, image: Image.Image, x: int, baseline: int, run: _Run, colour: str, border: int
    ) -> None:
        y = baseline + (round(_SUB_DROP * self.size) if run.lowered else 0)
        if run.drawn is not None:
            _paint_strokes(image, x, y, run.drawn, self._em(run), colour, border)
            return
        font = self._small if run.lowered else self._font
        ImageDraw.Draw(image).text(
            (x, y), run.text, font=font, fill=colour, anchor="ls", stroke_width=border, stroke_fill=colour
        )


def _load(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):
        raise InputError(
            "Pillow was built without FreeType and cannot write text at this size; install Pillow's own wheel "
            "(pip install --force-reinstall pillow)"
        )
    return font


def _paint_strokes(
    image: Image.Image, x: int, baseline: int, letter: _Drawn, em: float, colour: str, border: int
) -> None:
    margin = border + 2
    width = math.ceil(letter.advance * em) + 2 * margin
    ascent, descent = math.ceil(0.8 * em) + margin, math.ceil(0.3 * em) + margin
    mask = Image.new("L", (width * _FINE, (ascent + descent) * _FINE))
    draw = ImageDraw.Draw(mask)
    radius = 0.5 * (max(1.0, _STEM * em) + 2 * border) * _FINE
    for stroke in letter.strokes:
        points = [((margin + px * em) * _FINE, (ascent - py * em) * _FINE) for px, py in stroke]
        draw.line(points, fill=255, width=max(1, round(2 * radius)), joint="curve")
        if border:
            for px, py in (points[0], points[-1]):
                draw.ellipse((px - radius, py - radius, px + radius, py + radius), fill=255)
    image.paste(colour, (x - margin, baseline - ascent), mask.reduce(_FINE))
