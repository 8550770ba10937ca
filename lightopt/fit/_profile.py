"""Intervals by profile likelihood: how far a parameter can be moved while all others make the best of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._estimate import Estimate
from lightopt.fit._likelihood import R_D
from lightopt.fit._maximise import maximise

__all__ = ["CHI2_95", "profile_interval"]

Float64 = NDArray[np.float64]

CHI2_95 = 3.841458820694124
"""95 % quantile of χ² with one degree of freedom: twice the log-likelihood may fall by this (Wilks 1938)."""

ROUNDS = 16
CLOSE = 0.02
"""An end is found when the likelihood falls by what it should to within this share, a hundredth of the interval."""

FARTHEST = 12.0
"""An end that is this many standard errors away and still not found is not there: the images do not bound that side."""


def profile_interval(estimate: Estimate, place: int) -> tuple[float, float]:
    """95 % interval of one parameter, in its own coordinate (R_d, ln R_s, ln σ, …); infinite where nothing bounds it.

    The fall of the likelihood that ends it is that of a right model times the inflation of the parameter's variance.

    Parameters
    ----------
    estimate
        The maximum.
    place
        Of a parameter that was fitted.
    """
    return _end(estimate, place, -1.0), _end(estimate, place, 1.0)


def _end(estimate: Estimate, place: int, sign: float) -> float:
    best = float(estimate.x[place])
    i = estimate.free.index(place)
    target = CHI2_95 * float(estimate.inflation[i])
    expected = math.sqrt(target * float(estimate.covariance[i, i]))
    # distances from the maximum at which the likelihood has fallen too little and too much
    short, far = 0.0, math.inf
    distance = expected
    for _ in range(ROUNDS):
        if place == R_D and sign < 0.0 and best - distance <= 0.0:
            if best <= 0.0 or _fall(estimate, place, 0.0) <= target:
                return 0.0
            far = min(far, best)
            distance = 0.5 * (short + far)
            continue
        fall = _fall(estimate, place, best + sign * distance)
        if abs(fall / target - 1.0) < CLOSE:
            return best + sign * distance
        if fall < target:
            short = distance
        else:
            far = distance
        # a parabola through the maximum and here, unless that leaves what is known to hold the end
        distance *= min(max(math.sqrt(target / fall), 0.3), 3.0) if fall > 0.0 else 2.0
        if not short < distance < far:
            distance = 0.5 * (short + far) if math.isfinite(far) else 2.0 * short
        if short > FARTHEST * expected:
            return sign * math.inf
    return best + sign * 0.5 * (short + far) if math.isfinite(far) else sign * math.inf


def _fall(estimate: Estimate, place: int, at: float) -> float:
    # of twice the log-likelihood, all other parameters making the best of it
    likelihood = estimate.likelihood
    column = estimate.covariance[:, estimate.free.index(place)]
    variance = float(column[estimate.free.index(place)])
    start = estimate.x.copy()
    # to first order the others follow along the regression on this one
    for p, c in zip(estimate.free, column, strict=True):
        if p < likelihood.log_tau2:
            start[p] += c / variance * (at - estimate.x[place])
    start[place] = at
    others = [p for p in estimate.free if p != place]
    there = maximise(likelihood, start, others, most_steps=12, tolerance=1e-3)
    return 2.0 * (estimate.maximum.evaluation.value - there.evaluation.value)
