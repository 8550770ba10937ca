"""A plain chart of lines over a common axis, one panel below the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightopt.report._canvas import Canvas, check_png_path, write_picture
from lightopt.report._typeface import Typeface

INK, SOFT, FAINT, LINE, MARK = "#1c1f24", "#5c636e", "#e3e6ea", "#1f5fbf", "#c2410c"
SHADE = "#c2410c33"
WIDTH, PANEL_HEIGHT = 900, 300
LEFT, RIGHT, TOP, GAP, BOTTOM = 110, 30, 70, 60, 60
MOST_TICKS = 8
LEAST_DECADES = 0.5
"""A logarithmic axis of more than this has ticks at 1, 2 and 5 of each decade, one of more than 1.5 whole decades."""


@dataclass(frozen=True, kw_only=True)
class ChartLine:
    """A line beside others, named above the panel.

    Attributes
    ----------
    label
        What it is.
    x, values
        Its points, shape (n,).
    colour
        ``#rrggbb``.
    """

    label: str
    x: NDArray[np.float64]
    values: NDArray[np.float64]
    colour: str


@dataclass(frozen=True, kw_only=True)
class ChartPanel:
    """One panel: a line of values, and a mark on it.

    Attributes
    ----------
    label
        What the values are, with their unit.
    values
        Shape (n,).
    log
        Whether the axis is logarithmic; values must be above 0 then.
    mark
        Place (x, value) of a dot; None for none.
    dots, dot_px
        Further places (x, value) beside the line, shape (k, 2), and the radius that they are drawn with.
    span
        Interval (from, to) of the common axis that is shaded; None for none.
    lines
        Further lines, with points of their own.
    """

    label: str
    values: NDArray[np.float64]
    log: bool = False
    mark: tuple[float, float] | None = None
    dots: NDArray[np.float64] | None = None
    dot_px: float = 1.5
    span: tuple[float, float] | None = None
    lines: tuple[ChartLine, ...] = ()


def draw_chart(
    path: str | Path,
    *,
    title: str,
    x_label: str,
    x: NDArray[np.float64],
    panels: Sequence[ChartPanel],
    log_x: bool = False,
) -> Path:
    """Draw panels over a common axis into a PNG; the same values give the same bytes.

    Parameters
    ----------
    path
        The PNG to make or to replace, in a folder that exists.
    title, x_label
        Texts above and below.
    x
        Common coordinate, ascending, shape (n,).
    panels
        From top to bottom.
    log_x
        Whether the common axis is logarithmic.

    Raises
    ------
    InputError
        The name does not end in ``.png``, or the file cannot be written.
    """
    path = check_png_path(path)
    return write_picture(path, chart_image(title=title, x_label=x_label, x=x, panels=panels, log_x=log_x))


def chart_image(
    *, title: str, x_label: str, x: NDArray[np.float64], panels: Sequence[ChartPanel], log_x: bool = False
) -> Image.Image:
    """The picture that :func:`draw_chart` writes."""
    height = TOP + len(panels) * PANEL_HEIGHT + (len(panels) - 1) * GAP + BOTTOM
    canvas = Canvas(WIDTH, height)
    texts: list[tuple[float, float, str, Literal["left", "centre", "right"]]] = []
    across = _Axis.over([x, *(line.x for panel in panels for line in panel.lines)], log_x)
    names: list[tuple[float, float, str, str]] = []
    for i, panel in enumerate(panels):
        top = TOP + i * (PANEL_HEIGHT + GAP)
        dots = np.empty((0, 2)) if panel.dots is None else panel.dots
        up = _Axis.over([panel.values, dots[:, 1], *(line.values for line in panel.lines)], panel.log)
        if panel.span is not None:
            left, right = (LEFT + across.share(end) * (WIDTH - LEFT - RIGHT) for end in panel.span)
            corners = [[left, top], [right, top], [right, top + PANEL_HEIGHT], [left, top + PANEL_HEIGHT]]
            canvas.polygon(np.array(corners), fill=SHADE)
        for tick in across.ticks():
            place = LEFT + across.share(tick) * (WIDTH - LEFT - RIGHT)
            canvas.line(np.array([[place, top], [place, top + PANEL_HEIGHT]]), colour=FAINT, width=1.0)
            if i == len(panels) - 1:
                texts.append((place, top + PANEL_HEIGHT + 22, f"{tick:g}", "centre"))
        for tick in up.ticks():
            place = top + (1.0 - up.share(tick)) * PANEL_HEIGHT
            canvas.line(np.array([[LEFT, place], [WIDTH - RIGHT, place]]), colour=FAINT, width=1.0)
            texts.append((LEFT - 8, place + 5, f"{tick:g}", "right"))
        places = [_place(across, up, top, a, b) for a, b in zip(x, panel.values, strict=True)]
        for x_dot, y_dot in dots:
            canvas.disc(np.array(_place(across, up, top, x_dot, y_dot)), panel.dot_px, fill=SOFT)
        drawn = [(places, LINE)]
        for line in panel.lines:
            own = [_place(across, up, top, a, b) for a, b in zip(line.x, line.values, strict=True)]
            drawn.append((own, line.colour))
        for own, colour in drawn:
            canvas.line(np.array(own).reshape(-1, 2), colour=colour, width=2.0)
            for place in own:
                canvas.disc(np.array(place), 2.5, fill=colour)
        if panel.mark is not None:
            canvas.disc(np.array(_place(across, up, top, *panel.mark)), 6.0, fill=MARK)
        texts.append((LEFT, top - 12, panel.label, "left"))
        names += _names(panel, top - 12)
    image = canvas.finished()
    head, body = Typeface(22), Typeface(15)
    head.paint(image, LEFT, 32, head.fit(title, WIDTH - LEFT - RIGHT), fill=INK)
    for left, baseline, text, align in texts:
        body.paint(image, left, baseline, text, fill=SOFT, align=align)
    for right, baseline, text, colour in names:
        body.paint(image, right, baseline, text, fill=colour, align="right")
    body.paint(image, 0.5 * (LEFT + WIDTH - RIGHT), height - 14, x_label, fill=INK, align="centre")
    return image


def _names(panel: ChartPanel, baseline: float) -> list[tuple[float, float, str, str]]:
    """Names of the lines in their colours, from the right edge leftwards: place, text and colour."""
    body = Typeface(15)
    names: list[tuple[float, float, str, str]] = []
    right = float(WIDTH - RIGHT)
    for line in reversed(panel.lines):
        text = body.fit(line.label, 200)
        names.append((right, baseline, text, line.colour))
        right -= body.width(text) + 18
    return names


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    log: bool

    @staticmethod
    def over(values: Sequence[NDArray[np.float64]], log: bool) -> _Axis:
        every = np.concatenate([np.asarray(v, dtype=np.float64) for v in values])
        low, high = float(every.min()), float(every.max())
        if log:
            low, high = math.log10(max(low, 1e-300)), math.log10(max(high, 1e-300))
        room = 0.04 * (high - low) or 1.0
        return _Axis(low - room, high + room, log)

    def share(self, value: float) -> float:
        at = math.log10(max(value, 1e-300)) if self.log else value
        return (at - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        span = self.high - self.low
        if self.log and span > 1.5:
            step = max(1, math.ceil(span / MOST_TICKS))
            return [10.0**e for e in range(math.ceil(self.low), math.floor(self.high) + 1, step)]
        if self.log and span > LEAST_DECADES:
            decades = range(math.floor(self.low), math.floor(self.high) + 1)
            every = [float(f"{m}e{e}") for e in decades for m in (1, 2, 5)]
            return [tick for tick in every if self.low <= math.log10(tick) <= self.high]
        low, high = (10.0**self.low, 10.0**self.high) if self.log else (self.low, self.high)
        raw = (high - low) / MOST_TICKS
        unit = 10.0 ** math.floor(math.log10(raw))
        step = next(m * unit for m in (1.0, 2.0, 5.0, 10.0) if m * unit >= raw)
        first = math.ceil(low / step)
        return [float(f"{k * step:.12g}") for k in range(first, math.floor(high / step) + 1)]


def _place(across: _Axis, up: _Axis, top: float, x: float, y: float) -> tuple[float, float]:
    return (
        LEFT + across.share(x) * (WIDTH - LEFT - RIGHT),
        top + (1.0 - up.share(y)) * PANEL_HEIGHT,
    )
