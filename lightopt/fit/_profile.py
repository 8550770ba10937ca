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

_ROUNDS = 4
_CLOSE = 0.02


def profile_interval(estimate: Estimate, place: int) -> tuple[float, float]:
    """95 % interval of one parameter, in its own coordinate (R_d, ln R_s, ln σ, …).

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
    likelihood, best = estimate.likelihood, estimate.x
    others = [p for p in estimate.free if p != place]
    column = estimate.covariance[:, estimate.free.index(place)]
    i = estimate.free.index(place)
    variance, inflation = float(column[i]), float(estimate.inflation[i])
    target = CHI2_95 * inflation
    step = sign * math.sqrt(target * variance)
    for _ in range(_ROUNDS):
        start = best.copy()
        # to first order the others follow along the regression on this one
        for p, c in zip(estimate.free, column, strict=True):
            if p < likelihood.log_tau2:
                start[p] = best[p] + c / variance * step
        start[place] = best[place] + step
        if place == R_D and start[R_D] <= 0.0:
            return 0.0
        there = maximise(likelihood, start, others, most_steps=12, tolerance=1e-3)
        fall = 2.0 * (estimate.maximum.evaluation.value - there.evaluation.value)
        if fall <= 0.0:
            step *= 2.0
            continue
        if abs(fall / target - 1.0) < _CLOSE:
            break
        step *= float(np.clip(math.sqrt(target / fall), 0.3, 3.0))
    return float(best[place] + step)
