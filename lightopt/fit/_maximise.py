"""Climb to the greatest likelihood by damped Newton steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._criterion import FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, Criterion, Evaluation

__all__ = ["Maximum", "bounds", "has_settled", "maximise"]

Float64 = NDArray[np.float64]

TOLERANCE = 1e-4
"""A maximum is found when the next step promises less than this [nat]: a hundredth of a standard error."""

LEAST_LOG_TAU2, MOST_LOG_TAU2 = np.log(1e-4), np.log(1e10)
LEAST_LOGIT, MOST_LOGIT = -14.0, 2.0
LEAST_LOG_R_S, MOST_LOG_R_S = np.log(1e-3), np.log(1e12)
MOST_LOG_GAIN = np.log(100.0)
FREE_DAMPING = 1e-3
STALLED = 1e8
STALL_TOLERANCE = 0.02
"""A climb whose steps had to be damped this much has nowhere to go. It has converged where an undamped step promises
less than this [nat], a fifth of a standard error: a clipped level bends the criterion at single pixels."""

SETTLED = 0.1
"""Least squares have converged where no parameter has a step left of more than this share of its standard error."""

LONGEST_STEP = 1.5
"""No logarithm changes by more than this in one step."""


@dataclass(frozen=True, kw_only=True)
class Maximum:
    """Where a climb ended.

    Attributes
    ----------
    x
        Parameters, shape (K,).
    evaluation
        There.
    converged
        Whether no step promises anything more.
    unsettled
        Places of the parameters along which the criterion still rises; none where it converged.
    steps
        Number of evaluations.
    """

    x: Float64
    evaluation: Evaluation
    converged: bool
    unsettled: tuple[int, ...]
    steps: int


def bounds(criterion: Criterion) -> tuple[Float64, Float64]:
    """Lowest and highest value of each parameter, two arrays of shape (K,)."""
    size = criterion.size
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    low[R_D] = 0.0
    low[LOG_R_S], high[LOG_R_S] = LEAST_LOG_R_S, MOST_LOG_R_S
    low[LOG_SIGMA], high[LOG_SIGMA] = criterion.sigma_range
    low[FIRST_GAIN : size - 2] = -MOST_LOG_GAIN
    high[FIRST_GAIN : size - 2] = MOST_LOG_GAIN
    low[size - 2], high[size - 2] = LEAST_LOG_TAU2, MOST_LOG_TAU2
    low[size - 1], high[size - 1] = LEAST_LOGIT, MOST_LOGIT
    return low, high


def maximise(
    criterion: Criterion,
    x: Float64,
    free: Sequence[int],
    *,
    most_steps: int = 60,
    tolerance: float = TOLERANCE,
) -> Maximum:
    """Climb from `x` along the free parameters.

    Parameters
    ----------
    criterion
        To maximise.
    x
        Where to start, shape (K,).
    free
        Places of the parameters that may change.
    most_steps
        Evaluations after which to give up.
    tolerance
        Promise of a step that is not worth taking [nat].
    """
    low, high = bounds(criterion)
    index = np.asarray(free, dtype=np.intp)
    held = ~np.isin(np.arange(len(x)), index)
    low[held], high[held] = -np.inf, np.inf
    x = np.clip(x, low, high)
    here = criterion.evaluate(x)
    damping = FREE_DAMPING
    steps, converged = 1, False
    while steps < most_steps:
        moving = _movable(x, here, index, low, high)
        if len(moving) == 0:
            converged = True
            break
        gradient = here.gradient[moving]
        step = _newton_step(here, moving, damping)
        # a step that is damped promises little because it is short
        if float(gradient @ step) < tolerance and (
            damping <= FREE_DAMPING or _promise(here, moving) < max(tolerance, STALL_TOLERANCE)
        ):
            converged = True
            break
        limit = np.where(moving == R_D, np.inf, LONGEST_STEP)
        trial = x.copy()
        trial[moving] += np.clip(step, -limit, limit)
        trial = np.clip(trial, low, high)
        there = criterion.evaluate(trial)
        steps += 1
        if there.value > here.value:
            x, here = trial, there
            damping = max(1e-6, 0.2 * damping)
        else:
            damping *= 8.0
            if damping > STALLED:
                break
    moving = _movable(x, here, index, low, high)
    if not converged:
        converged = len(moving) == 0 or _promise(here, moving) < max(tolerance, STALL_TOLERANCE)
    unsettled: tuple[int, ...] = ()
    if not converged:
        gains = here.gradient[moving] ** 2 / np.maximum(np.diag(here.curvature)[moving], 1e-9)
        unsettled = tuple(int(place) for place in moving[gains > 0.1 * np.max(gains, initial=0.0)])
    return Maximum(x=x, evaluation=here, converged=converged, unsettled=unsettled, steps=steps)


def _movable(
    x: Float64, here: Evaluation, index: NDArray[np.intp], low: Float64, high: Float64
) -> NDArray[np.intp]:
    # a parameter at its bound that is pushed beyond it stays there
    gradient = here.gradient[index]
    stuck = ((x[index] <= low[index]) & (gradient < 0)) | ((x[index] >= high[index]) & (gradient > 0))
    return index[~stuck]


def has_settled(top: Maximum, free: Sequence[int], errors: Float64) -> bool:
    """Whether a climb has converged, or the step that is left is small beside the standard errors.

    A clipped level bends the criterion of least squares at single pixels, where what a step promises tells little.

    Parameters
    ----------
    top
        Where it ended.
    free
        Places of the parameters that were fitted.
    errors
        Their standard errors, shape (k,).
    """
    if top.converged:
        return True
    index = np.asarray(free, dtype=np.intp)
    moving = (index != R_D) | (top.x[index] > 0.0) | (top.evaluation.gradient[index] > 0.0)
    left = np.abs(_newton_step(top.evaluation, index[moving], 1e-6))
    return bool(np.all(left < SETTLED * errors[moving]))


def _newton_step(here: Evaluation, moving: NDArray[np.intp], damping: float) -> Float64:
    # a damping of 1 halves it, or shortens it more along a ridge
    matrix = here.curvature[np.ix_(moving, moving)]
    diagonal = np.maximum(np.diag(matrix), 1e-9)
    step = np.linalg.solve(matrix + np.diag(damping * diagonal), here.gradient[moving])
    return np.asarray(step, dtype=np.float64)


def _promise(here: Evaluation, moving: NDArray[np.intp]) -> float:
    # what a step that is hardly damped promises [nat]
    return float(here.gradient[moving] @ _newton_step(here, moving, 1e-6))
