"""The estimate where the model does not describe the images: least squares, with the scatter between lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightopt.estimate.reflectance._criterion import LOG_SIGMA
from lightopt.estimate.reflectance._estimate import Estimate
from lightopt.estimate.reflectance._jackknife import UNDETERMINED, leave_groups_out, rescaled_covariance
from lightopt.estimate.reflectance._likelihood import likelihood_at
from lightopt.estimate.reflectance._newton import has_settled, maximise
from lightopt.estimate.reflectance._profile_intervals import criterion_drop
from lightopt.estimate.reflectance._samples import Samples
from lightopt.estimate.reflectance._sigma_scan import SigmaScan, optimum_of, scan_points

ERROR_STEPS = (1.0, 0.3, 0.1)
"""How far from the best the drop of the criterion is taken [standard errors]; the first that is within range."""


def least_squares_estimate(samples: Samples, scan: SigmaScan, threads: int | None) -> Estimate:
    """The best of a scan, with standard errors from the fits without one group of images each."""
    best, criterion = scan.best, scan.criterion
    fitted = tuple(scan.free[:-2])
    scatter = leave_groups_out(criterion, best.x, fitted)
    spread = np.sqrt(np.diag(scatter.covariance))
    # no less than that of independent pixels, which the scatter of few groups may be by chance
    independent = np.sqrt(1.0 / np.maximum(np.diag(best.evaluation.curvature)[list(fitted)], 1e-300))
    errors = np.clip(np.maximum(spread, independent), 0.0, UNDETERMINED)
    covariance = rescaled_covariance(scatter.covariance, errors)
    best = replace(best, converged=has_settled(best, fitted, errors))
    # the noise that the likelihood would see around this reflectance, for figures that are compared
    noise = maximise(likelihood_at(samples, float(best.x[LOG_SIGMA]), threads), best.x, scan.free[-2:])
    found = Estimate(
        x=noise.x,
        free=fitted,
        covariance=covariance,
        inflation=np.ones(len(fitted)),
        critical=scatter.quantile**2,
        criterion=criterion,
        maximum=best,
        scan=scan_points([*scan.profile, best]),
        optima=tuple(
            optimum_of(start, top, criterion) for start, top in ((scan.climbs[0][0], best), *scan.climbs[1:])
        ),
        mean_log_likelihood=noise.evaluation.value / max(1, len(samples.sample)),
        unexplained=1.0 / (1.0 + math.exp(-noise.x[-1])),
        lack_of_fit=scan.lack_of_fit,
        scatter=scatter.of,
        unsettled_refits=sum(not has_settled(refit, fitted, errors) for refit in scatter.refits),
    )
    inflation = _inflation(found, errors)
    root = np.sqrt(inflation)
    return replace(found, covariance=covariance / np.outer(root, root), inflation=inflation)


def _inflation(found: Estimate, errors: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    # a standard error is where the criterion has dropped by this: 1 for a model that is right
    inflation = np.ones(len(found.free))
    best = found.maximum.x
    for i, (place, error) in enumerate(zip(found.free, errors, strict=True)):
        for step in ERROR_STEPS:
            # where one error away is out of range, nearer: the criterion falls like a parabola
            drops = [
                criterion_drop(found, place, best[place] + sign * step * error) / step**2
                for sign in (-1.0, 1.0)
            ]
            drops = [drop for drop in drops if 0.0 < drop < math.inf]
            if drops:
                inflation[i] = np.mean(drops)
                break
    return inflation
