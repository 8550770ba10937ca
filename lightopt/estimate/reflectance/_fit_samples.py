"""Fit samples in three steps: a scan over σ, a test of the model, and the estimate.

Least squares of clipped levels come first, over the whole range of σ. They show whether the model describes the images:
where it does, the likelihood of noise and outliers is maximised, which is sharper and allows for dust; where it does
not, least squares are the answer, since they predict images best.

Intervals of least squares come from the scatter between lights: what the model gets wrong is alike in all pixels of a
light, so that pixels show nothing of it. The estimates without one group of images each scatter as it takes (Efron and
Stein 1981, doi:10.1214/aos/1176345462).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from lightopt.core.arrays import Float64, Index
from lightopt.core.run_context import RunContext, part_of
from lightopt.estimate.reflectance._clipped_least_squares import MOST_MISFIT, LeastSquares, SpecularTable, find_dust
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters, Maximum, Optimum, has_settled, maximise
from lightopt.estimate.reflectance._likelihood import (
    DARK,
    FIRST_GAIN,
    LOG_SIGMA,
    likelihood_at,
    outlier_share,
    predicted,
)
from lightopt.estimate.reflectance._likelihood_fit import USUAL_TABLE, climb, likelihood_estimate
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._sigma_scan import SigmaScan, scan_budget, scan_points, scan_sigma
from lightopt.estimate.reflectance._uncertainty import criterion_drop

# the likelihood's answer is only taken where it predicts the scan's pixels about as well as least squares [rms]
WORSE_PREDICTION = 1.03

# Groups of images: lights, where there are so many, else lights by posture, else blocks of the images. Further lights
# share a group.
LEAST_GROUPS, MOST_GROUPS = 4, 24

# standard error of a parameter that the images do not determine, such as the σ of a lobe without light
UNDETERMINED = 1e3

# how far from the best the drop of the criterion is taken [standard errors]; the first that is within range
ERROR_STEPS = (1.0, 0.3, 0.1)


def fit_reflectance(
    samples: Samples, *, freed: FreeParameters | None = None, held: Float64 | None = None, run: RunContext | None = None
) -> Estimate:
    """Fit R_d, R_s and σ, and what else is freed, to samples; those that are not freed have the values `held`."""
    run = run or RunContext()
    scan = scan_sigma(samples, freed or FreeParameters(), held, part_of(run.stage("scanning σ"), 0.0, 0.5))
    if scan.misfit > MOST_MISFIT:
        run.stage("refining")(0.5)
        return _least_squares_estimate(samples, scan)
    found = likelihood_estimate(samples, scan, run)
    ratio = scan.criterion.mean_square(found.x) / scan.criterion.mean_square(scan.best.x)
    if ratio > WORSE_PREDICTION**2:
        return _least_squares_estimate(samples, scan)
    return found


def refit(samples: Samples, start: Estimate, *, only_reflectance: bool = False) -> Estimate:
    """Fit the same parameters to other samples by the same criterion, from an estimate that cannot be far off.

    only_reflectance: Whether gains and dark level stay as they are.
    """
    size = start.criterion.size
    free = tuple(p for p in start.free if not only_reflectance or p < DARK or p >= size - 2)
    if start.describes:
        return replace(climb(samples, start.x, free, USUAL_TABLE), scan=start.scan)
    # as many pixels as the estimate itself is from
    few = subsample(samples, scan_budget(samples))
    criterion = LeastSquares(few, SpecularTable(few))
    criterion = criterion.without(find_dust(few, predicted(few, criterion.light(start.x), start.x)))
    top = maximise(criterion, start.x, free)
    errors = np.array([start.standard_error(place) for place in free])
    top = replace(top, converged=has_settled(top, free, errors))
    return replace(start, x=top.x, free=free, criterion=criterion, maximum=top, optima=())


def _least_squares_estimate(samples: Samples, scan: SigmaScan) -> Estimate:
    # the best of a scan, with standard errors from the fits without one group of images each
    best, criterion = scan.best, scan.criterion
    fitted = tuple(scan.free[:-2])
    scatter = leave_groups_out(criterion, best.x, fitted)
    spread = np.sqrt(np.diag(scatter.covariance))
    # no less than that of independent pixels, which the scatter of few groups may be by chance
    independent = np.sqrt(1.0 / np.maximum(np.diag(best.evaluation.curvature)[list(fitted)], 1e-300))
    errors = np.clip(np.maximum(spread, independent), 0.0, UNDETERMINED)
    # the same correlations
    correlation = scatter.covariance / np.outer(np.maximum(spread, 1e-100), np.maximum(spread, 1e-100))
    np.fill_diagonal(correlation, 1.0)
    covariance = correlation * np.outer(errors, errors)
    best = replace(best, converged=has_settled(best, fitted, errors))
    # the noise that the likelihood would see around this reflectance, for figures that are compared
    noise = maximise(likelihood_at(samples, float(best.x[LOG_SIGMA])), best.x, scan.free[-2:])
    found = Estimate(
        x=noise.x,
        free=fitted,
        covariance=covariance,
        inflation=np.ones(len(fitted)),
        critical=scatter.quantile**2,
        criterion=criterion,
        maximum=best,
        scan=scan_points([*scan.profile, best]),
        optima=tuple(Optimum(start, top, criterion) for start, top in ((scan.climbs[0][0], best), *scan.climbs[1:])),
        mean_log_likelihood=noise.value / max(1, len(samples.sample)),
        unexplained=outlier_share(noise.x),
        misfit=scan.misfit,
        scatter=scatter.of,
        unsettled_refits=sum(not has_settled(refit, fitted, errors) for refit in scatter.refits),
    )
    inflation = _inflation(found, errors)
    root = np.sqrt(inflation)
    return replace(found, covariance=covariance / np.outer(root, root), inflation=inflation)


def _inflation(found: Estimate, errors: Sequence[float] | Float64) -> Float64:
    # a standard error is where the criterion has dropped by this: 1 for a model that is right
    inflation = np.ones(len(found.free))
    best = found.maximum.x
    for i, (place, error) in enumerate(zip(found.free, errors, strict=True)):
        for step in ERROR_STEPS:
            # where one error away is out of range, nearer: the criterion falls like a parabola
            drops = [criterion_drop(found, place, best[place] + sign * step * error) / step**2 for sign in (-1.0, 1.0)]
            drops = [drop for drop in drops if 0.0 < drop < math.inf]
            if drops:
                inflation[i] = np.mean(drops)
                break
    return inflation


@dataclass(frozen=True, kw_only=True)
class Jackknife:
    """Scatter of the estimates without one group of images each."""

    covariance: Float64  # shape (k, k); very large where there is only one group
    of: str  # number of groups and what they are, such as "12 lights"
    quantile: float  # Student's t of a two-sided 95 % interval for so many groups
    refits: tuple[Maximum, ...] = ()  # the fits without one group each


def leave_groups_out(criterion: LeastSquares, x: Float64, free: Sequence[int]) -> Jackknife:
    """Fit again without each group of images.

    A light that is left out shows nothing of its own gain, nor do the others of what theirs are relative to: where
    gains are free, blocks of the images are left out as well.
    """
    candidates = _groups(criterion.samples)
    by_block = candidates[-1]
    groups = next((one for one in candidates if _count(one[0]) >= LEAST_GROUPS), by_block)
    found = _scatter(criterion, x, free, *groups)
    if groups is by_block or all(place < FIRST_GAIN for place in free):
        return found
    blocks = _scatter(criterion, x, free, *by_block)
    covariance = upper_covariance(found.covariance, blocks.covariance)
    return replace(found, covariance=covariance, of=f"{found.of} and {blocks.of}", refits=found.refits + blocks.refits)


def upper_covariance(covariance: Float64, other: Float64) -> Float64:
    """A covariance that is no smaller than either of two in any direction: the first, and by what the second is larger.

    Standard errors alone would leave the correlations of the first: the lights move R_s and σ along their ridge, pieces
    of the light that gains are relative to move R_s by itself.
    """
    unit = np.sqrt(np.maximum(np.maximum(np.diag(covariance), np.diag(other)), 1e-200))
    scale = np.outer(unit, unit)
    values, vectors = np.linalg.eigh((other - covariance) / scale)
    more = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return covariance + 0.5 * (more + more.T) * scale


def _scatter(criterion: LeastSquares, x: Float64, free: Sequence[int], label: Index, of: str) -> Jackknife:
    # without each group, as numbered by `label`
    count = _count(label)
    each = math.ceil(count / MOST_GROUPS)
    if each > 1:
        # neighbours in number are rarely neighbours in place
        label, of = label % math.ceil(count / each), f"groups of {of}"
        count = _count(label)
    index = list(free)
    covariance, refits = UNDETERMINED**2 * np.eye(len(index)), tuple[Maximum, ...]()
    if count >= 2:
        refits = tuple(maximise(criterion.without(label == k), x, free) for k in range(count))
        found = np.array([refit.x[index] for refit in refits])
        off = found - found.mean(axis=0)
        covariance = (count - 1.0) / count * off.T @ off
    quantile = float(stdtrit(max(count - 1, 1), 0.975))
    return Jackknife(covariance=covariance, of=f"{count} {of}", quantile=quantile, refits=refits)


def _count(label: Index) -> int:
    return int(label.max(initial=-1)) + 1


def _groups(samples: Samples) -> list[tuple[Index, str]]:
    # what may be left out together, as a number per observation
    light = samples.facts.light[samples.image]
    postures = list(dict.fromkeys(image.posture for image in samples.images))
    posture = np.array([postures.index(image.posture) for image in samples.images])[samples.image]
    both, block = light * len(postures) + posture, samples.block[samples.sample]
    labels = {"lights": light, "lights and postures": both, "pieces of the images": block}
    return [(np.unique(label, return_inverse=True)[1], name) for name, label in labels.items()]
