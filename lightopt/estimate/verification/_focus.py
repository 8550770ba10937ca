"""Focus: the blur at the part's outline, beyond that of the pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, stats

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.estimate.registration import PixelSet, light_at, sensor_scale
from lightopt.estimate.verification._coarse import Work, some_blocks
from lightopt.estimate.verification._fit import Fit

WIDTHS = (0.0, 1.0, 1.5, 2.5, 4.0)  # standard deviations of the blur that are compared [px]

PIXELS, RAYS = 300, 12  # of each posture, and of each pixel

LEAST_CORRELATION = 0.7  # images whose outline is not seen as predicted do not count


@dataclass(frozen=True, kw_only=True)
class _SpreadPixels(PixelSet):
    """Pixels with rays at given places [px], shape (n, rays)."""

    x: Float64
    y: Float64

    @property
    def positions(self) -> tuple[Float64, Float64]:
        return self.x.ravel(), self.y.ravel()


def outline_blur(work: Work, fit: Fit) -> float | None:
    """Standard deviation of the blur that fits best [px]; None where no outline is seen.

    Each image is compared up to its brightness and the level of its background.
    """
    scene, own = work.scene, work.scene.reflectance
    top = scene.sensor.saturated_from - scene.sensor.black_level
    # the same directions for all widths: a lattice of normal deviates, turned from pixel to pixel
    radius = np.sqrt(stats.chi2.ppf((np.arange(RAYS) + 0.5) / RAYS, 2))
    cost = np.zeros(len(WIDTHS))
    for posture, prediction in fit.predictions.items():
        mine = [image.source for image in fit.images if image.source.posture == posture]
        row, column = _outline_pixels(prediction.hit, work.side)
        if not len(row):
            continue
        angle = 2.0 * math.pi * (np.arange(RAYS) * 0.6180339887 + (np.arange(len(row)) * 0.4142135624)[:, None])
        view = work.parameters.view(scene, posture, fit.theta)
        levels = np.stack([o.levels[row, column] for o in mine]).astype(np.float64)
        full = np.stack([o.saturated[row, column] for o in mine])
        for number, width in enumerate(WIDTHS):
            spread = math.sqrt(width**2 + 1.0 / 12.0) * radius
            x = column[:, None] + 0.5 + spread * np.cos(angle)
            y = row[:, None] + 0.5 + spread * np.sin(angle)
            pixels = _SpreadPixels(
                posture=posture, row=row, column=column, images=tuple(mine), levels=levels, saturated=full, rays=RAYS,
                x=x, y=y,
            )  # fmt: skip
            diffuse, specular = light_at(
                scene, pixels, view, work.caster, sigmas=(own.sigma,), threads=work.run.threads
            )
            light = own.R_d * diffuse + own.R_s * specular[0]
            for k, o in enumerate(mine):
                known = np.isfinite(light[k]) & ~full[k]
                signal = np.minimum(light[k][known] * sensor_scale(scene, o), top)
                cost[number] += _unexplained(signal, levels[k][known])
    if not cost.any():
        return None
    best = int(np.argmin(cost))
    at = int(np.clip(best, 1, len(WIDTHS) - 2))
    bend, slope, _ = np.polyfit(np.square(WIDTHS[at - 1 : at + 2]), cost[at - 1 : at + 2], 2)
    if bend <= 0.0:
        return WIDTHS[best]
    return math.sqrt(float(np.clip(-0.5 * slope / bend, 0.0, WIDTHS[-1] ** 2)))


def _unexplained(model: Float64, measured: Float64) -> float:
    # share of the measured variance that the model leaves; at most that of an outline that is hardly seen
    if len(model) < PIXELS // 4 or np.ptp(model) == 0.0 or np.ptp(measured) == 0.0:
        return 0.0
    return 1.0 - max(float(np.corrcoef(model, measured)[0, 1]), LEAST_CORRELATION) ** 2


def _outline_pixels(hit: Bool, side: int) -> tuple[Int32, Int32]:
    # rows and columns of pixels in blocks next to the outline, one of each block
    edge = ndimage.binary_dilation(hit) & ~ndimage.binary_erosion(hit, border_value=1)
    row, column = some_blocks(np.asarray(edge, np.bool_), PIXELS)
    within = np.random.default_rng(0).integers(0, side, (2, len(row)), dtype=np.int32)
    return row * np.int32(side) + within[0], column * np.int32(side) + within[1]
