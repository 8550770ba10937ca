"""Weights of lights that are lit together: images that show the defects best, by ascent from the best single lights.

The weights are not proven to be the best. But no linear combination of images shows more than all of them do, each in
an image of its own: their evidence bounds what any weights give.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from lightopt.core.arrays import Float64
from lightopt.design.from_images._choice import FOUND, score
from lightopt.design.from_images._evidence import Evidence

_STEPS = 40  # of each ascent
_SPREAD = 0.2  # weight of all other lights in the second start
_RIDGE = 1e-9
_LEAST = 0.01  # weights below this share of an image's greatest are left out


@dataclass(frozen=True)
class Mixture:
    """Images of several lights each."""

    weights: Float64  # of the lights at the exposures of their images, up to 1, shape (N, K)
    score: float
    bound: float


def mix_lights(evidence: Evidence, lights: tuple[int, ...]) -> Mixture:
    """Find non-negative weights for as many images as there are `lights`, which are the best single ones."""
    bound = score(evidence.all_lights())
    single = np.eye(evidence.lights)[list(lights)]
    best, value = single, score(evidence.gains(single))
    for start in (single, np.maximum(single, _SPREAD)):
        answer: Any = optimize.minimize(
            lambda flat: _loss(evidence, flat.reshape(single.shape)),
            start.ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0.0, 1.0)] * single.size,
            options={"maxiter": _STEPS},
        )
        weights = answer.x.reshape(single.shape)
        weights = weights / weights.max(axis=1, keepdims=True)
        weights = np.where(weights < _LEAST, 0.0, np.round(weights, 3))
        if np.linalg.matrix_rank(weights) == len(lights) and score(evidence.gains(weights)) > value + 1e-9:
            best, value = weights, score(evidence.gains(weights))
    return Mixture(best, value, max(bound, value))


def _loss(evidence: Evidence, weights: Float64) -> tuple[float, Float64]:
    # minus the score, and its gradient by the weights
    deviations = evidence.deviations.T[:, None]  # (J, 1, K)
    scaled = weights * deviations
    varied = scaled @ evidence.correlation
    contrast = scaled @ evidence.contrasts
    # images that have become alike: their variance is bounded from below
    ridge = _RIDGE * np.eye(len(weights)) * np.mean(deviations**2, axis=2, keepdims=True)
    solved = np.linalg.solve(varied @ scaled.transpose(0, 2, 1) + ridge, contrast)
    x = np.sum(contrast * solved, axis=(1, 2)) / evidence.thresholds
    rate = FOUND * (x < 1.0) + (1.0 - FOUND) / (1.0 + x) ** 2
    own = evidence.contrasts.transpose(0, 2, 1) - solved.transpose(0, 2, 1) @ varied
    slope = np.sum((2.0 * rate / evidence.thresholds)[:, None, None] * (solved @ own) * deviations, axis=0)
    return -score(x), -slope.ravel() / len(x)
