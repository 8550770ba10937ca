"""Pictures of a fit: its ridge, the paper's sweep, measured minus predicted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from lightopt.core.arrays import Float32
from lightopt.images.comparison import diverging
from lightopt.report import _pictures
from lightopt.report._pictures import write_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from lightopt.estimate.reflectance import FitResult, PaperDiffuse, PaperSpecular

RESIDUAL_SCALE = 0.08  # difference of the full colours, as a share of the sensor's full scale: 20 of 255 levels

# where R_s runs away, no highlight of that width fits [grey level]; such points of the ridge are not drawn
RUNAWAY = 1e11
LEGEND_HEIGHT = 24


@_pictures.fixed_style()
def fit_chart(result: FitResult, place: Callable[[], Path]) -> Path | None:
    """Draw a fit's ridge of R_s and σ, or the paper's rounds, into the PNG `place()`; None where nothing is to draw."""
    from lightopt.estimate.reflectance import PaperDiffuse, PaperSpecular

    if isinstance(result.paper, PaperSpecular):
        figure = _paper_sweep(result.paper)
    else:
        figure = _paper_rounds(result.paper) if isinstance(result.paper, PaperDiffuse) else _ridge(result)
    return None if figure is None else write_picture(place(), _pictures.figure_image(figure))


def _ridge(result: FitResult) -> Figure | None:
    if result.kind == "diffuse" or result.estimate is None:
        return None
    scan = tuple(point for point in result.estimate.scan if point.R_s < RUNAWAY)
    if len(scan) < 3:
        return None
    sigma = np.array([point.sigma for point in scan])
    fall = 2.0 * (max(point.value for point in scan) - np.array([point.value for point in scan]))
    what = "twice the log-likelihood" + ("" if result.estimate.describes else " of least squares")
    figure, (ridge, below) = _pictures.chart(
        title="The ridge: at each sigma, the R_s that fits best, and how much worse it fits",
        x_label="sigma [rad]",
        labels=("R_s [grey level]", f"{what} below the best, plus 1; the 95 % interval is shaded"),
        log_x=True,
        log_y=(True, True),
    )
    ridge.plot(sigma, [point.R_s for point in scan], ".-", color=_pictures.LINE)
    below.plot(sigma, fall + 1.0, ".-", color=_pictures.LINE)
    name, factor = result.model.width_key, result.model.width_factor
    if name in result.fitted:
        best = result.value(name) / factor
        ridge.plot(best, result.value("R_s"), "o", color=_pictures.MARK)
        below.plot(best, 1.0, "o", color=_pictures.MARK)
    interval = next((v.interval for v in result.values if v.name == name), None)
    if interval is not None:
        # an end that the images do not bound is that of the drawing
        ends = (None if end is None else end / factor for end in interval)
        low, high = (end or edge for end, edge in zip(ends, (sigma[0], sigma[-1]), strict=True))
        below.axvspan(max(float(low), sigma[0]), min(float(high), sigma[-1]), color=_pictures.SHADE, linewidth=0.0)
    return figure


def _paper_rounds(record: PaperDiffuse) -> Figure:
    labels = "R_d [grey level]", "D, difference of the mean brightness [grey level]"
    title = "R_d, round by round (section 4.2)"
    figure, (coefficient, difference) = _pictures.chart(title=title, x_label="round", labels=labels)
    rounds = np.arange(1, len(record.iterations) + 1)
    coefficient.plot(rounds, [i[0] for i in record.iterations], ".-", color=_pictures.LINE)
    difference.plot(rounds, [i[2] for i in record.iterations], ".-", color=_pictures.LINE)
    _pictures.label_whole_numbers(difference.xaxis)
    return figure


def _paper_sweep(record: PaperSpecular) -> Figure:
    steps = sorted(record.steps, key=lambda step: step.sigma)
    sigma = [step.sigma for step in steps]
    figure, (coefficient, brightness, rounds) = _pictures.chart(
        title="The sweep over sigma (section 4.3)",
        x_label="sigma [rad]",
        labels=(
            "R_s at which as many pixels are saturated as measured, and its rounds (dots) [grey level]",
            "total specular brightness, simulated over measured",
            "rounds of equation 10",
        ),
        log_y=(True, False, False),
    )
    dots = np.array([[s.sigma, max(r_s, 1e-3)] for s in steps for r_s, _ in s.iterations]).reshape(-1, 2)
    coefficient.plot(*dots.T, ".", color=_pictures.SOFT, markersize=5.0)
    coefficient.plot(sigma, [max(step.R_s, 1e-3) for step in steps], ".-", color=_pictures.LINE)
    coefficient.plot(record.sigma, record.R_s, "o", color=_pictures.MARK)
    brightness.plot(sigma, [min(step.brightness, 10.0) for step in steps], ".-", color=_pictures.LINE)
    rounds.plot(sigma, [len(step.iterations) for step in steps], ".-", color=_pictures.LINE)
    _pictures.label_whole_numbers(rounds.yaxis)
    return figure


@_pictures.fixed_style()
def residual_picture(
    path: str | Path, *, measured: Float32, predicted: Float32, saturated_from: float, full: float
) -> Path:
    """Write a PNG of measured minus predicted: blue darker than predicted, white equal, red brighter; legend below.

    path: In a folder that exists.
    measured, predicted: Sensor levels, shape (height, width); both are clipped at the saturation level first.
    saturated_from, full: Saturation level and full scale of the sensor.
    """
    from matplotlib.figure import Figure

    top = np.float32(saturated_from)
    difference = np.minimum(measured, top) - np.clip(predicted, 0.0, top)
    width = difference.shape[1]
    scale = RESIDUAL_SCALE * full
    figure = Figure(figsize=(width / _pictures.DPI, LEGEND_HEIGHT / _pictures.DPI), dpi=_pictures.DPI)
    figure.figimage(diverging(np.tile(np.linspace(-1.0, 1.0, width), (LEGEND_HEIGHT, 1))))
    style: dict[str, Any] = {"fontsize": 13 * _pictures.POINT, "color": "white", "va": "center"}
    figure.text(4.0 / width, 0.5, f"−{scale:.3g}", **style)
    figure.text(1.0 - 4.0 / width, 0.5, f"+{scale:.3g} levels", ha="right", **style)
    picture = np.concatenate([diverging(difference / scale), np.asarray(_pictures.figure_image(figure))])
    return write_picture(Path(path), Image.fromarray(picture))
