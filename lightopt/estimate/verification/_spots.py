"""Spots: small places that are darker or brighter than predicted, on the part or fixed in the image."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Float32, Int32
from lightopt.core.transforms import Posture
from lightopt.estimate.verification._coarse import CoarsePrediction, Work
from lightopt.estimate.verification._fit import Fit
from lightopt.estimate.verification._lights import Compared
from lightopt.scene import project, view_from_part

LEAST_SCORE = 8.0  # of a spot, in standard deviations of the noise and of the rest of the image
SEEN_AGAIN = 0.5  # a spot shows in another posture where the score there is this share of the least one

SMOOTH_BLOCKS = 8.0  # what is wider than this is no spot
LARGEST_BLOCKS = 18
LEAST_FILL = 0.35  # share of its bounding box that a spot fills: edges of highlights that are off fill less
MOST_SPOTS = 12  # more in one posture are no dust, but a part that its model does not describe
NEAR_BLOCKS = 3


@dataclass(frozen=True)
class Spot:
    """A small place that differs.

    posture, row, column: A posture that shows it, and where in its image [block].
    where: ``part`` (moves with it), ``lens`` (fixed in the image), or ``unknown`` where one posture alone shows it.
    """

    posture: Posture
    row: int
    column: int
    score: float  # in standard deviations; below 0 where it is darker than predicted
    where: str = "unknown"


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
        places: dict[str, dict[Posture, tuple[float, float]]] = {"part": {}, "lens": {}}
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
    one: Spot,
    places: Mapping[Posture, tuple[float, float]],
    scores: Mapping[Posture, Float32],
    predictions: Mapping[Posture, CoarsePrediction],
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
