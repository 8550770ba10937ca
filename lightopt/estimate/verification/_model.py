"""Measured and predicted levels at some blocks of pixels, and how faults change what is predicted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import light_at, sensor_scale
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction
from lightopt.estimate.verification._parameters import SIGMA_STEP, Parameters
from lightopt.estimate.verification._rows import choose_rows
from lightopt.geometry import RayCaster
from lightopt.optics import clipped_mean
from lightopt.scene import Scene

MOST_ENTRIES = 2_500_000  # of the matrix of derivatives
BLOCKS = 1500  # blocks of each posture, if there are not too many images
MISFIT_SHARE = 0.01  # of the predicted level: models are no better than that, even of the right part

CLEAR = 4.0  # blocks that the model has this many standard deviations of a pixel below saturation are used

# blocks that change this many times as much as nine of ten do lie across the edge of a shadow: few of them would
# outweigh all others
STEEP = 15.0


@dataclass(frozen=True)
class Linearised:
    """The model at some parameters: n rows, K parameters.

    residual: Measured minus predicted [standard deviation], shape (n,).
    slope: Derivatives of what is predicted [standard deviation], shape (n, K).
    used: Rows that count, shape (n,).
    """

    residual: Float64
    slope: Float64
    used: Bool


class Model:
    """What the rig with some faults shows at the chosen blocks."""

    def __init__(
        self,
        scene: Scene,
        parameters: Parameters,
        images: Sequence[CoarseImage],
        predictions: Mapping[Posture, CoarsePrediction],
        *,
        caster: RayCaster,
        side: int,
        threads: int | None = None,
    ) -> None:
        self._side = side
        self.scene, self.parameters, self._caster, self._threads = scene, parameters, caster, threads
        self.images = tuple(images)
        self._light = np.array([parameters.lights.index(i.source.light) for i in images], np.intp)
        self._scale = np.array([sensor_scale(scene, i.source) for i in images])
        self._count = np.array([float(i.count) for i in images])
        self.correction = np.zeros(0)
        budget = int(min(BLOCKS, max(200, MOST_ENTRIES // (len(images) * parameters.size))))
        self.rows = choose_rows(images, predictions, budget=budget, side=side)
        self._open = self.rows.unsaturated.copy()

    def levels(self, theta: Float64, *, exact: bool = True) -> tuple[Float64, Float64, Float64]:
        """Grey level of each row at exposure 1, its specular part, and the level with a lobe wider by SIGMA_STEP.

        Each of shape (n,); 0 off the part, NaN where only some of a panel is seen.

        exact: Whether it is the mean over the block, and not the level in its middle.
        """
        # the mean of a cubic over the centres of n pixels is that of its values at two points
        off = math.sqrt((1.0 - 1.0 / self._side**2) / 12.0)
        if not exact:
            level, specular, wider = self._levels(theta, 0.0, 0.0)
            return level, specular, wider
        some = [self._levels(theta, x, y) for x, y in dict.fromkeys(product((-off, off), repeat=2))]
        level, specular, wider = np.mean(some, axis=0)
        blur = theta[self.parameters.nuisance[-1]] * self.rows.blur
        return level + blur, specular, wider + blur

    def _levels(self, theta: Float64, x: float, y: float) -> Float64:
        # as `levels`, so far off the middle of each block [block]; shape (3, n)
        own = self.scene.reflectance
        scale_s, scale_sigma = np.exp(theta[self.parameters.nuisance[:2]])
        sigma = own.sigma * scale_sigma
        out = np.zeros((3, len(self.rows.image)))
        first = 0
        for pixels, numbers in zip(self.rows.sets, self.rows.numbers, strict=True):
            view = self.parameters.view(self.scene, pixels.posture, theta)
            column, row = view.camera.axis_px
            view = replace(view, camera=replace(view.camera, principal_point=(column - x, row - y)))
            diffuse, specular = light_at(
                self.scene,
                pixels,
                view,
                self._caster,
                sigmas=(sigma, sigma * (1.0 + SIGMA_STEP)),
                threads=self._threads,
            )
            size = len(numbers) * len(pixels.row)
            own_rows = slice(first, first + size)
            out[1, own_rows] = own.R_s * scale_s * specular[0].ravel()
            out[0, own_rows] = own.R_d * diffuse.ravel() + out[1, own_rows]
            out[2, own_rows] = own.R_d * diffuse.ravel() + own.R_s * scale_s * specular[1].ravel()
            first += size
        return out

    def delivered(self, theta: Float64, level: Float64) -> tuple[Float64, Float64, Float64]:
        """What the camera delivers of grey levels, its change per sensor level of light, and its noise; shape (n,)."""
        p, sensor = self.parameters, self.scene.sensor
        gains = np.array([theta[p.group("gain", name).first] for name in p.lights])
        bright = np.exp(theta[p.group("exposure").first] + gains)[self._light] * self._scale
        signal = bright[self.rows.image] * level
        black = sensor.black_level + float(theta[p.group("black").first])
        mean, share = clipped_mean(signal + black, sensor.read_noise_levels)
        noise = sensor.noise_variance(signal) / self._count[self.rows.image] + np.square(MISFIT_SHARE * signal)
        if len(self.correction):
            noise = noise + sensor.noise_variance(signal) / self._count[self.rows.image]
        return mean, share, np.sqrt(noise)

    def predicted(self, theta: Float64) -> tuple[Float64, Float64]:
        """Level of each row with the correction by a baseline, and its noise [sensor level], shape (n,)."""
        mean, _, noise = self.delivered(theta, self.levels(theta)[0])
        return (mean + self.correction if len(self.correction) else mean), noise

    def correct(self, good: Model, theta: Float64) -> None:
        """Let the prediction at some parameters be what a known good set shows at the same blocks."""
        same = len(good.rows.measured) == len(self.rows.measured)  # else only one of them has a black background
        on_part = [~model.rows.background for model in (self, good)]
        measured = np.full(len(self.rows.measured), np.nan)
        own, there = (slice(None), slice(None)) if same else on_part
        measured[own] = good.rows.measured[there]
        self._open[own] &= good._open[there]
        self.correction = measured - self.predicted(theta)[0]

    def with_black_level(self, theta: Float64) -> Float64:
        """Parameters with the black level that the background shows, if it shows one."""
        none = self.rows.background
        if not none.any():
            return theta
        level = float(self.rows.measured[none].mean())
        # the mean of clipped levels has no simple inverse
        trials = np.linspace(-5.0, level + 1.0, 2000)
        shown, _ = clipped_mean(trials, self.scene.sensor.read_noise_levels)
        black = float(np.interp(level, shown, trials)) - self.scene.sensor.black_level
        theta = theta.copy()
        theta[self.parameters.group("black").first] = black
        return theta

    def linearise(self, theta: Float64) -> Linearised:
        """Residuals and derivatives at some parameters."""
        p = self.parameters
        level, specular, wider = self.levels(theta)
        middle = self.levels(theta, exact=False)[0]
        mean, share, noise = self.delivered(theta, level)
        if len(self.correction):
            mean = mean + self.correction
        on = self.rows.image
        gains = np.array([theta[p.group("gain", name).first] for name in p.lights])
        bright = (np.exp(theta[p.group("exposure").first] + gains)[self._light] * self._scale)[on]
        unit = share * bright  # sensor level delivered per grey level
        slope = np.zeros((len(on), p.size))
        light = self._light[on]
        for group in p.groups:
            own = light == p.lights.index(group.light) if group.light else np.ones(len(on), np.bool_)
            if group.kind in ("exposure", "gain"):
                slope[own, group.first] = (unit * level)[own]
            elif group.kind == "black":
                slope[:, group.first] = share
        # panels are moved all at once: each image is of one of them
        of_panels = [[g for g in p.groups if g.kind == kind] for kind in ("panel_shift", "panel_turn")]
        moves = [*([g] for g in p.groups if g.step > 0.0 and not g.light), *of_panels]
        for together in moves:
            for axis in range(together[0].size):
                there = theta.copy()
                there[[g.first + axis for g in together]] += together[0].step
                change = unit * (self.levels(there, exact=False)[0] - middle) / together[0].step
                for group in together:
                    own = light == p.lights.index(group.light) if group.light else np.ones(len(on), np.bool_)
                    slope[own, group.first + axis] = change[own]
        slope[:, p.nuisance[0]] = unit * specular
        slope[:, p.nuisance[1]] = unit * (wider - level) / math.log1p(SIGMA_STEP)
        slope[:, p.nuisance[2]] = unit * self.rows.blur
        sensor = self.scene.sensor
        single = np.sqrt(sensor.noise_variance(np.maximum(mean - sensor.black_level, 0.0)))
        used = self._open & (mean + CLEAR * single < self.rows.top)
        used &= np.isfinite(mean) & np.isfinite(slope).all(axis=1)
        for group in p.groups:
            if group.step > 0.0 and used.any():
                size = np.abs(slope[:, group.where]).max(axis=1)
                used &= ~(size > STEEP * np.quantile(size[used], 0.9))
        residual = np.where(used, (self.rows.measured - np.where(used, mean, 0.0)) / noise, 0.0)
        return Linearised(residual, np.where(used[:, None], slope, 0.0) / np.where(used, noise, 1.0)[:, None], used)
