"""Figures and charts by matplotlib, always in one style and font: the same figure gives the same bytes.

matplotlib takes long to import, so each function imports what it uses.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

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
