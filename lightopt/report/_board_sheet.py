"""Calibration boards to print, in true size."""

from io import BytesIO
from pathlib import Path
from typing import Any

from lightopt.config import BoardTargetConfig
from lightopt.core.errors import InputError
from lightopt.estimate.rig_calibration import white_areas
from lightopt.images import write_bytes_atomic
from lightopt.report._drawing import fixed_style

_MM_PER_INCH = 25.4
_PAPERS = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "letter": (279.4, 215.9)}  # landscape [mm]
_BORDER = 10.0  # that printers leave white [mm]
_CAPTION = 16.0  # height below the board for scale bar and text [mm]
_DPI = 600.0  # of a PNG


def board_sheet(target: BoardTargetConfig, path: str | Path, *, paper: str | None = None) -> None:
    """Draw a ChArUco board in true size as PDF or PNG, with a scale bar and its parameters. Needs OpenCV.

    paper: a4, a3 or letter, landscape; by default a sheet just large enough. Print without scaling, and measure the
        bar and both pitches
    Raises InputError: Another kind of file or paper, or the board is larger than the paper
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("pdf", "png"):
        raise InputError(f"{path}: expected a name that ends with .pdf or .png")
    columns, rows = target.squares
    width, height = columns * target.square_mm, rows * target.square_mm
    least = width + 2.0 * _BORDER, height + 2.0 * _BORDER + _CAPTION
    if paper is not None and paper.lower() not in _PAPERS:
        raise InputError(f"paper {paper}: expected {', '.join(_PAPERS)}")
    sheet = least if paper is None else _PAPERS[paper.lower()]
    if sheet[0] < least[0] or sheet[1] < least[1]:
        raise InputError(
            f"the board needs {least[0]:g} × {least[1]:g} mm, and {paper} has {sheet[0]:g} × {sheet[1]:g} mm. Choose "
            "larger paper, or smaller or fewer squares"
        )
    with fixed_style():
        figure = Figure(figsize=(sheet[0] / _MM_PER_INCH, sheet[1] / _MM_PER_INCH), dpi=_DPI, facecolor="white")
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set_axis_off()
        # board frame in the middle of the sheet above the caption, 1 unit is 1 mm
        below = 0.5 * (sheet[1] + _CAPTION)
        axes.set_xlim(-0.5 * sheet[0], 0.5 * sheet[0])
        axes.set_ylim(-below, sheet[1] - below)
        black: dict[str, Any] = {"color": "black", "linewidth": 0.0, "antialiased": False}
        axes.fill(*_rectangle(-0.5 * width, -0.5 * height, 0.5 * width, 0.5 * height), **black)
        white = [list(zip(*_rectangle(*area), strict=True)) for area in white_areas(target)]
        axes.add_collection(PolyCollection(white, facecolors="white", linewidths=0.0, antialiaseds=False))
        bar = max(length for length in (100.0, 50.0, 20.0, 10.0, 5.0) if length <= max(width, 5.0))
        left, line = -0.5 * width, -0.5 * height - 4.0
        axes.fill(*_rectangle(left, line - 1.0, left + bar, line), **black)
        sides = f"squares {target.square_mm:g} mm, markers {target.marker_mm:g} mm"
        legacy = ", legacy pattern" if target.legacy_pattern else ""
        text = f"The bar is {bar:g} mm long. {columns} × {rows} {sides}, {target.dictionary}{legacy}"
        axes.text(left, line - 3.0, text, fontsize=min(7.0, 0.05 * width), va="top")
        drawn = BytesIO()
        figure.savefig(drawn, format=kind, dpi=_DPI)
    write_bytes_atomic(path, drawn.getvalue())


def _rectangle(left: float, bottom: float, right: float, top: float) -> tuple[list[float], list[float]]:
    return [left, right, right, left], [bottom, bottom, top, top]
