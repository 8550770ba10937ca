"""Figures and charts by matplotlib, and pictures as PNG: the same picture gives the same bytes.

Figures have one style and font. Camera images are made small without losing their highlights. matplotlib takes long to
import, so each function imports what it uses.
"""

from __future__ import annotations

import io
import math
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightopt.core.arrays import Bool, Float64, UInt8
from lightopt.core.errors import InputError
from lightopt.images import write_bytes_atomic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


INK, SOFT, FAINT = "#1c1f24", "#5c636e", "#d4d8de"
DPI = 64  # of all figures
POINT = 72 / DPI  # length of a pixel [pt]
FONT = "DejaVu Sans"  # comes with matplotlib
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


def shortened(text: str, most: int) -> str:
    """The text, its end replaced by an ellipsis where it has more than so many characters; one line, printable."""
    text = printable(text)
    return text if len(text) <= most else f"{text[: most - 1].rstrip()}…"


def hex_colour(rgb: Iterable[int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def figure_image(figure: Figure) -> Image.Image:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3])


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
    heading = shortened(title, 80)
    figure.suptitle(heading, x=0.03, ha="left", color=INK, fontsize=TITLE_SIZE * POINT)
    panels: list[Axes] = list(figure.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0])
    for i, (panel, label) in enumerate(zip(panels, labels, strict=True)):
        panel.set_title(shortened(label, 100), loc="left", color=SOFT, fontsize=TEXT_SIZE * POINT)
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
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator("auto", integer=True, min_n_ticks=1))


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


def check_png_path(path: str | Path) -> Path:
    """The path of a picture to write; an InputError where it does not end in ``.png``."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are written as PNG; expected a name that ends in .png")
    return path


def write_picture(path: Path, image: Image.Image, *, overwrite: bool = True) -> Path:
    """Write an RGB picture, whole or not at all."""
    write_bytes_atomic(path, png_bytes(image), overwrite=overwrite)
    return path


def png_bytes(image: Image.Image | UInt8) -> bytes:
    data = io.BytesIO()
    own = Image.fromarray(image) if isinstance(image, np.ndarray) else image
    own.save(data, format="PNG", compress_level=3)
    return data.getvalue()


SATURATED_COLOUR = (225, 29, 42)  # of a cell all of whose pixels are saturated

# how much of that colour a cell with hardly any saturated pixels gets, so that a single one still shows
FAINTEST_MARK = 0.4


@dataclass(frozen=True)
class Thumbnail:
    picture: UInt8  # RGB, shape (rows, columns, 3), read-only
    saturated: int  # number of saturated pixels in the image
    pixels: int  # number of all its pixels


def thumbnail(level: NDArray[np.floating], saturated: Bool, *, limit: int) -> Thumbnail:
    """Shrink an image by averaging square cells of whole pixels; small images are enlarged by repeating pixels.

    level: Share of full scale, shown linearly as grey from black (0 and below) to white (1 and above), shape (rows,
        columns).
    saturated: Where the camera is saturated, same shape. The share of saturated pixels in a cell tints it.
    limit: Neither side becomes longer [px].
    """
    height, width = level.shape
    shrink, enlarge = _factors(width, height, limit)
    grey = _cell_means(np.clip(np.nan_to_num(level), 0.0, 1.0), shrink)
    tint = shade_of_saturation(_cell_means(saturated, shrink))[..., None]
    blend = (1.0 - tint) * (255.0 * grey[..., None]) + tint * np.array(SATURATED_COLOUR)
    picture = np.floor(blend + 0.5).astype(np.uint8).repeat(enlarge, axis=0).repeat(enlarge, axis=1)
    picture.flags.writeable = False
    return Thumbnail(picture, int(np.count_nonzero(saturated)), saturated.size)


def shrunk(picture: UInt8 | NDArray[np.uint8 | np.uint16], *, limit: int) -> UInt8:
    """A colour picture of 8 bits, shape (rows, columns, 3), by means of square cells; no side longer than `limit`."""
    shrink, _ = _factors(picture.shape[1], picture.shape[0], limit)
    channels = [_cell_means(picture[..., k], shrink) for k in range(3)]
    return np.floor(np.stack(channels, axis=-1) + 0.5).astype(np.uint8)


def shade_of_saturation(share: Float64) -> Float64:
    """How strongly :data:`SATURATED_COLOUR` covers a cell, 0 to 1, by the share of its pixels that are saturated."""
    return np.where(share > 0.0, FAINTEST_MARK + (1.0 - FAINTEST_MARK) * share, 0.0)


def _factors(width: int, height: int, limit: int) -> tuple[int, int]:
    longest = max(width, height)
    return max(1, math.ceil(longest / limit)), max(1, limit // longest)


def _cell_means(values: NDArray[Any], side: int) -> Float64:
    """Means over cells of side × side pixels; cells cut by the border are averaged over what is there of them."""
    rows, columns = (np.arange(0, length, side) for length in values.shape)
    cells = np.add.reduceat(values.astype(np.float64), rows, axis=0)
    sums: Float64 = np.add.reduceat(cells, columns, axis=1)
    return sums / np.outer(np.diff(rows, append=values.shape[0]), np.diff(columns, append=values.shape[1]))
