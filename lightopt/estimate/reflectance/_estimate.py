"""The estimate: where the criterion is greatest, found by damped Newton steps, and its uncertainty."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.kernels import kernel
from lightopt.estimate.reflectance._likelihood import (
    FIRST_GAIN,
    R_D,
    Coefficients,
    Criterion,
    Evaluation,
    outlier_share,
    significant,
)

Interval = tuple[float | None, float | None]  # 95 %; None for an end that the images do not bound

# 95 % quantile of χ² with one degree of freedom: twice the log-likelihood may fall by this (Wilks 1938)
CHI2_95 = 3.841458820694124

# a maximum is found when the next step's predicted gain is less than this [nat]: a hundredth of a standard error
TOLERANCE = 1e-4

LEAST_LOG_TAU2, MOST_LOG_TAU2 = np.log(1e-4), np.log(1e10)
LEAST_LOGIT, MOST_LOGIT = -14.0, 2.0
LEAST_LOG_R_S, MOST_LOG_R_S = np.log(1e-3), np.log(1e12)
MOST_LOG_GAIN = np.log(100.0)
FREE_DAMPING = 1e-3
STALLED = 1e8
# A climb whose steps had to be damped this much has nowhere to go. It has converged where an undamped step promises
# less than this [nat], a fifth of a standard error: a clipped level bends the criterion at single pixels.
STALL_TOLERANCE = 0.02

# least squares have converged where no parameter has a step left of more than this share of its standard error
SETTLED = 0.1

LONGEST_STEP = 1.5  # no logarithm changes by more than this in one step


@dataclass(frozen=True, kw_only=True)
class FreeParameters:
    """Parameters that a fit may change: R_d, R_s with σ, the lights' gains relative to the first, the dark level."""

    diffuse: bool = True
    specular: bool = True
    gain: bool = False
    dark: bool = False


@dataclass(frozen=True, kw_only=True)
class Maximum(Coefficients):
    """Where a climb ended; `unsettled` are the parameters along which the criterion still rises."""

    x: Float64
    evaluation: Evaluation
    converged: bool
    unsettled: tuple[int, ...]
    steps: int

    @property
    def value(self) -> float:
        """Criterion [nat]."""
        return self.evaluation.value


@dataclass(frozen=True, kw_only=True)
class ScanPoint(Coefficients):
    """The best fit at one σ."""

    x: Float64
    value: float  # criterion at the scan's pixels [nat]
    drop: float  # how far twice the criterion of the estimate is below its maximum there [nat]

    def as_dict(self, best: float) -> dict[str, float]:
        """JSON form; `best` is the greatest value of the profile."""
        values = {"sigma_rad": self.sigma, "R_d": self.R_d, "R_s": self.R_s}
        below = significant(2.0 * (best - self.value), 6)
        return {n: significant(v, 8) for n, v in values.items()} | {"twice_log_likelihood_below_best": below}


@dataclass(frozen=True)
class Optimum:
    """Where the climb from one peak of the profile over σ ended."""

    start_sigma: float
    top: Maximum  # all optima of an estimate are compared by the same criterion
    criterion: Criterion | None  # None for an optimum far below the best

    def as_dict(self) -> dict[str, Any]:
        top = {name: significant(getattr(self.top, name), 8) for name in ("sigma", "R_d", "R_s", "value")}
        return {"start_sigma": significant(self.start_sigma, 8), **top, "converged": self.top.converged}


@dataclass(frozen=True, kw_only=True)
class Estimate(Coefficients):
    """The best fit and its uncertainty."""

    x: Float64  # parameters, shape (K,), in the order of :mod:`lightopt.estimate.reflectance._likelihood`
    free: tuple[int, ...]  # places of the k parameters that were fitted
    covariance: Float64  # of those, shape (k, k), if the model is right
    inflation: Float64  # factor of each of their variances for what the model gets wrong, shape (k,)
    # square of the half-width of a 95 % interval in standard errors: a quantile of χ², or of Student's t where few
    # groups of images determine the variance
    critical: float = CHI2_95
    criterion: Criterion
    maximum: Maximum
    scan: tuple[ScanPoint, ...]  # the profile over σ, with the estimate itself
    # ends of the climbs from the peaks of the profile; the first is the estimate itself
    optima: tuple[Optimum, ...] = ()
    mean_log_likelihood: float  # per level, with noise and outliers [nat]: comparable between fits to the same levels
    unexplained: float  # share of the pixels that the likelihood would leave out as outliers
    misfit: float = 0.0  # residual of least squares over the noise; 0 where that was not tested
    # groups of images that the uncertainty comes from where it does not, such as "12 lights"
    scatter: str | None = None
    unsettled_refits: int = 0  # number of the fits without one of those groups that did not converge

    @property
    def describes(self) -> bool:
        """Whether the model describes the images, so that the likelihood was maximised; else least squares."""
        return self.scatter is None

    @property
    def value(self) -> float:
        """Criterion [nat]."""
        return self.maximum.value

    @property
    def tau(self) -> float:
        """Deviation that the sensor's noise does not explain [sensor level]."""
        return math.exp(0.5 * self.x[-2])

    @property
    def epsilon(self) -> float:
        """Share of the pixels that the fit takes for dust, glints and the like."""
        return outlier_share(self.x)

    def standard_error(self, place: int) -> float:
        """Standard error of a parameter, for what the model gets wrong as well; 0 for one that was held."""
        if place not in self.free:
            return 0.0
        i = self.free.index(place)
        return math.sqrt(self.covariance[i, i] * self.inflation[i])

    def correlation(self, first: int, second: int) -> float:
        """Correlation of two parameters that were fitted."""
        i, j = self.free.index(first), self.free.index(second)
        return float(self.covariance[i, j] / math.sqrt(self.covariance[i, i] * self.covariance[j, j]))


def bounds(criterion: Criterion) -> tuple[Float64, Float64]:
    """Lowest and highest value of each parameter, two arrays of shape (K,)."""
    gains = [(-MOST_LOG_GAIN, MOST_LOG_GAIN)] * (criterion.size - FIRST_GAIN - 2)
    of_surface = ((0.0, np.inf), (LEAST_LOG_R_S, MOST_LOG_R_S), criterion.sigma_range)
    pairs = (*of_surface, (-np.inf, np.inf), *gains, (LEAST_LOG_TAU2, MOST_LOG_TAU2), (LEAST_LOGIT, MOST_LOGIT))
    low, high = np.array(pairs).T
    return low.copy(), high.copy()


def maximise(
    criterion: Criterion, x: Float64, free: Sequence[int], *, most_steps: int = 60, tolerance: float = TOLERANCE
) -> Maximum:
    """Climb from `x`, shape (K,), along the free parameters until a step promises less than `tolerance` [nat]."""
    low, high = bounds(criterion)
    can_change = np.zeros(len(x), np.bool_)
    can_change[list(free)] = True
    low[~can_change], high[~can_change] = -np.inf, np.inf
    longest = np.full(len(x), LONGEST_STEP)
    longest[R_D] = np.inf
    x = np.clip(x, low, high)
    here = criterion.evaluate(x)
    damping = FREE_DAMPING
    steps, converged = 1, False
    while steps < most_steps:
        moving = _movable(x, here.gradient, can_change, low, high)
        if not moving.any():
            converged = True
            break
        step = _newton_step(here.gradient, here.curvature, moving, damping)
        # a damped step has little predicted gain because it is short
        if float(here.gradient @ step) < tolerance and (
            damping <= FREE_DAMPING or _predicted_gain(here, moving) < max(tolerance, STALL_TOLERANCE)
        ):
            converged = True
            break
        trial = np.clip(x + np.clip(step, -longest, longest), low, high)
        there = criterion.evaluate(trial)
        steps += 1
        if there.value > here.value:
            x, here = trial, there
            damping = max(1e-6, 0.2 * damping)
        else:
            damping *= 8.0
            if damping > STALLED:
                break
    moving = _movable(x, here.gradient, can_change, low, high)
    if not converged:
        converged = not moving.any() or _predicted_gain(here, moving) < max(tolerance, STALL_TOLERANCE)
    unsettled: tuple[int, ...] = ()
    if not converged:
        gains = moving * here.gradient**2 / np.maximum(np.diag(here.curvature), 1e-9)
        unsettled = tuple(np.flatnonzero(moving & (gains > 0.1 * np.max(gains))).tolist())
    return Maximum(x=x, evaluation=here, converged=converged, unsettled=unsettled, steps=steps)


def has_settled(top: Maximum, free: Sequence[int], errors: Float64) -> bool:
    """Whether a climb has converged, or the step that is left is small beside the standard errors.

    A clipped level bends the criterion of least squares at single pixels, where a step's predicted gain means little.
    """
    if top.converged:
        return True
    index = np.asarray(free, dtype=np.intp)
    moving = np.zeros(len(top.x), np.bool_)
    moving[index] = True
    moving[R_D] &= top.x[R_D] > 0.0 or top.evaluation.gradient[R_D] > 0.0
    left = _newton_step(top.evaluation.gradient, top.evaluation.curvature, moving, 1e-6)
    return bool(np.all(np.abs(left[index]) < SETTLED * errors))


def _predicted_gain(here: Evaluation, moving: Bool) -> float:
    # of a step that is hardly damped [nat]
    return float(here.gradient @ _newton_step(here.gradient, here.curvature, moving, 1e-6))


def _movable(x: Float64, gradient: Float64, can_change: Bool, low: Float64, high: Float64) -> Bool:
    # a parameter at its bound that is pushed beyond it stays there
    return can_change & ~(((x <= low) & (gradient < 0.0)) | ((x >= high) & (gradient > 0.0)))


def _newton_step(gradient: Float64, curvature: Float64, moving: Bool, damping: float) -> Float64:
    # 0 where nothing moves; a damping of 1 halves a step, or shortens it more along a ridge
    step, matrix = np.zeros(len(gradient)), curvature[np.ix_(moving, moving)]
    step[moving] = _solved(matrix + np.diag(damping * np.maximum(np.diag(matrix), 1e-9)), gradient[moving])
    return step


@kernel
def _solved(matrix: Float64, right: Float64) -> Float64:
    # by Gaussian elimination; a damped matrix is positive definite, so that no rows have to change places
    size = len(right)
    for k in range(size):
        for n in range(k + 1, size):
            share = matrix[n, k] / matrix[k, k]
            for m in range(k + 1, size):
                matrix[n, m] -= share * matrix[k, m]
            right[n] -= share * right[k]
    for k in range(size - 1, -1, -1):
        for m in range(k + 1, size):
            right[k] -= matrix[k, m] * right[m]
        right[k] /= matrix[k, k]
    return right
