"""The profile over σ: the best of all other parameters at each of a row of σ, from several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._criterion import LOG_SIGMA, Criterion
from lightopt.fit._maximise import Maximum, maximise

__all__ = ["peaks", "profile_over_sigma"]

Float64 = NDArray[np.float64]

SCAN_STEPS = 30
SCAN_TOLERANCE = 0.1
"""A scan only has to tell basins apart [nat]."""


def profile_over_sigma(
    criterion_at: Callable[[float], Criterion],
    starts_at: Callable[[int, Criterion], Sequence[Float64]],
    log_sigmas: Sequence[float],
    free: Sequence[int],
    *,
    neighbours: bool = True,
    progress: Callable[[float], None] | None = None,
) -> list[Maximum]:
    """The best fit at each σ, from its own starts and from the best at its neighbours on both sides.

    Parameters
    ----------
    criterion_at
        The criterion at one ln σ.
    starts_at
        Where to climb from, by the number of the σ.
    log_sigmas
        ln σ, ascending.
    free
        Places of the parameters that are fitted; σ is not, whether or not it is among them.
    neighbours
        Whether to start from the neighbours as well.
    progress
        Called with the share that is done.
    """
    fixed = [place for place in free if place != LOG_SIGMA]
    criteria = [criterion_at(log_sigma) for log_sigma in log_sigmas]
    best: list[Maximum] = []
    for number, criterion in enumerate(criteria):
        starts = [*starts_at(number, criterion)]
        if best and neighbours:
            starts.append(_moved(best[-1].x, log_sigmas[number]))
        best.append(_best(criterion, starts, fixed))
        if progress is not None:
            progress((number + 1) / len(criteria))
    for number in range(len(criteria) - 2, -1, -1) if neighbours else ():
        start = _moved(best[number + 1].x, log_sigmas[number])
        other = _best(criteria[number], [start], fixed)
        best[number] = max(best[number], other, key=lambda one: one.evaluation.value)
    return best


def peaks(profile: Sequence[Maximum]) -> list[Maximum]:
    """The local maxima along a profile over σ, the best first."""
    values = [-np.inf, *(one.evaluation.value for one in profile), -np.inf]
    tops = [
        one
        for number, one in enumerate(profile, start=1)
        if values[number] >= values[number - 1] and values[number] >= values[number + 1]
    ]
    return sorted(tops, key=lambda one: -one.evaluation.value)


def _best(criterion: Criterion, starts: Sequence[Float64], fixed: Sequence[int]) -> Maximum:
    found = [maximise(criterion, x, fixed, most_steps=SCAN_STEPS, tolerance=SCAN_TOLERANCE) for x in starts]
    return max(found, key=lambda one: one.evaluation.value)


def _moved(x: Float64, log_sigma: float) -> Float64:
    there = x.copy()
    there[LOG_SIGMA] = log_sigma
    return there
