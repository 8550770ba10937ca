"""Uncertainty of an estimate: covariance of the likelihood's maximum, and intervals by profiles of the criterion.

A profile shows how far a parameter can be moved while all others are refitted.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.estimate.reflectance._estimate import Estimate, Optimum, bounds, maximise
from lightopt.estimate.reflectance._likelihood import R_D, Likelihood

STEP = 0.3  # differences of the gradient are taken this many (conditional) standard errors to either side
LONGEST_DIFFERENCE = 0.1  # but no logarithm is moved by more than this for it
AT_BOUND = 1e-6
# a noise parameter with less information than this [nat] is as good as at its bound: others do not depend on it
LEAST_INFORMATION = 0.05

# a variance between blocks of the image that is this many standard deviations above what chance makes of a right model
# begins to count, and counts wholly
BY_CHANCE, SURELY = 3.0, 6.0

ROUNDS = 16
# an end is found when the likelihood falls by what it should to within this share, a hundredth of the interval
CLOSE = 0.02

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
    regions = [_around(estimate, place, target)]
    for other in estimate.optima[1:]:
        drop = 2.0 * (best - other.top.value)
        if drop < target:
            at = float(other.top.x[place])
            there = _at_optimum(estimate, other)
            regions.append((at, at) if there is None else _around(there, place, target - drop))
    # neighbours along the scan belong together
    for within, run in itertools.groupby(estimate.scan, key=lambda point: point.drop < target):
        if within:
            values = [float(point.x[place]) for point in run]
            regions.append((min(values), max(values)))
    return _joined(regions)


def _at_optimum(estimate: Estimate, other: Optimum) -> Estimate | None:
    # as if the other optimum were the estimate, with the covariance that its own curvature has
    if other.criterion is None:
        return None
    here = other.criterion.evaluate(other.top.x)
    covariance = _inverse(here.curvature[np.ix_(estimate.free, estimate.free)])
    top = replace(estimate.maximum, x=other.top.x, evaluation=here)
    return replace(estimate, x=top.x, criterion=other.criterion, maximum=top, covariance=covariance)


def _joined(regions: list[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
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


def _around(estimate: Estimate, place: int, target: float) -> tuple[float, float]:
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
