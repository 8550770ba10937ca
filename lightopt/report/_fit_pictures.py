"""Pictures of a fit: its ridge, the paper's sweep, measured minus predicted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lightopt.estimate.reflectance import FitResult, PaperDiffuse, PaperSpecular
from lightopt.report._canvas import write_picture
from lightopt.report._chart import ChartPanel, draw_chart
from lightopt.report._typeface import Typeface

RESIDUAL_SCALE = 0.08
"""Difference of the full colours, as a share of the sensor's full scale: 20 of 255 levels."""

RUNAWAY = 1e11
"""Where R_s runs away, no highlight of that width fits [grey level]; such points of the ridge are not drawn."""

LEGEND_HEIGHT = 24

_BELOW, _EQUAL, _ABOVE = (33, 102, 172), (247, 247, 247), (178, 24, 43)


def fit_chart(result: FitResult, place: Callable[[], Path]) -> Path | None:
    """Draw how a fit came about: the ridge of R_s and σ, or the rounds of the paper's procedure.

    Parameters
    ----------
    result
        The fit.
    place
        Called for the path of the PNG where there is something to draw.

    Returns
    -------
    pathlib.Path
        The file; None where there is nothing to draw.
    """
    if isinstance(result.paper, PaperSpecular):
        return _paper_sweep(result.paper, place())
    if isinstance(result.paper, PaperDiffuse):
        rounds = np.arange(1.0, len(result.paper.iterations) + 1.0)
        return draw_chart(
            place(),
            title="R_d, round by round (section 4.2)",
            x_label="round",
            x=rounds,
            panels=(
                ChartPanel(
                    label="R_d [grey level]", values=np.array([i[0] for i in result.paper.iterations])
                ),
                ChartPanel(
                    label="D, difference of the mean brightness [grey level]",
                    values=np.array([i[2] for i in result.paper.iterations]),
                ),
            ),
        )
    if result.kind == "diffuse" or result.estimate is None:
        return None
    scan = tuple(point for point in result.estimate.scan if point.R_s < RUNAWAY)
    if len(scan) < 3:
        return None
    sigma = np.array([point.sigma for point in scan])
    fall = 2.0 * (max(point.value for point in scan) - np.array([point.value for point in scan]))
    best = result.value("sigma_rad")
    mark = (best, result.value("R_s")) if "sigma_rad" in result.fitted else None
    interval = next((v.interval for v in result.values if v.name == "sigma_rad"), None)
    # an end that the images do not bound is that of the drawing
    span = None
    if interval is not None:
        low, high = (end or edge for end, edge in zip(interval, (sigma[0], sigma[-1]), strict=True))
        span = max(float(low), float(sigma[0])), min(float(high), float(sigma[-1]))
    described = result.estimate.describes
    what = "twice the log-likelihood" if described else "twice the log-likelihood of least squares"
    return draw_chart(
        place(),
        title="The ridge: at each sigma, the R_s that fits best, and how much worse it fits",
        x_label="sigma [rad]",
        x=sigma,
        log_x=True,
        panels=(
            ChartPanel(
                label="R_s [grey level]", values=np.array([point.R_s for point in scan]), log=True, mark=mark
            ),
            ChartPanel(
                label=f"{what} below the best, plus 1; the 95 % interval is shaded",
                values=fall + 1.0,
                log=True,
                mark=None if mark is None else (best, 1.0),
                span=span,
            ),
        ),
    )


def residual_picture(
    path: str | Path,
    *,
    measured: NDArray[np.float32],
    predicted: NDArray[np.float32],
    saturated_from: float,
    full: float,
) -> Path:
    """Write a PNG of measured minus predicted: blue darker than predicted, white equal, red brighter; legend below.

    Parameters
    ----------
    path
        The PNG, in a folder that exists.
    measured, predicted
        Sensor levels, shape (height, width); both are clipped at the saturation level first.
    saturated_from, full
        Saturation level and full scale of the sensor.
    """
    top = np.float32(saturated_from)
    difference = np.minimum(measured, top) - np.clip(predicted, 0.0, top)
    scale = RESIDUAL_SCALE * full
    bar = np.tile(np.linspace(-1.0, 1.0, difference.shape[1]), (LEGEND_HEIGHT, 1))
    image = Image.fromarray(_diverging(np.concatenate([difference / scale, bar])))
    face, baseline = Typeface(13), len(difference) + 17.0
    face.paint(image, 4.0, baseline, f"−{scale:.3g}", fill="#ffffff", align="left")
    face.paint(
        image, difference.shape[1] - 4.0, baseline, f"+{scale:.3g} levels", fill="#ffffff", align="right"
    )
    return write_picture(Path(path), image)


def _diverging(shares: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    channels = [
        np.interp(shares, [-1.0, 0.0, 1.0], [low, middle, high])
        for low, middle, high in zip(_BELOW, _EQUAL, _ABOVE, strict=True)
    ]
    return np.floor(np.stack(channels, axis=-1) + 0.5).astype(np.uint8)


def _paper_sweep(record: PaperSpecular, path: str | Path) -> Path:
    steps = sorted(record.steps, key=lambda step: step.sigma)
    sigma = np.array([step.sigma for step in steps])
    return draw_chart(
        path,
        title="The sweep over sigma (section 4.3)",
        x_label="sigma [rad]",
        x=sigma,
        panels=(
            ChartPanel(
                label="R_s at which as many pixels are saturated as measured, and its rounds (dots) [grey level]",
                values=np.array([max(step.R_s, 1e-3) for step in steps]),
                log=True,
                mark=(record.sigma, record.R_s),
                dots=np.array([[s.sigma, max(r_s, 1e-3)] for s in steps for r_s, _ in s.iterations]),
            ),
            ChartPanel(
                label="total specular brightness, simulated over measured",
                values=np.array([min(step.brightness, 10.0) for step in steps]),
            ),
            ChartPanel(
                label="rounds of equation 10",
                values=np.array([float(len(step.iterations)) for step in steps]),
            ),
        ),
    )
