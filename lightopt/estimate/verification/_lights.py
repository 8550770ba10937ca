"""Predicted against captured, light by light: saturated areas, offset of the highlight, residual over noise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import sensor_scale
from lightopt.estimate.verification._coarse import CoarseImage, CoarsePrediction
from lightopt.estimate.verification._model import MISFIT_SHARE
from lightopt.estimate.verification._parameters import Parameters
from lightopt.optics import clipped_mean
from lightopt.scene import Scene

LEAST_BLOCKS = 12  # saturated areas smaller than this have no centre


@dataclass(frozen=True, kw_only=True)
class LightComparison:
    """Predicted against captured images of one light, all postures together.

    overlap: Intersection over union of the saturated areas; None where there are none.
    offset_px, offset_deg: How far the highlights lie from where they are predicted, in the image and as the angle
        between the directions that the surface mirrors there: by so much the light seems to be off. None likewise.
    residual: Root mean square of measured minus predicted, over that of the noise of the means of blocks.
    explained: The same with the faults that were found in the prediction.
    """

    light: str
    overlap: float | None
    offset_px: float | None
    offset_deg: float | None
    residual: float
    explained: float

    def as_dict(self) -> dict[str, Any]:
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}


@dataclass(frozen=True)
class Compared:
    """An image against its prediction, arrays of shape (h, w).

    difference: Measured minus predicted [sensor level], 0 where one of them is saturated or nothing is predicted.
    noise: Of the means of blocks [sensor level].
    misfit: What a model is off, of the right part on the right rig [sensor level].
    expected: Where the prediction is saturated.
    known: Where there is a difference.
    """

    image: CoarseImage
    difference: Float32
    noise: Float32
    misfit: Float32
    expected: Bool
    known: Bool

    @property
    def deviation(self) -> Float32:
        """The difference in standard deviations, of the noise and of what a model is off, 0 where unknown."""
        off = self.difference / np.hypot(self.noise, self.misfit)
        return np.where(self.known, off, 0.0).astype(np.float32)

    @property
    def key(self) -> tuple[Posture, str, float]:
        """Posture, light and exposure."""
        return self.image.source.posture, self.image.source.light, self.image.source.exposure


def compare_image(
    scene: Scene,
    parameters: Parameters,
    theta: Float64,
    image: CoarseImage,
    prediction: CoarsePrediction,
    good: tuple[CoarseImage, CoarsePrediction, Float64] | None = None,
) -> Compared:
    """Compare an image with a prediction at some parameters.

    good: The same image of a known good set with the prediction for it: what that is off is not counted.
    """
    mean, noise, expected = _delivered(scene, parameters, theta, image, prediction)
    known = prediction.clean & ~image.saturated & ~expected
    if good is not None:
        other, own, there = good
        predicted, more, _ = _delivered(scene, parameters, there, other, own)
        mean = mean + other.levels - predicted
        noise = np.hypot(noise, more)
        known &= own.clean & ~other.saturated
        expected = other.mostly
    difference = np.where(known, image.levels - mean, 0.0).astype(np.float32)
    misfit = MISFIT_SHARE * np.maximum(mean - scene.sensor.black_level, 0.0)
    return Compared(image, difference, noise.astype(np.float32), misfit.astype(np.float32), expected, known)


def _delivered(
    scene: Scene, parameters: Parameters, theta: Float64, image: CoarseImage, prediction: CoarsePrediction
) -> tuple[Float64, Float64, Bool]:
    # predicted sensor levels, the noise of the means of blocks, and where a pixel would be saturated
    sensor, o = scene.sensor, image.source
    log = theta[parameters.group("exposure").first] + theta[parameters.group("gain", o.light).first]
    signal = prediction.levels[o.light].astype(np.float64) * (sensor_scale(scene, o) * math.exp(log))
    black = sensor.black_level + float(theta[parameters.group("black").first])
    mean = np.zeros_like(signal)
    mean[prediction.clean], _ = clipped_mean(signal[prediction.clean] + black, sensor.read_noise_levels)
    noise = np.sqrt(sensor.noise_variance(signal) / image.count)
    expected = signal + black >= image.top - 0.5
    return mean, noise, expected


def compare_lights(
    scene: Scene,
    before: Sequence[Compared],
    after: Sequence[Compared],
    predictions: Mapping[Posture, CoarsePrediction],
    *,
    side: int,
) -> tuple[LightComparison, ...]:
    """Summaries by light, of the images against the prediction of the rig file and against that with its faults."""
    found: list[LightComparison] = []
    for light in dict.fromkeys(one.image.source.light for one in before):
        mine = [one for one in before if one.image.source.light == light]
        masks = [(o.expected & predictions[o.image.source.posture].hit, o.image.mostly) for o in mine]
        union = sum(int(np.count_nonzero(a | b)) for a, b in masks)
        common = sum(int(np.count_nonzero(a & b)) for a, b in masks)
        offsets = [
            (_offset(scene, predictions[o.image.source.posture], a, b), min(a.sum(), b.sum()))
            for o, (a, b) in zip(mine, masks, strict=True)
            if min(a.sum(), b.sum()) >= LEAST_BLOCKS
        ]
        weight = float(sum(w for _, w in offsets))
        pixels = side * sum(d[0] * w for d, w in offsets) / weight if offsets else None
        angle = sum(d[1] * w for d, w in offsets) / weight if offsets else None
        found.append(
            LightComparison(
                light=light,
                overlap=common / union if union >= LEAST_BLOCKS else None,
                offset_px=None if pixels is None else float(pixels),
                offset_deg=None if angle is None else float(angle),
                residual=_rms(mine),
                explained=_rms([one for one in after if one.image.source.light == light]),
            )
        )
    return tuple(found)


def _offset(scene: Scene, prediction: CoarsePrediction, expected: Bool, seen: Bool) -> tuple[float, float]:
    # between the centres of two areas [block], and between the mean directions that they mirror [deg]
    centres, directions = [], []
    for mask in (expected, seen & prediction.hit):
        if not mask.any():
            return 0.0, 0.0
        rows, columns = np.nonzero(mask)
        centres.append(np.array([rows.mean(), columns.mean()]))
        view = scene.camera.position - prediction.points[mask].astype(np.float64)
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        normal = prediction.normals[mask].astype(np.float64)
        mirrored = (2.0 * np.einsum("ij,ij->i", view, normal)[:, None] * normal - view).mean(axis=0)
        directions.append(mirrored / np.linalg.norm(mirrored))
    angle = math.degrees(math.acos(float(np.clip(directions[0] @ directions[1], -1.0, 1.0))))
    return float(np.linalg.norm(centres[0] - centres[1])), angle


def _rms(some: Sequence[Compared]) -> float:
    squares = [np.square(one.difference[one.known] / one.noise[one.known]) for one in some]
    joined = np.concatenate(squares) if squares else np.zeros(0)
    return float(np.sqrt(joined.mean())) if joined.size else 0.0
