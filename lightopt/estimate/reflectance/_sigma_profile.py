"""The profile over σ: the best of all other parameters at each of a row of σ, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.run_context import Share
from lightopt.estimate.reflectance._criterion import LOG_SIGMA, Criterion
from lightopt.estimate.reflectance._newton import Maximum, maximise

SCAN_STEPS, FIRST_STEPS = 30, 5
SCAN_TOLERANCE = 0.1
"""A scan only has to tell basins apart [nat]. Of several starts that which is best after the first steps goes on."""


def profile_over_sigma(
    criterion_at: Callable[[float], Criterion],
    starts_at: Callable[[int], Sequence[Float64]],
    log_sigmas: Sequence[float],
    free: Sequence[int],
    *,
    progress: Share | None = None,
) -> list[Maximum]:
    """The best fit at each σ, from its own starts and from the best at its neighbours on both sides.

    free: Places of the parameters that are fitted; σ is not, whether or not it is among them.
    """
    fixed = [place for place in free if place != LOG_SIGMA]
    criteria = [criterion_at(log_sigma) for log_sigma in log_sigmas]
    best: list[Maximum] = []
    for number, criterion in enumerate(criteria):
        starts = [*starts_at(number)]
        if best:
            starts.append(_moved(best[-1].x, log_sigmas[number]))
        best.append(_best(criterion, starts, fixed))
        if progress is not None:
            progress((number + 1) / len(criteria))
    for number in range(len(criteria) - 2, -1, -1):
        start = _moved(best[number + 1].x, log_sigmas[number])
        other = _best(criteria[number], [start], fixed)
        best[number] = max(best[number], other, key=lambda one: one.evaluation.value)
    return best


def profile_outwards(
    criterion_at: Callable[[float], Criterion],
    starts_at: Callable[[int], Sequence[Float64]],
    log_sigmas: Sequence[float],
    free: Sequence[int],
    *,
    begin: int,
    progress: Share | None = None,
) -> list[Maximum]:
    """The best fit at each σ, from one σ outwards: a climb begins where its neighbour's ended, or at a better start.

    An outlier share and a deviation take long to find, and hardly change from one σ to the next. At the σ of number
    `begin` all starts are climbed from.
    """
    fixed = [place for place in free if place != LOG_SIGMA]
    found: dict[int, Maximum] = {}
    count = len(log_sigmas)
    for number in (begin, *range(begin + 1, count), *range(begin - 1, -1, -1)):
        criterion = criterion_at(log_sigmas[number])
        starts = [*starts_at(number)]
        if number != begin:
            before = found[number - 1 if number > begin else number + 1].x
            first = [_moved(before, log_sigmas[number]), *starts]
            starts = [_best(criterion, first, fixed, most_steps=FIRST_STEPS).x]
        found[number] = _best(criterion, starts, fixed)
        if progress is not None:
            progress(len(found) / count)
    return [found[number] for number in range(count)]


def peaks(profile: Sequence[Maximum]) -> list[Maximum]:
    """The local maxima along a profile over σ, the best first."""
    values = [-np.inf, *(one.evaluation.value for one in profile), -np.inf]
    tops = [
        one
        for number, one in enumerate(profile, start=1)
        if values[number] >= values[number - 1] and values[number] >= values[number + 1]
    ]
    return sorted(tops, key=lambda one: -one.evaluation.value)


def _best(
    criterion: Criterion, starts: Sequence[Float64], fixed: Sequence[int], *, most_steps: int = SCAN_STEPS
) -> Maximum:
    found = [maximise(criterion, x, fixed, most_steps=most_steps, tolerance=SCAN_TOLERANCE) for x in starts]
    return max(found, key=lambda one: one.evaluation.value)


def _moved(x: Float64, log_sigma: float) -> Float64:
    there = x.copy()
    there[LOG_SIGMA] = log_sigma
    return there
