"""Drawings and charts by matplotlib, in pixels and always in one style and font: the same drawing gives the same bytes.

matplotlib takes long to import, so each function imports what it uses.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from PIL import Image

from lightopt.core.arrays import Float64, UInt8

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure


INK, SOFT, FAINT = "#1c1f24", "#5c636e", "#d4d8de"
DPI = 64  # Of all figures. A power of two: whole pixels remain whole when they are expressed in inches.
POINT = 72 / DPI  # length of a pixel [pt]
FONT = "DejaVu Sans"  # comes with matplotlib
CAP_HEIGHT, DESCENT, LINE_HEIGHT = 0.73, 0.24, 1.35  # of the font, per em
_MATH = "$\\mathdefault{"

Points = Float64  # places on the picture [px], x to the right and y down, shape (n, 2)
Box = tuple[float, float, float, float]  # left, top, right, bottom [px]

# distances from a label to its anchor that are tried [px], each in so many directions
_RADII = (6, 12, 20, 30, 44, 62, 85, 115, 155, 210, 280, 370, 480, 620, 800)
_DIRECTIONS = 24
_SPACE = 4  # least distance of two labels [px]
_LEADER = 34  # from this distance on a thin line leads from the anchor to the label [px]

# what a label wholly on lines, or on the side opposite to the preferred one, costs in px of distance
_INK_COST, _SIDE_COST = 450.0, 16.0
LINE, MARK, SHADE = "#1f5fbf", "#c2410c", "#c2410c33"

# Okabe and Ito (2008)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
WIDTH, PANEL_HEIGHT, TITLE_HEIGHT = 900, 350, 90  # of a chart and of one panel with its ticks [px]
TITLE_SIZE, TEXT_SIZE = 19, 14  # [px]


@contextmanager
def fixed_style() -> Generator[None, None, None]:
    """Draw in matplotlib's default style with the fixed font, whatever the user has configured; also a decorator."""
    import matplotlib.style

    own: dict[str, Any] = {
        "font.family": FONT,
        "lines.linewidth": 2.0 * POINT,
        "lines.markersize": 8.0 * POINT,
        "lines.scale_dashes": False,
        "text.parse_math": False,  # a name may have any letters
    }
    with matplotlib.style.context(["default", own]):
        yield


def sub(letter: str, index: str) -> str:
    """A letter with a subscript."""
    return f"{_MATH}{letter}_{index}}}$"


def font_file() -> str:
    """Path of the font, found without the import of matplotlib."""
    package = find_spec("matplotlib")
    assert package is not None
    assert package.origin is not None
    return str(Path(package.origin).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf")


def printable(text: str) -> str:
    """One line of text, with a replacement character for each that the font lacks."""
    from matplotlib.font_manager import get_font

    font = get_font(font_file())
    return "".join(c if c.isprintable() and font.get_char_index(ord(c)) else "\ufffd" for c in text)


@lru_cache(maxsize=10_000)
def text_width(text: str, size: float) -> int:
    """Width of a line of text of a size [px], rounded up [px]."""
    from matplotlib.backends.backend_agg import RendererAgg
    from matplotlib.font_manager import FontProperties

    font = FontProperties(family=FONT, size=size * POINT)
    width, _, _ = RendererAgg(1, 1, DPI).get_text_width_height_descent(printable(text), font, _MATH in text)
    return math.ceil(width)


def fit_text(text: str, size: float, width: float) -> str:
    """The text, its end replaced by an ellipsis where it is wider than `width` [px]."""
    if text_width(text, size) <= width:
        return text
    shortened = (text[:end].rstrip() + "…" for end in range(len(text) - 1, 0, -1))
    return next((line for line in shortened if text_width(line, size) <= width), "…")


def hex_colour(rgb: Iterable[int]) -> str:
    """A colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def figure_image(figure: Figure) -> Image.Image:
    """A figure as an RGB picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return _rgb(canvas)


def _rgb(canvas: FigureCanvasAgg) -> Image.Image:
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


@dataclass(frozen=True, kw_only=True)
class Label:
    """What to write, and where it belongs."""

    text: str
    anchor: tuple[float, float]  # the place named [px]
    colour: str
    away: tuple[float, float] | None = None  # preferred direction from the anchor to the label, of any length


class Drawing:
    """A white picture of a size [px]. What is drawn later lies above what was drawn before."""

    def __init__(self, width: int, height: int) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.transforms import Affine2D

        self.width, self.height = width, height
        self._figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
        self._pixels = Affine2D().scale(1.0, -1.0).translate(0.0, height)
        self._canvas = FigureCanvasAgg(self._figure)
        self._canvas.draw()  # the paper; each artist is then drawn once, when it comes

    def line(self, points: Points, *, colour: str, width: float = 1.5, dash: tuple[float, float] | None = None) -> None:
        """Draw a polyline; `width` and the lengths of dash and gap in [px]."""
        from matplotlib.lines import Line2D

        style: Any = "-" if dash is None else (0.0, [length * POINT for length in dash])
        x, y = np.asarray(points, dtype=np.float64).T
        ends: dict[str, Any] = {"solid_capstyle": "butt", "solid_joinstyle": "round"}
        self._add(Line2D(x, y, color=colour, linewidth=width * POINT, linestyle=style, **ends))

    def polygon(self, points: Points, *, fill: str = "none", outline: str = "none", width: float = 1.5) -> None:
        """Draw an area; a fill of the form ``#rrggbbaa`` is translucent."""
        from matplotlib.patches import Polygon

        self._add(Polygon(points, facecolor=fill, edgecolor=outline, linewidth=width * POINT))

    def rectangle(self, box: Box, *, fill: str = "none", outline: str = "none", width: float = 1.5) -> None:
        """Draw an upright rectangle."""
        left, top, right, bottom = box
        corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
        self.polygon(corners, fill=fill, outline=outline, width=width)

    def disc(self, centre: Points, radius: float, *, fill: str, outline: str = "none") -> None:
        """Draw a disc around a place of shape (2,); radius in [px]."""
        from matplotlib.patches import Circle

        x, y = centre.tolist()
        self._add(Circle((x, y), radius, facecolor=fill, edgecolor=outline, linewidth=1.5 * POINT))

    def arrow(self, points: Points, *, colour: str, width: float = 2.0, head: float = 13.0) -> None:
        """Draw a polyline that ends in an arrow head of the given length [px]; a short line gets a smaller one."""
        from matplotlib.patches import FancyArrowPatch
        from matplotlib.path import Path as Polyline

        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        if length < 1.0:
            return
        shape: dict[str, Any] = {"shrinkA": 0.0, "shrinkB": 0.0, "capstyle": "butt", "joinstyle": "miter"}
        style, size = "-|>,head_length=0.9,head_width=0.27", min(head, 0.6 * length) * POINT
        line: dict[str, Any] = {"path": Polyline(points), "color": colour, "linewidth": width * POINT}
        self._add(FancyArrowPatch(arrowstyle=style, mutation_scale=size, **line, **shape))

    def picture(self, picture: UInt8, left: int, top: int) -> None:
        """Lay an RGB or RGBA picture over the drawing, pixel on pixel."""
        whole = left >= 0 and top >= 0 and left + picture.shape[1] <= self.width and top + len(picture) <= self.height
        if whole and picture.shape[2] == 3:
            # matplotlib would resample it first
            paper = np.asarray(self._canvas.buffer_rgba())
            paper[top : top + len(picture), left : left + picture.shape[1], :3] = picture
            return
        below = self.height - top - len(picture)
        self._figure.figimage(picture, left, below, origin="upper").draw(self._canvas.get_renderer())

    def text(
        self,
        x: float,
        baseline: float,
        text: str,
        *,
        size: float,
        colour: str = INK,
        align: Literal["left", "center", "right"] = "left",
        halo: str | None = None,
    ) -> None:
        """Write a line of text of a size [px]; `halo` is the colour of a border that sets the letters off."""
        from matplotlib.patheffects import withStroke
        from matplotlib.text import Text

        effects = [] if halo is None else [withStroke(linewidth=0.3 * size * POINT, foreground=halo)]
        style: dict[str, Any] = {"color": colour, "horizontalalignment": align, "verticalalignment": "baseline"}
        letters: dict[str, Any] = {"fontsize": size * POINT, "parse_math": _MATH in text, "path_effects": effects}
        self._add(Text(x, baseline, printable(text), **letters, **style))

    def labels(self, labels: Sequence[Label], *, size: float, bounds: Box) -> list[Box]:
        """Write labels within bounds, none on another and as little as possible on what is drawn; where they stand.

        The first ones have the choice. One for which there is no room at all is left out. A thin line leads to an
        anchor that is far.
        """
        sums = np.zeros((self.height + 1, self.width + 1))
        sums[1:, 1:] = _ink(np.asarray(self._canvas.buffer_rgba())).cumsum(axis=0).cumsum(axis=1)
        placed: list[tuple[Label, Box]] = []
        for label in labels:
            box = _best_box(label, size, sums, bounds, [other for _, other in placed])
            if box is not None:
                placed.append((label, box))
        for label, (left, top, right, bottom) in placed:
            x, y = label.anchor
            nearest = (min(max(x, left), right), min(max(y, top), bottom))
            if math.dist((x, y), nearest) > _LEADER:
                self.line(np.array([(x, y), nearest]), colour="#8a919b", width=1.0)
        for label, (left, _, _, bottom) in placed:
            self.text(left, bottom - DESCENT * size, label.text, size=size, colour=label.colour, halo="#ffffff")
        return [box for _, box in placed]

    def image(self) -> Image.Image:
        """The picture so far, RGB."""
        return _rgb(self._canvas)

    def _add(self, artist: Artist) -> None:
        artist.set_transform(self._pixels)
        self._figure.add_artist(artist)
        artist.draw(self._canvas.get_renderer())


def _ink(picture: UInt8) -> Float64:
    # how much is drawn at each pixel, 0 to 1; pale areas are as good as paper
    red, green, blue = np.moveaxis(picture[..., :3], 2, 0)
    darkness = 255.0 - np.arange(256.0)
    return np.clip((darkness - 24.0) / 100.0, 0.0, 1.0)[np.minimum(np.minimum(red, green), blue)]


def _best_box(label: Label, size: float, sums: Float64, bounds: Box, taken: Sequence[Box]) -> Box | None:
    """The best place for a label, given the integral image of the ink and the boxes of other labels."""
    radius, angle = np.meshgrid(_RADII, 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS, indexing="ij")
    ux, uy = np.cos(angle), np.sin(angle)
    width, height = text_width(label.text, size), math.ceil((CAP_HEIGHT + 2.0 * DESCENT) * size)
    # whole pixels, so that the box found is the box written
    left = np.rint(label.anchor[0] + ux * radius + (ux - 1.0) * 0.5 * width).astype(int)
    top = np.rint(label.anchor[1] + uy * radius + (uy - 1.0) * 0.5 * height).astype(int)
    right, bottom = left + width, top + height
    free = (left >= bounds[0]) & (top >= bounds[1]) & (right <= bounds[2]) & (bottom <= bounds[3])
    for box in taken:
        beside = (left >= box[2] + _SPACE) | (right + _SPACE <= box[0])
        free &= beside | (top >= box[3] + _SPACE) | (bottom + _SPACE <= box[1])
    if not free.any():
        return None
    x0, x1 = (np.clip(side, 0, sums.shape[1] - 1) for side in (left, right))
    y0, y1 = (np.clip(side, 0, sums.shape[0] - 1) for side in (top, bottom))
    ink = (sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]) / (width * height)
    cost = radius + _INK_COST * ink
    if label.away is not None and (length := math.hypot(*label.away)) > 0.0:
        cost += _SIDE_COST * (0.5 - 0.5 * (ux * label.away[0] + uy * label.away[1]) / length)
    best = np.unravel_index(np.argmin(np.where(free, cost, np.inf)), free.shape)
    return float(left[best]), float(top[best]), float(right[best]), float(bottom[best])


def chart(
    *, title: str, x_label: str, labels: Sequence[str], log_x: bool = False, log_y: Sequence[bool] = ()
) -> tuple[Figure, list[Axes]]:
    """Panels to draw into, from top to bottom, each with a label that says what its values are.

    Call it within :func:`lightopt.report.fixed_style`.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    size = WIDTH / DPI, (TITLE_HEIGHT + len(labels) * PANEL_HEIGHT) / DPI
    figure = Figure(figsize=size, dpi=DPI, layout=ConstrainedLayoutEngine(w_pad=0.2, h_pad=0.15))
    heading = printable(fit_text(title, TITLE_SIZE, WIDTH - 60))
    figure.suptitle(heading, x=0.03, ha="left", color=INK, fontsize=TITLE_SIZE * POINT)
    panels: list[Axes] = list(figure.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0])
    for i, (panel, label) in enumerate(zip(panels, labels, strict=True)):
        name = printable(fit_text(label, TEXT_SIZE, WIDTH - 130))
        panel.set_title(name, loc="left", color=SOFT, fontsize=TEXT_SIZE * POINT)
        panel.grid(color=FAINT, linewidth=POINT)
        panel.set_axisbelow(True)
        panel.tick_params(which="both", length=0, labelsize=TEXT_SIZE * POINT, labelcolor=SOFT)
        panel.spines[:].set_visible(False)
        if log_x:
            panel.set_xscale("log")
            _label_decades(panel.xaxis)
        if i < len(log_y) and log_y[i]:
            panel.set_yscale("log")
            _label_decades(panel.yaxis)
    panels[-1].set_xlabel(x_label, color=INK, fontsize=TEXT_SIZE * POINT)
    return figure, panels


def name_lines(panel: Axes) -> None:
    """Name the lines of a panel that have labels, to its right."""
    panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=TEXT_SIZE * POINT)


def label_whole_numbers(axis: Axis) -> None:
    """Ticks at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator("auto", integer=True))


def _label_decades(axis: Axis) -> None:
    """Ticks at the decades of a logarithmic axis, or at 1, 2 and 5 of each, or evenly spaced where it is short."""
    from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

    class Decades(LogLocator):
        def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
            if vmax < 3.0 * vmin:
                return MaxNLocator(nbins=8, steps=[1, 2, 5, 10]).tick_values(vmin, vmax)
            self.set_params(subs=(1.0, 2.0, 5.0) if vmax < 30.0 * vmin else (1.0,))
            return super().tick_values(vmin, vmax)

    axis.set_major_locator(Decades())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())  # ticks have no length: what is laid out and drawn of them is nothing
