"""Measured and predicted levels at some blocks of pixels, and how faults change what is predicted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import LEAST_R_D, LEAST_R_S, PixelSet, light_at, random_pixels, sensor_scale
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction, Work, blurred
from lightopt.estimate.verification._parameters import SIGMA_STEP, Group
from lightopt.optics import clipped_mean

MOST_ENTRIES = 2_500_000  # of the matrix of derivatives
BLOCKS = 1500  # blocks of each posture, if there are not too many images
MISFIT_SHARE = 0.01  # of the predicted level: models are no better than that, even of the right part

CLEAR = 4.0  # blocks that the model has this many standard deviations of a pixel below saturation are used

# blocks that change this many times as much as nine of ten do lie across the edge of a shadow: few of them would
# outweigh all others
STEEP = 15.0


CELLS = 24  # of neighbouring blocks, along the width of an image

BLUR_PX = 1.5  # blur for the difference


@dataclass(frozen=True)
class Linearised:
    """The model at some parameters: n rows, K parameters."""

    residual: Float64  # measured minus predicted [standard deviation], shape (n,)
    slope: Float64  # derivatives of what is predicted [standard deviation], shape (n, K)
    used: Bool  # rows that count, shape (n,)


class Model:
    """What the rig with some faults shows at n blocks of all images; arrays of shape (n,) unless said.

    Blocks are chosen at random, the same ones each time.

    measured: Level, black level included [sensor level].
    cell: Number of a cell of neighbouring blocks of an image.
    """

    def __init__(
        self, work: Work, images: Sequence[CoarseImage], predictions: Mapping[Posture, CoarsePrediction]
    ) -> None:
        self._work = work
        self.scene, self.parameters = work.coarse, work.parameters
        budget = int(min(BLOCKS, max(200, MOST_ENTRIES // (len(images) * self.parameters.size))))
        self._sets: list[PixelSet] = []  # of each posture
        columns: list[list[NDArray[Any]]] = []  # of each image
        for posture, prediction in predictions.items():
            mine = [n for n, image in enumerate(images) if image.source.posture == posture]
            row, column = random_pixels(prediction.clean, budget)
            if not len(row):
                continue
            levels = np.stack([images[n].levels[row, column] for n in mine]).astype(np.float64)
            full = np.stack([images[n].saturated[row, column] for n in mine])
            pixels = PixelSet(
                posture=posture,
                row=row,
                column=column,
                images=tuple(images[n].source for n in mine),
                levels=levels,
                saturated=full,
            )
            self._sets.append(pixels)
            width = max(8, prediction.clean.shape[1] // CELLS)
            for own, n in enumerate(mine):
                level = prediction.levels[images[n].source.light]
                change = (blurred(level, BLUR_PX / work.side) - level)[row, column].astype(np.float64) / BLUR_PX**2
                cell = n * 1e7 + (row // width) * 1000 + column // width
                top = images[n].top[row, column]
                columns.append([np.full(len(row), n), levels[own], top, ~full[own], cell, change])
        # blur: change of the grey level per px² of variance of a blur
        some = np.concatenate([np.zeros((6, 0)), *map(np.stack, columns)], axis=1)
        image, self.measured, self._top, unsaturated, cell, self._blur = some
        self._open = unsaturated > 0.0
        self.cell = np.unique(cell, return_inverse=True)[1].astype(np.int32)
        on = image.astype(np.intp)
        self._light = np.array([self.parameters.lights.index(i.source.light) for i in images], np.intp)[on]
        self._scale = np.array([sensor_scale(self.scene, i.source) for i in images])[on]
        self._count = np.array([float(i.count) for i in images])[on]
        self._corrected = False
        self._correction = np.zeros(len(on))

    def levels(self, theta: Float64) -> Float64:
        """Grey level of each row at exposure 1, its specular part, and the level with a lobe wider by SIGMA_STEP.

        Means over the blocks, shape (3, n); 0 off the part, NaN where only some of a panel is seen.
        """
        # the mean of a cubic over the centres of n pixels is that of its values at two points
        off = math.sqrt((1.0 - 1.0 / self._work.side**2) / 12.0)
        some = [self._levels_at(theta, x, y) for x, y in dict.fromkeys(product((-off, off), repeat=2))]
        blur = theta[self.parameters.nuisance[-1]] * self._blur
        return np.mean(some, axis=0) + np.stack([blur, np.zeros_like(blur), blur])

    def _levels_at(self, theta: Float64, x: float = 0.0, y: float = 0.0) -> Float64:
        # as `levels`, at a point so far off the middle of each block [block], without the blur
        own = self.scene.reflectance
        scale_s, scale_sigma = np.exp(theta[self.parameters.nuisance[:2]])
        sigmas = (own.sigma * scale_sigma, own.sigma * scale_sigma * (1.0 + SIGMA_STEP))
        out: list[Float64] = []
        for pixels in self._sets:
            view = self.parameters.view(self.scene, pixels.posture, theta)
            column, row = view.camera.axis_px
            view = replace(view, camera=replace(view.camera, principal_point=(column - x, row - y)))
            diffuse, specular = light_at(
                self.scene, pixels, view, self._work.caster, sigmas=sigmas, threads=self._work.run.threads
            )
            diffuse = max(own.R_d, LEAST_R_D) * diffuse.ravel()
            specular = max(own.R_s, LEAST_R_S) * scale_s * specular.reshape(2, -1)
            out.append(np.stack([diffuse + specular[0], specular[0], diffuse + specular[1]]))
        return np.concatenate([np.zeros((3, 0)), *out], axis=1)

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
        self._open &= good._open
        self._correction = good.measured - self.predicted(theta)[0]
        self._corrected = True

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
        slope[:, p.nuisance[2]] = unit * self._blur
        single = np.sqrt(sensor.noise_variance(np.maximum(mean - sensor.black_level, 0.0)))
        used = self._open & (mean + CLEAR * single < self._top)
        used &= np.isfinite(mean) & np.isfinite(slope).all(axis=1)
        for group in moving:
            if used.any():
                size = np.abs(slope[:, group.where]).max(axis=1)
                used &= ~(size > STEEP * np.quantile(size[used], 0.9))
        residual = np.where(used, (self.measured - np.where(used, mean, 0.0)) / noise, 0.0)
        return Linearised(residual, np.where(used[:, None], slope, 0.0) / np.where(used, noise, 1.0)[:, None], used)
