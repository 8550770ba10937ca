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
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction, Work
from lightopt.estimate.verification._parameters import SIGMA_STEP, Group
from lightopt.estimate.verification._rows import choose_rows
from lightopt.optics import clipped_mean

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
    """What the rig with some faults shows at the chosen blocks; arrays of shape (n,) unless said."""

    def __init__(
        self, work: Work, images: Sequence[CoarseImage], predictions: Mapping[Posture, CoarsePrediction]
    ) -> None:
        self._work = work
        self.scene, self.parameters = work.coarse, work.parameters
        budget = int(min(BLOCKS, max(200, MOST_ENTRIES // (len(images) * self.parameters.size))))
        self.rows = choose_rows(images, predictions, budget=budget, side=work.side)
        on = self.rows.image
        self._light = np.array([self.parameters.lights.index(i.source.light) for i in images], np.intp)[on]
        self._scale = np.array([sensor_scale(self.scene, i.source) for i in images])[on]
        self._count = np.array([float(i.count) for i in images])[on]
        self._corrected = False
        self._correction = np.zeros(len(on))
        self._open = self.rows.unsaturated.copy()

    def levels(self, theta: Float64) -> Float64:
        """Grey level of each row at exposure 1, its specular part, and the level with a lobe wider by SIGMA_STEP.

        Means over the blocks, shape (3, n); 0 off the part, NaN where only some of a panel is seen.
        """
        # the mean of a cubic over the centres of n pixels is that of its values at two points
        off = math.sqrt((1.0 - 1.0 / self._work.side**2) / 12.0)
        some = [self._levels_at(theta, x, y) for x, y in dict.fromkeys(product((-off, off), repeat=2))]
        blur = theta[self.parameters.nuisance[-1]] * self.rows.blur
        return np.mean(some, axis=0) + np.stack([blur, np.zeros_like(blur), blur])

    def _levels_at(self, theta: Float64, x: float = 0.0, y: float = 0.0) -> Float64:
        # as `levels`, at a point so far off the middle of each block [block], without the blur
        own = self.scene.reflectance
        scale_s, scale_sigma = np.exp(theta[self.parameters.nuisance[:2]])
        sigmas = (own.sigma * scale_sigma, own.sigma * scale_sigma * (1.0 + SIGMA_STEP))
        out: list[Float64] = []
        for pixels in self.rows.sets:
            view = self.parameters.view(self.scene, pixels.posture, theta)
            column, row = view.camera.axis_px
            view = replace(view, camera=replace(view.camera, principal_point=(column - x, row - y)))
            diffuse, specular = light_at(
                self.scene, pixels, view, self._work.caster, sigmas=sigmas, threads=self._work.run.threads
            )
            diffuse, specular = own.R_d * diffuse.ravel(), own.R_s * scale_s * specular.reshape(2, -1)
            out.append(np.stack([diffuse + specular[0], specular[0], diffuse + specular[1]]))
        black = np.zeros((3, int(np.count_nonzero(self.rows.background))))
        return np.concatenate([*out, black], axis=1)

    def _unit(self, theta: Float64) -> Float64:
        # sensor levels per grey level
        p = self.parameters
        gains = np.array([theta[p.group("gain", name).first] for name in p.lights])
        return np.exp(theta[p.group("exposure").first] + gains)[self._light] * self._scale

    def _delivered(self, theta: Float64, level: Float64) -> tuple[Float64, Float64, Float64]:
        # what the camera delivers of grey levels, its change per sensor level of light, and its noise
        sensor = self.scene.sensor
        signal = self._unit(theta) * level
        black = sensor.black_level + float(theta[self.parameters.group("black").first])
        mean, share = clipped_mean(signal + black, sensor.read_noise_levels)
        sets = 2.0 if self._corrected else 1.0
        noise = sets * sensor.noise_variance(signal) / self._count + np.square(MISFIT_SHARE * signal)
        return mean + self._correction, share, np.sqrt(noise)

    def predicted(self, theta: Float64) -> tuple[Float64, Float64]:
        """Level of each row with the correction by a baseline, and its noise [sensor level]."""
        mean, _, noise = self._delivered(theta, self.levels(theta)[0])
        return mean, noise

    def correct(self, good: Model, theta: Float64) -> None:
        """Let the prediction at some parameters be what a known good set shows at the same blocks."""
        own, there = (np.ones(len(model.rows.measured), np.bool_) for model in (self, good))
        if len(own) != len(there):  # only one of them has a black background
            own, there = ~self.rows.background, ~good.rows.background
        measured = np.full(len(own), np.nan)
        measured[own] = good.rows.measured[there]
        self._open[own] &= good._open[there]
        self._correction = measured - self.predicted(theta)[0]
        self._corrected = True

    def with_black_level(self, theta: Float64) -> Float64:
        """Parameters with the black level that the background shows, if it shows one."""
        none = self.rows.background
        if not none.any():
            return theta
        level = float(self.rows.measured[none].mean())
        # the mean of clipped levels has no simple inverse
        trials = np.linspace(-5.0, level + 1.0, 2000)
        shown, _ = clipped_mean(trials, self.scene.sensor.read_noise_levels)
        theta = theta.copy()
        black = self.parameters.group("black").first
        theta[black] = float(np.interp(level, shown, trials)) - self.scene.sensor.black_level
        return theta

    def linearise(self, theta: Float64) -> Linearised:
        """Residuals and derivatives at some parameters."""
        p, sensor = self.parameters, self.scene.sensor
        level, specular, wider = self.levels(theta)
        middle = self._levels_at(theta)[0]
        mean, share, noise = self._delivered(theta, level)
        unit = share * self._unit(theta)  # sensor level delivered per grey level
        slope = np.zeros((len(level), p.size))

        def rows_of(group: Group) -> Bool:
            return self._light == p.lights.index(group.light) if group.light else np.ones(len(level), np.bool_)

        for group in p.groups:
            if group.kind == "black":
                slope[:, group.first] = share
            elif group.step == 0.0:
                slope[:, group.first] = np.where(rows_of(group), unit * level, 0.0)
        # panels are moved all at once: each image is of one of them
        moving = [group for group in p.groups if group.step > 0.0]
        for kind in dict.fromkeys(group.kind for group in moving):
            together = [group for group in moving if group.kind == kind]
            for axis in range(together[0].size):
                there = theta.copy()
                there[[group.first + axis for group in together]] += together[0].step
                change = unit * (self._levels_at(there)[0] - middle) / together[0].step
                for group in together:
                    slope[:, group.first + axis] = np.where(rows_of(group), change, 0.0)
        slope[:, p.nuisance[0]] = unit * specular
        slope[:, p.nuisance[1]] = unit * (wider - level) / math.log1p(SIGMA_STEP)
        slope[:, p.nuisance[2]] = unit * self.rows.blur
        single = np.sqrt(sensor.noise_variance(np.maximum(mean - sensor.black_level, 0.0)))
        used = self._open & (mean + CLEAR * single < self.rows.top)
        used &= np.isfinite(mean) & np.isfinite(slope).all(axis=1)
        for group in moving:
            if used.any():
                size = np.abs(slope[:, group.where]).max(axis=1)
                used &= ~(size > STEEP * np.quantile(size[used], 0.9))
        residual = np.where(used, (self.rows.measured - np.where(used, mean, 0.0)) / noise, 0.0)
        return Linearised(residual, np.where(used[:, None], slope, 0.0) / np.where(used, noise, 1.0)[:, None], used)
