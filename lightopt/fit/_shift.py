"""Would the images fit if they were shifted by some pixels? Then the part does not lie where its file has it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._estimate import Estimate
from lightopt.fit._likelihood import predicted
from lightopt.fit._samples import Samples, thinned
from lightopt.fit._search import estimate

__all__ = ["ImageShift", "find_shift"]

Float64 = NDArray[np.float64]

REACH_PX = 16
"""Shifts are looked for up to this far along rows and columns."""

BUDGET = 250
"""Pixels per octave, light and posture that are looked at."""

LEVEL_CAP = 0.15
"""Residuals count as at most this share of the sensor's full scale, dust and all."""

FINE_STEPS = 4
ROUNDS = 2


@dataclass(frozen=True, kw_only=True)
class ImageShift:
    """How far the images are off the model.

    Attributes
    ----------
    pixels
        Greatest shift of the part's middle among the postures [px].
    turn
        Greatest turn [rad].
    explains
        Share of the mean squared residual beyond the noise that is gone once the images are moved there.
    """

    pixels: float
    turn: float
    explains: float


def find_shift(samples: Samples, found: Estimate, *, noise: float, threads: int | None = None) -> ImageShift:
    """Shift and turn that lay the images of each posture over the model, and what they explain.

    The fit is made again on the moved images, since one to images that are off has another reflectance.

    Parameters
    ----------
    samples, found
        A fit that is poor.
    noise
        Deviation of a typical pixel that no model explains [sensor level].
    threads
        Number of threads; the result does not depend on it.
    """
    few = thinned(samples, BUDGET)
    cap = LEVEL_CAP * few.sensor.max_level
    model = np.clip(_model(few, found, threads), 0.0, few.sensor.saturated_from)
    before = _misfit(few, model, cap)
    moved, moves = few, np.zeros((1, 3))
    for _ in range(ROUNDS):
        moves = np.array([_align(few, model, posture, cap) for posture in _postures(few)])
        moved = _moved(few, moves)
        again = estimate(moved, threads=threads)
        model = np.clip(_model(few, again, threads), 0.0, few.sensor.saturated_from)
    excess = before - noise**2
    explains = 1.0 - (_misfit(moved, model, cap) - noise**2) / excess if excess > 0.0 else 0.0
    return ImageShift(
        pixels=float(np.max(np.hypot(moves[:, 0], moves[:, 1]))),
        turn=float(np.max(np.abs(moves[:, 2]))),
        explains=min(explains, 1.0),
    )


def _model(samples: Samples, found: Estimate, threads: int | None) -> Float64:
    return predicted(samples, samples.specular(found.sigma, threads=threads), found.x)


def _misfit(samples: Samples, model: Float64, cap: float) -> float:
    level = np.minimum(samples.level, samples.sensor.saturated_from)
    return float(np.mean(np.minimum((level - model) ** 2, cap**2)))


def _postures(samples: Samples) -> list[NDArray[np.intp]]:
    # the observations of each posture
    postures = list(dict.fromkeys(image.posture for image in samples.images))
    of_image = np.array([postures.index(image.posture) for image in samples.images])
    return [np.flatnonzero(of_image[samples.image] == i) for i in range(len(postures))]


def _places(samples: Samples, index: NDArray[np.intp]) -> tuple[Float64, Float64]:
    row = np.concatenate([group.row for group in samples.groups])[samples.sample[index]]
    column = np.concatenate([group.column for group in samples.groups])[samples.sample[index]]
    return row.astype(np.float64), column.astype(np.float64)


def _align(samples: Samples, model: Float64, index: NDArray[np.intp], cap: float) -> Float64:
    # x, y [px] and turn [rad] by which the images are off: over whole pixels first, then by Gauss and Newton
    def misfit(move: Float64) -> float:
        level = _levels_at(samples, index, move)
        return float(np.mean(np.minimum(np.abs(level - model[index]), cap)))

    best = np.zeros(3)
    for step in (4, 1):
        reach = np.arange(-REACH_PX, REACH_PX + 1, 4) if step == 4 else np.arange(-3, 4)
        tried = [best + np.array([x, y, 0.0]) for x, y in product(reach, reach)]
        # where several are as good, the nearest
        best = min([best, *tried], key=lambda move: (misfit(move), float(np.hypot(move[0], move[1]))))
    h = np.diag([0.5, 0.5, 0.5 / max(10.0, _radius(samples, index))])
    for _ in range(FINE_STEPS):
        residual = model[index] - _levels_at(samples, index, best)
        slopes = np.stack(
            [
                (_levels_at(samples, index, best + d) - _levels_at(samples, index, best - d)) / (2.0 * d[i])
                for i, d in enumerate(h)
            ],
            axis=1,
        )
        weight = np.abs(residual) < cap
        scale = np.sqrt(np.maximum(np.sum(slopes[weight] ** 2, axis=0), 1e-9))
        normal = slopes[weight].T @ slopes[weight] / np.outer(scale, scale) + 1e-6 * np.eye(3)
        change = np.linalg.solve(normal, slopes[weight].T @ residual[weight] / scale) / scale
        trial = best + np.clip(change, -2.0 * np.diag(h), 2.0 * np.diag(h))
        if misfit(trial) >= misfit(best):
            break
        best = trial
    return best


def _radius(samples: Samples, index: NDArray[np.intp]) -> float:
    row, column = _places(samples, index)
    return float(np.hypot(row - row.mean(), column - column.mean()).max())


def _levels_at(samples: Samples, index: NDArray[np.intp], move: Float64) -> Float64:
    # levels of the images at pixels that were moved and turned about the middle of all; between pixels, interpolated
    row, column = _places(samples, index)
    y0, x0 = float(row.mean()), float(column.mean())
    c, s = math.cos(move[2]), math.sin(move[2])
    x = x0 + c * (column - x0) - s * (row - y0) + move[0]
    y = y0 + s * (column - x0) + c * (row - y0) + move[1]
    height, width = samples.images[0].levels.shape
    x, y = np.clip(x, 0.0, width - 1.001), np.clip(y, 0.0, height - 1.001)
    left, top = x.astype(np.intp), y.astype(np.intp)
    u, v = x - left, y - top
    stack = np.stack([image.levels for image in samples.images])
    image = samples.image[index]
    upper = (1.0 - u) * stack[image, top, left] + u * stack[image, top, left + 1]
    lower = (1.0 - u) * stack[image, top + 1, left] + u * stack[image, top + 1, left + 1]
    return np.minimum((1.0 - v) * upper + v * lower, samples.sensor.saturated_from)


def _moved(samples: Samples, moves: Float64) -> Samples:
    level = samples.level.copy()
    for index, move in zip(_postures(samples), moves, strict=True):
        level[index] = _levels_at(samples, index, move)
    return replace(samples, level=level, saturated=level >= samples.sensor.saturated_from)
