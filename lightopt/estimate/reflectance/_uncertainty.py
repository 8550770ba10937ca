"""Uncertainty of the likelihood's maximum, where the model is right and where it is not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.estimate.reflectance._criterion import R_D
from lightopt.estimate.reflectance._likelihood import Likelihood
from lightopt.estimate.reflectance._newton import bounds

STEP = 0.3
"""Differences of the gradient are taken this many (conditional) standard errors to either side."""

LONGEST_DIFFERENCE = 0.1
"""But no logarithm is moved by more than this for it."""

AT_BOUND = 1e-6
LEAST_INFORMATION = 0.05
"""A noise parameter with less information than this [nat] is as good as at its bound: others do not depend on it."""

BY_CHANCE, SURELY = 3.0, 6.0
"""A variance between pieces of the image that is this many standard deviations above what chance makes of a right
model begins to count, and counts wholly."""


def determined_parameters(likelihood: Likelihood, x: Float64, free: Sequence[int]) -> list[int]:
    """The free parameters, without a noise τ or an outlier share ε at its bound.

    At a bound the likelihood has no maximum: neither information nor scores mean anything there.
    """
    low, high = bounds(likelihood)
    curvature = np.diag(likelihood.evaluate(x).curvature)
    return [
        place
        for place in free
        if place < likelihood.size - 2
        or (
            low[place] + AT_BOUND < x[place] < high[place] - AT_BOUND and curvature[place] > LEAST_INFORMATION
        )
    ]


def information(likelihood: Likelihood, x: Float64, places: Sequence[int]) -> Float64:
    """Observed information: minus the Hessian of the log-likelihood along some parameters, shape (k, k)."""
    index = np.asarray(places, dtype=np.intp)
    curvature = np.diag(likelihood.evaluate(x).curvature)
    result = np.zeros((len(index), len(index)))
    for j, place in enumerate(index):
        h = STEP / np.sqrt(max(float(curvature[place]), 1e-12))
        if place != R_D:
            h = min(h, LONGEST_DIFFERENCE)
        ahead, behind = x.copy(), x.copy()
        ahead[place] += h
        behind[place] -= h
        difference = likelihood.evaluate(behind).gradient - likelihood.evaluate(ahead).gradient
        result[j] = difference[index] / (2.0 * h)
    return 0.5 * (result + result.T)


def uncertainty(likelihood: Likelihood, x: Float64, free: Sequence[int]) -> tuple[Float64, Float64]:
    """Covariance of the free parameters if the model is right, and by how much their variances are larger if not.

    The second is the variance from the scores of the pieces of the image (White 1982, doi:10.2307/1912526, summed as
    for clusters of observations) over that of the first. A few dozen pieces carry a highlight, so that this ratio
    scatters by tenths even where the model is right: only what is beyond that scatter counts.

    Returns Shape (k, k), and shape (k,) of at least 1; 0 and 1 for noise parameters that the images do not determine.
    """
    places = determined_parameters(likelihood, x, free)
    rows = [list(free).index(place) for place in places]
    inner = _inverse(information(likelihood, x, places))
    gradients, curvatures = likelihood.by_block(x)
    moves = gradients[:, places] @ inner
    pieces = len(moves)
    measured = np.sum(moves**2, axis=0) * (pieces / max(1, pieces - len(places)))
    # what each piece adds to the variance if the model is right: (C·I_b·C)_kk
    part = curvatures[:, places][:, :, places]
    expected = np.maximum(np.einsum("ik,bij,jk->bk", inner, part, inner), 0.0)
    total = np.maximum(expected.sum(axis=0), 1e-300)
    chance = np.sqrt(2.0 * np.sum(expected**2, axis=0)) / total
    beyond = measured / np.maximum(np.diag(inner), 1e-300) - 1.0
    weight = np.clip((beyond / np.maximum(chance, 1e-300) - BY_CHANCE) / (SURELY - BY_CHANCE), 0.0, 1.0)
    covariance = np.zeros((len(free), len(free)))
    covariance[np.ix_(rows, rows)] = inner
    inflation = np.ones(len(free))
    inflation[rows] = 1.0 + weight * np.maximum(beyond, 0.0)
    return covariance, inflation


def _inverse(matrix: Float64) -> Float64:
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-12))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    inverse = (vectors / np.maximum(values, 1e-10)) @ vectors.T
    return inverse / np.outer(scale, scale)
