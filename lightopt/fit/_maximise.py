"""Climb to the greatest likelihood by damped Newton steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._likelihood import FIRST_GAIN, LOG_R_S, R_D, Evaluation, Likelihood

__all__ = ["Maximum", "bounds", "maximise"]

Float64 = NDArray[np.float64]

TOLERANCE = 1e-4
"""A maximum is found when the next step promises less than this [nat]: a hundredth of a standard error."""

LEAST_LOG_TAU2, MOST_LOG_TAU2 = np.log(1e-4), np.log(1e10)
LEAST_LOGIT, MOST_LOGIT = -14.0, 2.0
LEAST_LOG_R_S, MOST_LOG_R_S = np.log(1e-3), np.log(1e12)
MOST_LOG_GAIN = np.log(100.0)
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
        Whether the last step promised nothing more.
    steps
        Number of evaluations.
    """

    x: Float64
    evaluation: Evaluation
    converged: bool
    steps: int


def bounds(likelihood: Likelihood) -> tuple[Float64, Float64]:
    """Lowest and highest value of each parameter, two arrays of shape (K,)."""
    low, high = np.full(likelihood.size, -np.inf), np.full(likelihood.size, np.inf)
    low[R_D] = 0.0
    low[LOG_R_S], high[LOG_R_S] = LEAST_LOG_R_S, MOST_LOG_R_S
    low[FIRST_GAIN : likelihood.log_tau2] = -MOST_LOG_GAIN
    high[FIRST_GAIN : likelihood.log_tau2] = MOST_LOG_GAIN
    low[likelihood.log_tau2], high[likelihood.log_tau2] = LEAST_LOG_TAU2, MOST_LOG_TAU2
    low[likelihood.logit_epsilon], high[likelihood.logit_epsilon] = LEAST_LOGIT, MOST_LOGIT
    return low, high


def maximise(
    likelihood: Likelihood,
    x: Float64,
    free: Sequence[int],
    *,
    most_steps: int = 60,
    tolerance: float = TOLERANCE,
) -> Maximum:
    """Climb from `x` along the free parameters.

    Parameters
    ----------
    likelihood
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
    low, high = bounds(likelihood)
    index = np.asarray(free, dtype=np.intp)
    low[~np.isin(np.arange(len(x)), index)] = -np.inf
    high[~np.isin(np.arange(len(x)), index)] = np.inf
    x = np.clip(x, low, high)
    here = likelihood.evaluate(x)
    damping = 1e-3
    steps, converged = 1, False
    while steps < most_steps:
        gradient = here.gradient[index]
        # a parameter at its bound that is pushed beyond it stays there
        stuck = ((x[index] <= low[index]) & (gradient < 0)) | ((x[index] >= high[index]) & (gradient > 0))
        moving = index[~stuck]
        if len(moving) == 0:
            converged = True
            break
        gradient = here.gradient[moving]
        matrix = here.curvature[np.ix_(moving, moving)]
        diagonal = np.maximum(np.diag(matrix), 1e-9)
        step = np.linalg.solve(matrix + np.diag(damping * diagonal), gradient)
        promise = float(gradient @ step)
        if promise < tolerance:
            converged = True
            break
        limit = np.where(moving == R_D, np.inf, LONGEST_STEP)
        step = np.clip(step, -limit, limit)
        trial = x.copy()
        trial[moving] += step
        trial = np.clip(trial, low, high)
        there = likelihood.evaluate(trial)
        steps += 1
        if there.value > here.value:
            x, here = trial, there
            damping = max(1e-6, 0.2 * damping)
        else:
            damping *= 8.0
            if damping > 1e8:
                converged = True
                break
    return Maximum(x=x, evaluation=here, converged=converged, steps=steps)
