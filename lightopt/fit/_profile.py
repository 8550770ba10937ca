"""Intervals by profile likelihood: how far a parameter can be moved while all others make the best of it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._criterion import R_D
from lightopt.fit._estimate import Estimate
from lightopt.fit._maximise import bounds, maximise

__all__ = ["fall", "profile_interval"]

Float64 = NDArray[np.float64]

ROUNDS = 16
CLOSE = 0.02
"""An end is found when the likelihood falls by what it should to within this share, a hundredth of the interval."""

FARTHEST = 12.0
"""An end that is this many standard errors away and still not found is not there: the images do not bound that side."""


def profile_interval(estimate: Estimate, place: int) -> tuple[float, float]:
    """95 % interval of one parameter, in its own coordinate (R_d, ln R_s, ln σ, …); infinite where nothing bounds it.

    The fall of the criterion that ends it is that of a right model times the inflation of the parameter's variance.

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
    target = estimate.critical * float(estimate.inflation[i])
    expected = math.sqrt(target * float(estimate.covariance[i, i]))
    # distances from the maximum at which the likelihood has fallen too little and too much
    short, far, bounded = 0.0, math.inf, False
    distance = expected
    for _ in range(ROUNDS):
        if place == R_D and sign < 0.0 and best - distance <= 0.0:
            if best <= 0.0 or fall(estimate, place, 0.0) <= target:
                return 0.0
            far, bounded = min(far, best), True
            distance = 0.5 * (short + far)
            continue
        drop = fall(estimate, place, best + sign * distance)
        if abs(drop / target - 1.0) < CLOSE:
            return best + sign * distance
        if drop < target:
            short = distance
        else:
            # beyond the values that a parameter may have the criterion falls without end, which bounds nothing
            far, bounded = distance, bounded or math.isfinite(drop)
        # a parabola through the maximum and here, unless that leaves what is known to hold the end
        distance *= min(max(math.sqrt(target / drop), 0.3), 3.0) if drop > 0.0 else 2.0
        if not short < distance < far:
            distance = 0.5 * (short + far) if math.isfinite(far) else 2.0 * short
        if short > FARTHEST * expected:
            return sign * math.inf
    return best + sign * 0.5 * (short + far) if bounded else sign * math.inf


def fall(estimate: Estimate, place: int, at: float) -> float:
    """How far twice the criterion falls where a parameter is held at `at` and all others make the best of it [nat].

    Parameters
    ----------
    estimate
        The maximum.
    place
        Of a parameter that was fitted.
    at
        In its own coordinate; beyond the values that it may have, infinite.
    """
    criterion = estimate.criterion
    low, high = bounds(criterion)
    if not low[place] <= at <= high[place]:
        return math.inf
    column = estimate.covariance[:, estimate.free.index(place)]
    variance = float(column[estimate.free.index(place)])
    start = estimate.x.copy()
    # to first order the others follow along the regression on this one
    for p, c in zip(estimate.free, column, strict=True):
        if p < criterion.size - 2:
            start[p] += c / variance * (at - estimate.x[place])
    start[place] = at
    others = [p for p in estimate.free if p != place]
    there = maximise(criterion, start, others, most_steps=12, tolerance=1e-3)
    return 2.0 * (estimate.maximum.evaluation.value - there.evaluation.value)
