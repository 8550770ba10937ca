"""Fit samples in three steps: a scan over σ, a test of the model, and the estimate.

Least squares of clipped levels come first, over the whole range of σ. They show whether the model describes the images:
where it does, the likelihood of noise and outliers is maximised, which is sharper and allows for dust; where it does
not, least squares are the answer, since they predict images best, and intervals come from the scatter between lights.
"""

import math
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.run_context import RunContext, part_of
from lightopt.estimate.reflectance._clipped_least_squares import LeastSquares, SpecularTable
from lightopt.estimate.reflectance._criterion import DARK, LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters
from lightopt.estimate.reflectance._lack_of_fit import find_dust
from lightopt.estimate.reflectance._least_squares_fit import least_squares_estimate
from lightopt.estimate.reflectance._likelihood import predicted
from lightopt.estimate.reflectance._likelihood_fit import USUAL_TABLE, climb, likelihood_estimate
from lightopt.estimate.reflectance._newton import has_settled, maximise
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._sigma_scan import scan_budget, scan_sigma
from lightopt.optics import Reflectance

# the likelihood's answer is only taken where it predicts the scan's pixels about as well as least squares [rms]
WORSE_PREDICTION = 1.03


def fit_reflectance(
    samples: Samples, *, freed: FreeParameters | None = None, held: Float64 | None = None, run: RunContext | None = None
) -> Estimate:
    """Fit R_d, R_s and σ, and what else is freed, to samples.

    held: Values (R_d, R_s, σ) of those that are not freed; required for those.
    Raises InputError: every pixel is saturated or black.
    """
    run = run or RunContext()
    scan = scan_sigma(samples, freed or FreeParameters(), held, part_of(run.stage("scanning σ"), 0.0, 0.5))
    if scan.lack_of_fit.significant:
        if (refining := run.stage("refining")) is not None:
            refining(0.5)
        return least_squares_estimate(samples, scan)
    found = likelihood_estimate(samples, scan, run)
    ratio = scan.criterion.mean_square(found.x) / scan.criterion.mean_square(scan.best.x)
    if ratio > WORSE_PREDICTION**2:
        return least_squares_estimate(samples, scan)
    return found


def least_squares_reflectance(
    samples: Samples, reflectance: Reflectance, *, freed: FreeParameters | None = None
) -> Reflectance:
    """R_d, R_s and σ by least squares alone, without intervals: good enough to find a part by.

    Raises InputError: every pixel is saturated or black.
    """
    x = scan_sigma(samples, freed or FreeParameters(), None).best.x
    return replace(reflectance, R_d=float(x[R_D]), R_s=math.exp(x[LOG_R_S]), sigma=math.exp(x[LOG_SIGMA]))


def refit(samples: Samples, start: Estimate, *, only_reflectance: bool = False) -> Estimate:
    """Fit the same parameters to other samples by the same criterion, from an estimate that cannot be far off.

    only_reflectance: Whether gains and dark level stay as they are.
    """
    size = start.criterion.size
    free = tuple(p for p in start.free if not only_reflectance or p < DARK or p >= size - 2)
    if start.describes:
        return climb(samples, start.x, free, USUAL_TABLE).as_estimate(start.scan)
    # as many pixels as the estimate itself is from
    few = subsample(samples, scan_budget(samples))
    criterion = LeastSquares(few, SpecularTable(few))
    criterion = criterion.without(find_dust(few, predicted(few, criterion.light(start.x), start.x)))
    top = maximise(criterion, start.x, free)
    errors = np.array([start.standard_error(place) for place in free])
    top = replace(top, converged=has_settled(top, free, errors))
    return replace(start, x=top.x, free=free, criterion=criterion, maximum=top, optima=())
