"""Probability of detection against size, from defects that were found and defects that were missed.

Hit/miss analysis as in MIL-HDBK-1823A, appendix G: logit POD = b₀ + b₁·ln size, by maximum likelihood, and the bound of
the size that is found 90 % of the time from the ratio of likelihoods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, special

WANTED = 0.9
ONE_SIDED_95 = 2.7055
"""Twice the fall of the log-likelihood at a one-sided bound of 95 %: the square of the normal quantile 1.645."""

LEAST_DEFECTS = 8
STEEPEST = 200.0
FURTHEST, PLACES = 30.0, 120
"""Bounds beyond this many times the largest size are none; so many sizes are tried to begin with."""


@dataclass(frozen=True)
class DetectionCurve:
    """Probability of detection against size.

    intercept, steepness: b₀ and b₁; None where hits and misses do not determine them: too few, all found or missed, or
        no rise with size.
    a90: Size that is found 90 % of the time [mm]; None likewise.
    a90_95: Its upper bound of 95 % confidence [mm]; None likewise, or where there is none.
    """

    defects: int
    found: int
    intercept: float | None = None
    steepness: float | None = None
    a90: float | None = None
    a90_95: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            name: None if value is None else (value if isinstance(value, int) else float(f"{value:.6g}"))
            for name, value in vars(self).items()
        }


def fit_detection_curve(sizes: Sequence[float], found: Sequence[bool]) -> DetectionCurve:
    """Fit the curve of detection.

    sizes: Of the defects [mm].
    found: Whether each was.
    """
    x, hit = np.log(np.asarray(sizes, np.float64)), np.asarray(found, np.bool_)
    n, k = len(x), int(hit.sum())
    if n < LEAST_DEFECTS or k in (0, n) or np.ptp(x) == 0.0:
        return DetectionCurve(n, k)
    goal = math.log(WANTED / (1.0 - WANTED))

    def likelihood(place: float, steepness: float) -> float:
        # of a curve that is WANTED at ln size `place`
        eta = goal + steepness * (x - place)
        return float(np.sum(np.where(hit, special.log_expit(eta), special.log_expit(-eta))))

    def best_at(place: float) -> tuple[float, float]:
        # the steepness that suits, and its likelihood
        answer = optimize.minimize_scalar(
            lambda s: -likelihood(place, math.exp(s)),
            bounds=(math.log(1e-2), math.log(STEEPEST)),
            method="bounded",
        )
        return math.exp(float(answer.x)), -float(answer.fun)  # pyright: ignore[reportAttributeAccessIssue]

    reach = math.log(FURTHEST)
    places = np.linspace(x.min() - reach, x.max() + reach, PLACES)
    values = np.array([best_at(float(place))[1] for place in places])
    top = int(values.argmax())
    if top in (0, len(places) - 1):
        return DetectionCurve(n, k)
    answer = optimize.minimize_scalar(
        lambda place: -best_at(place)[1], bounds=(places[top - 1], places[top + 1]), method="bounded"
    )
    place = float(answer.x)  # pyright: ignore[reportAttributeAccessIssue]
    steepness, most = best_at(place)
    even = k * math.log(k / n) + (n - k) * math.log(1.0 - k / n)
    if most - even < 1e-6:
        return DetectionCurve(n, k)
    inside = (2.0 * (most - values) <= ONE_SIDED_95) & (places >= place)
    bound = None
    if inside.any() and not inside[-1]:
        last = int(np.flatnonzero(inside)[-1])
        low, high = float(places[last]), float(places[last + 1])
        for _ in range(40):
            middle = 0.5 * (low + high)
            near = 2.0 * (most - best_at(middle)[1]) <= ONE_SIDED_95
            low, high = (middle, high) if near else (low, middle)
        bound = math.exp(low)
    elif not inside.any():
        bound = math.exp(float(places[int(np.searchsorted(places, place))]))
    return DetectionCurve(n, k, goal - steepness * place, steepness, math.exp(place), bound)
