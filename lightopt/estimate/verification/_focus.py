"""Focus: the blur at the part's outline, beyond that of the pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, stats

from lightopt.core.arrays import Bool, Float64
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, PixelSet, light_at, sensor_scale
from lightopt.estimate.verification._coarse import CoarsePrediction, some_blocks
from lightopt.estimate.verification._parameters import Parameters
from lightopt.geometry import RayCaster
from lightopt.scene import Scene

WIDTHS = (0.0, 1.0, 1.5, 2.5, 4.0)
"""Standard deviations of the blur that are compared [px]."""

PIXELS, RAYS = 300, 12  # of each posture, and of each pixel

LEAST_CORRELATION = 0.7  # images whose outline is not seen as predicted do not count


@dataclass(frozen=True, kw_only=True)
class _SpreadPixels(PixelSet):
    """Pixels with rays at given places [px], shape (n · rays,)."""

    x: Float64
    y: Float64

    @property
    def positions(self) -> tuple[Float64, Float64]:
        return self.x, self.y


def outline_blur(
    scene: Scene,
    parameters: Parameters,
    theta: Float64,
    observations: Sequence[Observation],
    predictions: Mapping[Posture, CoarsePrediction],
    *,
    caster: RayCaster,
    side: int,
    threads: int | None = None,
) -> float | None:
    """Standard deviation of the blur that fits best [px]; None where no outline is seen.

    Each image is compared up to its brightness and the level of its background.

    scene: With the camera as it is; side: Of the blocks of the predictions [px].
    """
    cost = np.zeros(len(WIDTHS))
    for posture, prediction in predictions.items():
        mine = [o for o in observations if o.posture == posture]
        row, column = _outline_pixels(prediction.hit, side)
        if not len(row):
            continue
        view = parameters.view(scene, posture, theta)
        # the same directions for all widths: a lattice of normal deviates, turned from pixel to pixel
        angle = 2.0 * math.pi * (np.arange(RAYS) * 0.6180339887 + (np.arange(len(row)) * 0.4142135624)[:, None])
        radius = np.sqrt(stats.chi2.ppf((np.arange(RAYS) + 0.5) / RAYS, 2))
        levels = np.stack([o.levels[row, column] for o in mine]).astype(np.float64)
        full = np.stack([o.saturated[row, column] for o in mine])
        for number, width in enumerate(WIDTHS):
            spread = math.sqrt(width**2 + 1.0 / 12.0) * radius
            pixels = _SpreadPixels(
                posture=posture, row=row, column=column, images=tuple(mine), levels=levels, saturated=full, rays=RAYS,
                x=(column[:, None] + 0.5 + spread * np.cos(angle)).ravel(),
                y=(row[:, None] + 0.5 + spread * np.sin(angle)).ravel(),
            )  # fmt: skip
            own = scene.reflectance
            diffuse, specular = light_at(scene, pixels, view, caster, sigmas=(own.sigma,), threads=threads)
            light = own.R_d * diffuse + own.R_s * specular[0]
            for k, o in enumerate(mine):
                top = scene.sensor.saturated_from - scene.sensor.black_level
                known = np.isfinite(light[k]) & ~full[k]
                signal = np.minimum(light[k][known] * sensor_scale(scene, o), top)
                cost[number] += _unexplained(signal, levels[k][known])
    if not cost.any():
        return None
    at = int(np.clip(np.argmin(cost), 1, len(WIDTHS) - 2))
    squares = np.square(WIDTHS[at - 1 : at + 2])
    bend, slope, _ = np.polyfit(squares, cost[at - 1 : at + 2], 2)
    best = (
        float(np.clip(-0.5 * slope / bend, 0.0, WIDTHS[-1] ** 2)) if bend > 0.0 else WIDTHS[int(np.argmin(cost))] ** 2
    )
    return math.sqrt(best)


def _unexplained(model: Float64, measured: Float64) -> float:
    # share of the measured variance that the model leaves; at most that of an outline that is hardly seen
    if len(model) < PIXELS // 4 or np.ptp(model) == 0.0 or np.ptp(measured) == 0.0:
        return 0.0
    correlation = float(np.corrcoef(model, measured)[0, 1])
    return 1.0 - max(correlation, LEAST_CORRELATION) ** 2


def _outline_pixels(hit: Bool, side: int) -> tuple[np.ndarray, np.ndarray]:
    # rows and columns of pixels in blocks next to the outline, one of each block
    wide = np.asarray(ndimage.binary_dilation(hit), np.bool_)
    narrow = np.asarray(ndimage.binary_erosion(hit, border_value=1), np.bool_)
    row, column = some_blocks(wide & ~narrow, PIXELS)
    within = np.random.default_rng(0).integers(0, side, (2, len(row)), dtype=np.int32)
    return row * np.int32(side) + within[0], column * np.int32(side) + within[1]
