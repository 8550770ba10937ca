"""Predicted against captured: saturated areas, offset of highlights, residual over noise, exchanged lights, spots.

Spots are small places that are darker or brighter than predicted, on the part or fixed in the image.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage, optimize

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import sensor_scale
from lightopt.estimate.verification._fit import MISFIT_SHARE, Fit
from lightopt.estimate.verification._parameters import CoarseImage, CoarsePrediction, Predictions, Work
from lightopt.optics import clipped_mean
from lightopt.scene import Scene, project, view_from_part

LEAST_BLOCKS = 12  # saturated areas smaller than this have no centre
# lights are exchanged if the correlation of the images that change rises by this on average
LEAST_GAIN = 0.1


@dataclass(frozen=True, kw_only=True)
class LightComparison:
    """Predicted against captured images of one light, all postures together."""

    light: str
    overlap: float | None  # intersection over union of the saturated areas; None where there are none
    # how far the highlights lie from where they are predicted, in the image and as the angle between the directions
    # that the surface mirrors there: by so much the light seems to be off. None likewise
    offset_px: float | None
    offset_deg: float | None
    residual: float  # root mean square of measured minus predicted, over that of the noise of the means of blocks
    explained: float  # the same with the faults that were found in the prediction

    def as_dict(self) -> dict[str, Any]:
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}


@dataclass(frozen=True)
class Compared:
    """An image against its prediction, arrays of shape (h, w)."""

    image: CoarseImage
    difference: Float32  # measured minus predicted [sensor level], 0 where one is saturated or nothing is predicted
    noise: Float32  # of the means of blocks [sensor level]
    deviation: Float32  # the difference in standard deviations of noise and of what a model of the right rig is off
    expected: Bool  # where the prediction is saturated
    known: Bool  # where there is a difference


def compare_image(
    work: Work, fit: Fit, good: Fit | None, number: int, theta: Float64, predictions: Predictions
) -> Compared:
    """Compare an image of a fit, by its number, with predictions at some parameters.

    good: Of a known good set: what the prediction for it is off is not counted.
    """
    image = fit.images[number]
    posture = image.source.posture
    mean, noise, expected = _delivered(work, theta, image, predictions[posture])
    known = predictions[posture].clean & ~image.saturated & ~expected
    if good is not None:
        other, own = good.images[number], good.predictions[posture]
        predicted, more, _ = _delivered(work, good.theta, other, own)
        mean = mean + other.levels - predicted
        noise = np.hypot(noise, more)
        known &= own.clean & ~other.saturated
        expected = other.mostly
    difference = np.where(known, image.levels - mean, 0.0)
    misfit = MISFIT_SHARE * np.maximum(mean - work.scene.sensor.black_level, 0.0)
    deviation = np.where(known, difference / np.hypot(noise, misfit), 0.0)
    difference, noise, deviation = (one.astype(np.float32) for one in (difference, noise, deviation))
    return Compared(image, difference, noise, deviation, expected, known)


def _delivered(
    work: Work, theta: Float64, image: CoarseImage, prediction: CoarsePrediction
) -> tuple[Float64, Float64, Bool]:
    # predicted sensor levels, the noise of the means of blocks, and where a pixel would be saturated
    p, sensor, o = work.parameters, work.scene.sensor, image.source
    log = theta[p.group("exposure").first] + theta[p.group("gain", o.light).first]
    signal = prediction.levels[o.light].astype(np.float64) * (sensor_scale(work.scene, o) * math.exp(log))
    black = sensor.black_level + float(theta[p.group("black").first])
    mean = np.zeros_like(signal)
    mean[prediction.clean], _ = clipped_mean(signal[prediction.clean] + black, sensor.read_noise_levels)
    return mean, np.sqrt(sensor.noise_variance(signal) / image.count), signal + black >= image.top - 0.5


def compare_lights(
    work: Work, before: Sequence[Compared], after: Sequence[Compared], predictions: Predictions
) -> tuple[LightComparison, ...]:
    """Summaries by light, of the images against the prediction of the rig file and against that with its faults."""
    found: list[LightComparison] = []
    for light in dict.fromkeys(one.image.source.light for one in before):
        union, common = 0, 0
        offsets: list[tuple[float, float]] = []
        weights: list[int] = []
        mine = [one for one in before if one.image.source.light == light]
        for one in mine:
            prediction = predictions[one.image.source.posture]
            areas = (one.expected & prediction.hit, one.image.mostly)
            union += int(np.count_nonzero(areas[0] | areas[1]))
            common += int(np.count_nonzero(areas[0] & areas[1]))
            least = int(min(area.sum() for area in areas))
            seen = areas[1] & prediction.hit
            if least >= LEAST_BLOCKS and seen.any():
                offsets.append(_offset(work, prediction, areas[0], seen))
                weights.append(least)
        offset = np.average(offsets, axis=0, weights=weights).tolist() if offsets else (None, None)
        found.append(
            LightComparison(
                light=light,
                overlap=common / union if union >= LEAST_BLOCKS else None,
                offset_px=offset[0],
                offset_deg=offset[1],
                residual=_rms(mine),
                explained=_rms([one for one in after if one.image.source.light == light]),
            )
        )
    return tuple(found)


def _offset(work: Work, prediction: CoarsePrediction, expected: Bool, seen: Bool) -> tuple[float, float]:
    # between the centres of two areas [px], and between the mean directions that they mirror [deg]
    centres, directions = [], []
    for mask in (expected, seen):
        centres.append(np.mean(np.nonzero(mask), axis=1))
        view = work.scene.camera.position - prediction.points[mask].astype(np.float64)
        view /= np.linalg.norm(view, axis=1, keepdims=True)
        normal = prediction.normals[mask].astype(np.float64)
        mirrored = (2.0 * np.einsum("ij,ij->i", view, normal)[:, None] * normal - view).mean(axis=0)
        directions.append(mirrored / np.linalg.norm(mirrored))
    angle = math.degrees(math.acos(float(np.clip(directions[0] @ directions[1], -1.0, 1.0))))
    return work.side * float(np.linalg.norm(centres[0] - centres[1])), angle


def _rms(some: Sequence[Compared]) -> float:
    ratio = np.concatenate([np.zeros(0), *(one.difference[one.known] / one.noise[one.known] for one in some)])
    return float(np.sqrt(np.mean(np.square(ratio)))) if ratio.size else 0.0


def exchanged_lights(scene: Scene, images: Sequence[CoarseImage], predictions: Predictions) -> dict[str, str]:
    """For each light whose image shows another one the name of that other one; empty if all are as named.

    By correlation over all postures of the images with the predictions of all lights; each light is shown once.
    """
    names = list(dict.fromkeys(image.source.light for image in images))
    if len(names) < 2:
        return {}
    total = np.zeros((len(names), len(names)))
    for posture, prediction in predictions.items():
        clean = prediction.clean
        # of several exposures of a light the longest
        mine = sorted((i for i in images if i.source.posture == posture), key=lambda i: i.source.exposure)
        longest = {image.source.light: image for image in mine}
        if len(longest) < len(names) or not clean.any():
            continue
        for a, name in enumerate(names):
            image = longest[name]
            top, scale = image.top[clean], sensor_scale(scene, image.source)
            seen = np.minimum(image.levels[clean], top)
            for b, other in enumerate(names):
                model = np.minimum(prediction.levels[other][clean] * scale + scene.sensor.black_level, top)
                if np.ptp(seen) > 0.0 and np.ptp(model) > 0.0:
                    total[a, b] += np.corrcoef(seen, model)[0, 1]
    shown, real = optimize.linear_sum_assignment(-total)
    changed = [(a, b) for a, b in zip(shown, real, strict=True) if a != b]
    gain = sum(total[a, b] - total[a, a] for a, b in changed)
    enough = gain > LEAST_GAIN * len(changed) * len(predictions)
    return {names[a]: names[b] for a, b in changed} if enough else {}


def renamed(images: Sequence[CoarseImage], exchanged: Mapping[str, str]) -> tuple[CoarseImage, ...]:
    return tuple(
        replace(image, source=replace(image.source, light=exchanged.get(image.source.light, image.source.light)))
        for image in images
    )


LEAST_SCORE = 8.0  # of a spot, in standard deviations of the noise and of the rest of the image
SEEN_AGAIN = 0.5  # a spot shows in another posture where the score there is this share of the least one
SMOOTH_BLOCKS = 8.0  # what is wider than this is no spot
LARGEST_BLOCKS = 18
LEAST_FILL = 0.35  # share of its bounding box that a spot fills: edges of highlights that are off fill less
MOST_SPOTS = 12  # more in one posture are no dust, but a part that its model does not describe
NEAR_BLOCKS = 3
_Place = tuple[float, float]  # row and column [block]


@dataclass(frozen=True)
class Spot:
    posture: Posture  # one that shows it, and where in its image [block]
    row: int
    column: int
    score: float  # in standard deviations; below 0 where it is darker than predicted
    where: str = "unknown"  # `part` (moves with it), `lens` (fixed in the image); unknown: one posture shows it


def find_spots(work: Work, fit: Fit, images: Sequence[Compared]) -> tuple[tuple[Spot, ...], bool]:
    """Spots in the images of a fit, and whether there were too many to be dust."""
    scores: dict[Posture, Float32] = {}
    for posture, prediction in fit.predictions.items():
        residuals = [one.deviation for one in images if one.image.source.posture == posture]
        if residuals:
            scores[posture] = _score(residuals, prediction)
    found = [_candidates(posture, score) for posture, score in scores.items()]
    if any(len(some) > MOST_SPOTS for some in found):
        return (), True
    spots: list[Spot] = []
    explained: list[tuple[Posture, float, float]] = []
    for one in sorted(itertools.chain.from_iterable(found), key=lambda c: -abs(c.score)):
        beside = [max(abs(y - one.row), abs(x - one.column)) for p, y, x in explained if p == one.posture]
        if min(beside, default=np.inf) <= 2 * NEAR_BLOCKS:
            continue
        world = fit.predictions[one.posture].points[one.row, one.column].astype(np.float64)
        own = view_from_part(work.coarse, one.posture)
        point = (world - own.translation) @ own.rotation
        # where the other postures show it
        places: dict[str, dict[Posture, _Place]] = {"part": {}, "lens": {}}
        for p in scores:
            x, y, _ = project(work.parameters.view(work.coarse, p, fit.theta).camera, point[None])
            places["part"][p] = float(y[0]) - 0.5, float(x[0]) - 0.5
            places["lens"][p] = float(one.row), float(one.column)
        again = {name: _seen_again(one, at, scores, fit.predictions) for name, at in places.items()}
        where, name = "unknown", "part"
        if any(again.values()):
            share = {name: sum(seen) / max(len(seen), 1) for name, seen in again.items()}
            where = name = max(share, key=lambda name: share[name])
            if share[name] < 0.5:
                continue
        explained += [(p, *at) for p, at in places[name].items()]
        spots.append(replace(one, where=where))
    return tuple(spots), False


def _score(residuals: Sequence[Float32], prediction: CoarsePrediction) -> Float32:
    # sum over the lights that show a place, less its smooth surroundings, in units of its own scatter
    count = sum((r != 0.0).astype(np.float32) for r in residuals)
    total = sum(residuals) / np.sqrt(np.maximum(count, 1.0))
    valid = (count > 0.0) & prediction.clean
    if not valid.any():
        return np.zeros(valid.shape, np.float32)
    total = np.where(valid, total, 0.0)
    weight = ndimage.gaussian_filter(valid.astype(np.float32), SMOOTH_BLOCKS)
    around = ndimage.gaussian_filter(np.clip(total, -LEAST_SCORE, LEAST_SCORE), SMOOTH_BLOCKS)
    score = np.where(valid, total - around / np.maximum(weight, 1e-3), 0.0)
    scatter = max(1.0, 1.4826 * float(np.median(np.abs(score[valid]))))
    return (score / scatter).astype(np.float32)


def _candidates(posture: Posture, score: Float32) -> list[Spot]:
    found: list[Spot] = []
    for sign in (-1.0, 1.0):
        labels: Int32 = np.empty(score.shape, np.int32)
        ndimage.label(sign * score > 0.5 * LEAST_SCORE, structure=np.ones((3, 3)), output=labels)
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            inside = labels[box] == number
            best = float((sign * score[box])[inside].max())
            small = max(inside.shape) <= LARGEST_BLOCKS and inside.sum() >= max(3.0, LEAST_FILL * inside.size)
            if small and best >= LEAST_SCORE:
                centre = np.average(np.nonzero(inside), axis=1, weights=np.abs(score[box][inside]))
                row, column = (axis.start + round(float(at)) for axis, at in zip(box, centre, strict=True))
                found.append(Spot(posture, row, column, sign * best))
    return found


def _seen_again(
    one: Spot, places: Mapping[Posture, _Place], scores: Mapping[Posture, Float32], predictions: Predictions
) -> list[bool]:
    # of each other posture that could show it at the given place, whether it does
    seen: list[bool] = []
    sign, n = np.sign(one.score), NEAR_BLOCKS
    for posture, place in places.items():
        if posture == one.posture or not np.isfinite(place).all():
            continue
        row, column = (round(at) for at in place)
        clean, score = predictions[posture].clean, scores[posture]
        if not (n <= row < clean.shape[0] - n and n <= column < clean.shape[1] - n):
            continue
        window = slice(row - n, row + n + 1), slice(column - n, column + n + 1)
        if clean[row, column] and np.count_nonzero(score[window]) > 0.7 * score[window].size:
            seen.append(bool((sign * score[window]).max() >= SEEN_AGAIN * LEAST_SCORE))
    return seen
