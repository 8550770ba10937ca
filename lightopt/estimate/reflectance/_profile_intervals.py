"""Intervals by profile likelihood: how far a parameter can be moved while all others are refitted."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np

from lightopt.estimate.reflectance._criterion import R_D
from lightopt.estimate.reflectance._estimate import Estimate, Optimum
from lightopt.estimate.reflectance._newton import bounds, maximise

ROUNDS = 16
CLOSE = 0.02
"""An end is found when the likelihood falls by what it should to within this share, a hundredth of the interval."""

SAME_REGION = 0.02
"""Regions with a gap of less than this share of the longer one between them are one: ends are known no better."""

FARTHEST = 12.0
"""An end that is this many standard errors away and still not found is not there: the images do not bound that side."""


def profile_interval(estimate: Estimate, place: int) -> tuple[float, float]:
    """95 % interval of one parameter, in its own coordinate (R_d, ln R_s, ln σ, …); infinite where nothing bounds it.

    It reaches over all of :func:`profile_regions`, and what is between them.
    """
    regions = profile_regions(estimate, place)
    return regions[0][0], regions[-1][1]


def profile_regions(estimate: Estimate, place: int) -> tuple[tuple[float, float], ...]:
    """Values of one parameter that the criterion does not exclude: one interval for most images, ascending if more.

    The drop of the criterion that ends a region is that of a right model times the inflation of the parameter's
    variance. Regions are searched around the estimate, around the other optima within that drop, and at the points of
    the scan within it.
    """
    target = estimate.critical * float(estimate.inflation[estimate.free.index(place)])
    best = estimate.maximum.evaluation.value
    regions = [_around(estimate, place, target)]
    for other in estimate.optima[1:]:
        drop = 2.0 * (best - other.value)
        if drop < target:
            at = float(other.x[place])
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
    here = other.criterion.evaluate(other.x)
    index = list(estimate.free)
    curvature = here.curvature[np.ix_(index, index)]
    size = np.sqrt(np.maximum(np.diag(curvature), 1e-12))
    scaled = curvature / np.outer(size, size) + 1e-9 * np.eye(len(index))
    return replace(
        estimate,
        x=other.x,
        criterion=other.criterion,
        maximum=replace(estimate.maximum, x=other.x, evaluation=here),
        covariance=np.linalg.inv(scaled) / np.outer(size, size),
    )


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
