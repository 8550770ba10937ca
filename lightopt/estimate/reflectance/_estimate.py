"""The estimate: where the criterion is greatest, found by damped Newton steps, and its uncertainty.

Uncertainty is the covariance of the likelihood's maximum, and intervals are by profiles of the criterion: how far a
parameter can be moved while all others are refitted.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.kernels import kernel
from lightopt.estimate.reflectance._likelihood import Criterion, Evaluation, Likelihood
from lightopt.estimate.reflectance._vector import FIRST_GAIN, R_D, Coefficients, outlier_share, significant

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
# A climb whose steps had to be damped this much has nowhere to go. It has converged where an undamped step promises
# less than this [nat], a fifth of a standard error: a clipped level bends the criterion at single pixels.
STALLED, STALL_TOLERANCE = 1e8, 0.02
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
    x: Float64
    value: float  # criterion at the scan's pixels [nat]
    drop: float  # how far twice the criterion of the estimate is below its maximum there [nat]

    def as_dict(self, best: float) -> dict[str, float | None]:
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
    x: Float64  # parameters, shape (K,), in the order of :mod:`lightopt.estimate.reflectance._vector`
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


STEP = 0.3  # differences of the gradient are taken this many (conditional) standard errors to either side
LONGEST_DIFFERENCE = 0.1  # but no logarithm is moved by more than this for it
AT_BOUND = 1e-6
# a noise parameter with less information than this [nat] is as good as at its bound: others do not depend on it
LEAST_INFORMATION = 0.05
# a variance between blocks of the image that is this many standard deviations above what chance makes of a right model
# begins to count, and counts wholly
BY_CHANCE, SURELY = 3.0, 6.0
# an end is found when the likelihood falls by what it should to within this share, a hundredth of the interval
CLOSE, ROUNDS = 0.02, 16
# regions with a gap of less than this share of the longer one between them are one: ends are known no better
SAME_REGION = 0.02
# an end that is this many standard errors away and still not found is not there: the images do not bound that side
FARTHEST = 12.0


def _information(likelihood: Likelihood, x: Float64, places: Sequence[int], curvature: Float64) -> Float64:
    # observed information: minus the Hessian of the log-likelihood along some parameters, shape (k, k); `curvature` is
    # its approximate diagonal along all
    index = np.asarray(places, dtype=np.intp)
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

    The second is the variance from the scores of the blocks of the image (White 1982, doi:10.2307/1912526, summed as
    for clusters of observations) over that of the first. A few dozen blocks carry a highlight, so that this ratio
    scatters by tenths even where the model is right: only what is beyond that scatter counts.

    Shapes (k, k), and (k,) of at least 1; 0 and 1 for noise parameters that the images do not determine.
    """
    # without a noise τ or an outlier share ε at its bound: the likelihood has no maximum there, and neither information
    # nor scores mean anything
    (low, high), curvature = bounds(likelihood), np.diag(likelihood.evaluate(x).curvature)
    determined = (low + AT_BOUND < x) & (x < high - AT_BOUND) & (curvature > LEAST_INFORMATION)
    places = [place for place in free if place < likelihood.size - 2 or determined[place]]
    rows = [list(free).index(place) for place in places]
    inner = _inverse(_information(likelihood, x, places, curvature))
    gradients, curvatures = likelihood.by_block(x)
    moves = gradients[:, places] @ inner
    blocks = len(moves)
    measured = np.sum(moves**2, axis=0) * (blocks / max(1, blocks - len(places)))
    # what each block adds to the variance if the model is right: (C·I_b·C)_kk
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


def profile_regions(estimate: Estimate, place: int) -> tuple[tuple[float, float], ...]:
    """Values of one parameter that the criterion does not exclude: one interval for most images, ascending if more.

    In its own coordinate (R_d, ln R_s, ln σ, …), infinite where nothing bounds it. The drop of the criterion that ends
    a region is that of a right model times the inflation of the parameter's variance. Regions are searched around the
    estimate, around the other optima within that drop, and at the points of the scan within it.
    """
    target = estimate.critical * float(estimate.inflation[estimate.free.index(place)])
    best = estimate.maximum.value
    regions = [_between(estimate, place, target)]
    for other in estimate.optima[1:]:
        drop = 2.0 * (best - other.top.value)
        if drop < target and other.criterion is None:
            at = float(other.top.x[place])
            regions.append((at, at))
        elif drop < target and other.criterion is not None:
            # as if the other optimum were the estimate, with the covariance that its own curvature has
            here = other.criterion.evaluate(other.top.x)
            covariance = _inverse(here.curvature[np.ix_(estimate.free, estimate.free)])
            top = replace(estimate.maximum, x=other.top.x, evaluation=here)
            there = replace(estimate, x=top.x, criterion=other.criterion, maximum=top, covariance=covariance)
            regions.append(_between(there, place, target - drop))
    # neighbours along the scan belong together
    for within, run in itertools.groupby(estimate.scan, key=lambda point: point.drop < target):
        if within:
            values = [float(point.x[place]) for point in run]
            regions.append((min(values), max(values)))
    joined: list[tuple[float, float]] = []
    for low, high in sorted(regions):
        if joined:
            before = joined[-1]
            longer = max(before[1] - before[0], high - low)
            if low <= before[1] + (SAME_REGION * longer if math.isfinite(longer) else 0.0):
                joined[-1] = before[0], max(before[1], high)
                continue
        joined.append((low, high))
    return tuple(joined)


def _between(estimate: Estimate, place: int, target: float) -> tuple[float, float]:
    return _end(estimate, place, -1.0, target), _end(estimate, place, 1.0, target)


def _end(estimate: Estimate, place: int, sign: float, target: float) -> float:
    best = float(estimate.x[place])
    i = estimate.free.index(place)
    expected = math.sqrt(target * float(estimate.covariance[i, i]))
    # distances from the maximum at which the likelihood has fallen too little and too much
    short, far, bounded = 0.0, math.inf, False
    distance = expected
    for _ in range(ROUNDS):
        if place == R_D and sign < 0.0 and best - distance <= 0.0:
            if best <= 0.0 or criterion_drop(estimate, place, 0.0) <= target:
                return 0.0
            far, bounded = min(far, best), True
            distance = 0.5 * (short + far)
            continue
        drop = criterion_drop(estimate, place, best + sign * distance)
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


def criterion_drop(estimate: Estimate, place: int, at: float) -> float:
    """Drop of twice the criterion with one parameter held at `at`, all others refitted [nat]; infinite off bounds."""
    criterion = estimate.criterion
    low, high = bounds(criterion)
    if not low[place] <= at <= high[place]:
        return math.inf
    i = estimate.free.index(place)
    column = estimate.covariance[:, i]
    variance = float(column[i])
    start = estimate.x.copy()
    # to first order the others follow along the regression on this one
    for p, c in zip(estimate.free, column, strict=True):
        if p < criterion.size - 2:
            start[p] += c / variance * (at - estimate.x[place])
    start[place] = at
    others = [p for p in estimate.free if p != place]
    there = maximise(criterion, start, others, most_steps=12, tolerance=1e-3)
    return 2.0 * (estimate.maximum.value - there.value)
