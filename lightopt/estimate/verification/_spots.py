"""Spots: small places that are darker or brighter than predicted, on the part or fixed in the image."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Float32, Float64, Int32
from lightopt.core.transforms import Posture
from lightopt.estimate.verification._coarse import CoarsePrediction
from lightopt.estimate.verification._parameters import Parameters
from lightopt.scene import Scene, project, view_from_part

LEAST_SCORE = 8.0  # of a spot, in standard deviations of the noise and of the rest of the image
SEEN_AGAIN = 0.5  # a spot shows in another posture where the score there is this share of the least one

SMOOTH_BLOCKS = 8.0  # what is wider than this is no spot
LARGEST_BLOCKS = 18
LEAST_FILL = 0.35  # share of its bounding box that a spot fills: edges of highlights that are off fill less
MOST_SPOTS = 12  # more in one posture are no dust, but a part that its model does not describe
NEAR_BLOCKS = 3


@dataclass(frozen=True, kw_only=True)
class Spot:
    """A small place that differs.

    where: ``part`` (moves with it), ``lens`` (fixed in the image), or ``unknown`` where one posture alone shows it.
    posture, column, row: A posture that shows it, and where in its image [px].
    point: In the part frame [mm].
    darker: Whether it is darker than predicted.
    """

    where: str
    posture: Posture
    column: float
    row: float
    point: tuple[float, float, float]
    darker: bool
    score: float


@dataclass(frozen=True)
class _Candidate:
    posture: Posture
    row: int
    column: int
    score: float


def find_spots(
    scene: Scene,
    parameters: Parameters,
    theta: Float64,
    residuals: Mapping[Posture, Sequence[Float32]],
    predictions: Mapping[Posture, CoarsePrediction],
    *,
    side: int,
) -> tuple[tuple[Spot, ...], bool]:
    """Spots, and whether there were too many to be dust.

    residuals: For each posture one image per light, measured minus predicted in standard deviations, 0 where unknown,
        shape (h, w).
    """
    scores = {p: _score(some, predictions[p]) for p, some in residuals.items()}
    candidates: list[_Candidate] = []
    for posture, score in scores.items():
        found = _candidates(posture, score)
        if len(found) > MOST_SPOTS:
            return (), True
        candidates += found
    spots: list[Spot] = []
    explained: list[tuple[Posture, float, float]] = []
    for one in sorted(candidates, key=lambda c: -abs(c.score)):
        if any(
            p == one.posture and max(abs(y - one.row), abs(x - one.column)) <= 2 * NEAR_BLOCKS for p, y, x in explained
        ):
            continue
        world = predictions[one.posture].points[one.row, one.column].astype(np.float64)
        own = view_from_part(scene, one.posture)
        point = (world - own.translation) @ own.rotation
        fixed = {p: (float(one.row), float(one.column)) for p in scores}
        moved: dict[Posture, tuple[float, float]] = {}
        for p in scores:
            x, y, _ = project(parameters.view(scene, p, theta).camera, point[None])
            moved[p] = float(y[0]) - 0.5, float(x[0]) - 0.5
        again = {
            name: _seen_again(one, places, scores, predictions) for name, places in (("lens", fixed), ("part", moved))
        }
        visible = {name: len(seen) for name, seen in again.items()}
        share = {name: sum(seen) / max(len(seen), 1) for name, seen in again.items()}
        if not any(visible.values()):
            where = "unknown"
        else:
            where = max(("part", "lens"), key=lambda name: share[name])
            if share[where] < 0.5:
                continue
        explained += [(p, *at) for p, at in (fixed if where == "lens" else moved).items()]
        spots.append(
            Spot(
                where=where,
                posture=one.posture,
                column=side * (one.column + 0.5),
                row=side * (one.row + 0.5),
                point=(float(point[0]), float(point[1]), float(point[2])),
                darker=one.score < 0.0,
                score=abs(one.score),
            )
        )
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


def _candidates(posture: Posture, score: Float32) -> list[_Candidate]:
    found: list[_Candidate] = []
    for sign in (-1.0, 1.0):
        labels: Int32 = np.empty(score.shape, np.int32)
        ndimage.label(sign * score > 0.5 * LEAST_SCORE, structure=np.ones((3, 3)), output=labels)
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            inside = labels[box] == number
            best = float((sign * score[box])[inside].max())
            small = max(inside.shape) <= LARGEST_BLOCKS and inside.sum() >= max(3.0, LEAST_FILL * inside.size)
            if small and best >= LEAST_SCORE:
                rows, columns = np.nonzero(inside)
                weight = np.abs(score[box][inside])
                row = box[0].start + round(float(np.average(rows, weights=weight)))
                column = box[1].start + round(float(np.average(columns, weights=weight)))
                found.append(_Candidate(posture, row, column, sign * best))
    return found


def _seen_again(
    one: _Candidate,
    places: Mapping[Posture, tuple[float, float]],
    scores: Mapping[Posture, Float32],
    predictions: Mapping[Posture, CoarsePrediction],
) -> list[bool]:
    # of each other posture that could show it at the given place, whether it does
    seen: list[bool] = []
    sign, n = np.sign(one.score), NEAR_BLOCKS
    for posture, (y, x) in places.items():
        if posture == one.posture or not (np.isfinite(y) and np.isfinite(x)):
            continue
        row, column = round(y), round(x)
        clean, score = predictions[posture].clean, scores[posture]
        if not (n <= row < clean.shape[0] - n and n <= column < clean.shape[1] - n):
            continue
        window = slice(row - n, row + n + 1), slice(column - n, column + n + 1)
        if clean[row, column] and np.count_nonzero(score[window]) > 0.7 * score[window].size:
            seen.append(bool((sign * score[window]).max() >= SEEN_AGAIN * LEAST_SCORE))
    return seen
