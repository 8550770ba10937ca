"""Fit samples in three steps: a scan over σ, a test of the model, and the estimate.

Least squares of clipped levels come first, over the whole range of σ. They show whether the model describes the images:
where it does, the likelihood of noise and outliers is maximised, which is sharper and allows for dust; where it does
not, least squares are the answer, since they predict images best.

For the likelihood a subset of the samples is scanned over σ, from where least squares ended. Every peak is climbed,
first on the subset, then on all samples, which decide between peaks.

Intervals of least squares come from the scatter between lights: what the model gets wrong is alike in all pixels of a
light, so that pixels show nothing of it. The estimates without one group of images each scatter as it takes (Efron and
Stein 1981, doi:10.1214/aos/1176345462).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import stdtrit

from lightopt.core.arrays import Float64, Index
from lightopt.core.run_context import RunContext, Share, part_of
from lightopt.estimate.reflectance import _estimate, _sigma_scan
from lightopt.estimate.reflectance._clipped_least_squares import MOST_MISFIT, LeastSquares, SpecularTable, find_dust
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters, Maximum, Optimum, ScanPoint, maximise
from lightopt.estimate.reflectance._likelihood import Likelihood, likelihood_at, predicted
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_SIGMA, outlier_share

SUBSET_SHARE = 4  # by how much fewer pixels than least squares the likelihood scans: it starts where least squares end
# peaks and points of the scan within this of the best [nat] are evaluated on all samples, which decide
CLOSE_CALL = 20.0
MOST_RESTARTS = 3
TABLE_NODES, WIDE_TABLE_NODES = 5, 9
MOST_TABLES = 8
USUAL_TABLE = 0.06
NARROWEST_TABLE, WIDEST_TABLE = 0.003, 0.24
# the likelihood's specular light is tabulated at ln σ this many standard errors around the estimate, without and with
# what the model gets wrong, so that it is a smooth function of σ whatever quadrature is behind it
TABLE_DEVIATIONS, TABLE_INTERVALS = 6.0, 3.0
# an optimum of all samples and its climb; None for one far below the best, where only the subset was climbed
Peak = tuple[Optimum, Estimate | None]


def likelihood_estimate(samples: Samples, scan: _sigma_scan.SigmaScan, run: RunContext) -> Estimate:
    """Maximise the likelihood of all samples from what a scan by least squares found."""
    few = subsample(scan.samples, max(50, _sigma_scan.scan_budget(samples) // SUBSET_SHARE))
    profile = _profile_on_subset(few, scan, part_of(run.stage("scanning σ"), 0.5, 1.0))
    tops = _sigma_scan.climb_from_peaks(profile, lambda x: climb(few, x, scan.free, USUAL_TABLE))
    report = run.stage("refining")
    report(0.2)
    best, peaks = best_first(_climb_on_all(samples, tops))
    report(0.9)
    points, better = _profile_on_all(samples, few, profile, best)
    for _ in range(MOST_RESTARTS):
        if better is None:
            break
        again = _final_climb(samples, climb(few, better, scan.free, USUAL_TABLE), start=better)
        start = math.exp(better[LOG_SIGMA])
        best, peaks = best_first([*peaks, _peak(start, again)])
        points, better = _profile_on_all(samples, few, profile, best)
    if better is not None:  # there is something better still: reported, and not passed for the best
        best = replace(best, maximum=replace(best.maximum, converged=False))
        points = _sigma_scan.scan_points(profile, share=_share_of(few, samples))
    report(1.0)
    optima, unexplained = tuple(optimum for optimum, _ in peaks), max(best.unexplained, outlier_share(tops[0][1].x))
    return replace(best, scan=points, optima=optima, unexplained=unexplained, misfit=scan.misfit)


def climb(samples: Samples, x: Float64, free: Sequence[int], width: float) -> Estimate:
    """Maximise the likelihood from `x`, the specular light tabulated around its σ; an estimate without a scan.

    Where the climb leaves the table, a table is made around the place that it left for.
    """
    moves = 0
    while True:
        count = TABLE_NODES if width <= USUAL_TABLE else WIDE_TABLE_NODES
        offsets = width * np.linspace(-1.0, 1.0, count) if LOG_SIGMA in free else np.zeros(1)
        nodes = x[LOG_SIGMA] + offsets
        table = np.stack([samples.specular(math.exp(node)) for node in nodes], axis=1)
        likelihood = Likelihood(samples, nodes, table)
        maximum = maximise(likelihood, x, free)
        moves += 1
        inside = abs(float(maximum.x[LOG_SIGMA] - x[LOG_SIGMA])) <= 0.7 * width
        if inside or LOG_SIGMA not in free or moves == MOST_TABLES:
            covariance, inflation = _estimate.uncertainty(likelihood, maximum.x, free)
            return Estimate(
                x=maximum.x,
                free=tuple(free),
                covariance=covariance,
                inflation=inflation,
                criterion=likelihood,
                maximum=replace(maximum, converged=maximum.converged and (inside or LOG_SIGMA not in free)),
                scan=(),
                mean_log_likelihood=maximum.value / max(1, len(samples.level)),
                unexplained=outlier_share(maximum.x),
            )
        x = maximum.x.copy()
        x[LOG_SIGMA] = np.clip(x[LOG_SIGMA], nodes[0] - width, nodes[-1] + width)


def best_first(peaks: Sequence[Peak]) -> tuple[Estimate, list[Peak]]:
    """The best climb, and all peaks from the best on, without those that ended where a better one did."""
    distinct: list[Peak] = []
    for optimum, ended in sorted(peaks, key=lambda peak: -peak[0].top.value):
        at = optimum.top.x[LOG_SIGMA]
        if all(abs(at - other.top.x[LOG_SIGMA]) > _sigma_scan.SAME_PEAK for other, _ in distinct):
            distinct.append((optimum, ended))
    best = distinct[0][1]
    assert best is not None  # one that is not far below has been climbed to
    return best, distinct


def _peak(start_sigma: float, ended: Estimate) -> Peak:
    return Optimum(start_sigma, ended.maximum, ended.criterion), ended


def _table_width(found: Estimate) -> float:
    # half-width in ln σ that a table around a maximum should have
    if LOG_SIGMA not in found.free:
        return USUAL_TABLE
    i = found.free.index(LOG_SIGMA)
    wanted = math.sqrt(found.covariance[i, i]) * max(TABLE_DEVIATIONS, TABLE_INTERVALS * math.sqrt(found.inflation[i]))
    return float(np.clip(wanted, NARROWEST_TABLE, WIDEST_TABLE))


def _relevant_drop(found: Estimate) -> float:
    # how far below a maximum something may be and still matter, for the intervals or by chance [nat]
    return max(CLOSE_CALL, 0.5 * _estimate.CHI2_95 * float(np.max(found.inflation, initial=1.0)))


def _profile_on_subset(few: Samples, scan: _sigma_scan.SigmaScan, progress: Share) -> list[Maximum]:
    def starts_at(number: int) -> list[Float64]:
        # what least squares leave at this σ, and the usual start with its wide shoulders
        at = scan.profile[number].x
        other = at.copy()
        other[-2] = math.log(scan.mean_square(number))
        other[-1] = scan.starts[number][-1]
        return [other, scan.starts[number]]

    values = [point.value for point in scan.profile]
    at, begin = scan.log_sigmas, values.index(max(values))
    fitted = partial(likelihood_at, few)
    return _sigma_scan.profile_outwards(fitted, starts_at, at, scan.free, begin=begin, progress=progress)


def _climb_on_all(samples: Samples, tops: Sequence[tuple[float, Estimate]]) -> list[Peak]:
    # optima of the subset, the best first, as optima of all samples. One that is far below stays where it is, with the
    # value that all samples have there, unless that is not far below
    best = tops[0][1].value
    close = [(start, top) for start, top in tops if best - top.value < CLOSE_CALL]
    finals = [(start, _final_climb(samples, top)) for start, top in close]
    peaks = [_peak(start, final) for start, final in finals]
    least = max(final.value - _relevant_drop(final) for _, final in finals)
    for start, top in tops[len(close) :]:
        there = _best_at(samples, top.x, top.free)
        if there.value > least:
            peaks.append(_peak(start, _final_climb(samples, top)))
        else:
            peaks.append((Optimum(start, replace(there, converged=top.maximum.converged), None), None))
    return peaks


def _final_climb(samples: Samples, coarse: Estimate, *, start: Float64 | None = None) -> Estimate:
    # on all samples, with a table as wide as the maximum needs
    width = _table_width(coarse)
    final = climb(samples, coarse.x if start is None else start, coarse.free, width)
    needed = _table_width(final)
    return final if 0.5 * width <= needed <= 1.5 * width else climb(samples, final.x, coarse.free, needed)


def _profile_on_all(
    samples: Samples, few: Samples, profile: Sequence[Maximum], final: Estimate
) -> tuple[tuple[ScanPoint, ...], Float64 | None]:
    # The profile of the subset with the estimate itself on it. Where the subset does not surely prefer the estimate,
    # all samples decide: they either have something better to climb from, or show how much worse it is.
    share = _share_of(few, samples)
    if LOG_SIGMA not in final.free:
        return _sigma_scan.scan_points([replace(profile[0], x=final.x)]), None
    here = _best_at(few, final.x, final.free)
    value = here.value
    near = max(CLOSE_CALL, share * _relevant_drop(final))
    shown: list[Maximum] = [replace(here, x=final.x)]
    for point in profile:
        if point.value > value - near:
            whole = _best_at(samples, point.x, final.free)
            if whole.value > final.value:
                return (), whole.x
            worse = share * (final.value - whole.value)
            point = replace(whole, evaluation=replace(whole.evaluation, value=value - worse))
        shown.append(point)
    return _sigma_scan.scan_points(shown, share=share), None


def _best_at(samples: Samples, x: Float64, free: Sequence[int]) -> Maximum:
    # the best of all other parameters at the σ of `x`
    likelihood = likelihood_at(samples, float(x[LOG_SIGMA]))
    return maximise(likelihood, x, [place for place in free if place != LOG_SIGMA])


def _share_of(few: Samples, samples: Samples) -> float:
    return len(few.sample) / max(1, len(samples.sample))


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
    scan = _sigma_scan.scan_sigma(samples, freed or FreeParameters(), held, part_of(run.stage("scanning σ"), 0.0, 0.5))
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
    few = subsample(samples, _sigma_scan.scan_budget(samples))
    criterion = LeastSquares(few, SpecularTable(few))
    criterion = criterion.without(find_dust(few, predicted(few, criterion.light(start.x), start.x)))
    top = maximise(criterion, start.x, free)
    errors = np.array([start.standard_error(place) for place in free])
    top = replace(top, converged=_estimate.has_settled(top, free, errors))
    return replace(start, x=top.x, free=free, criterion=criterion, maximum=top, optima=())


def _least_squares_estimate(samples: Samples, scan: _sigma_scan.SigmaScan) -> Estimate:
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
    best = replace(best, converged=_estimate.has_settled(best, fitted, errors))
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
        scan=_sigma_scan.scan_points([*scan.profile, best]),
        optima=tuple(Optimum(start, top, criterion) for start, top in ((scan.climbs[0][0], best), *scan.climbs[1:])),
        mean_log_likelihood=noise.value / max(1, len(samples.sample)),
        unexplained=outlier_share(noise.x),
        misfit=scan.misfit,
        scatter=scatter.of,
        unsettled_refits=sum(not _estimate.has_settled(refit, fitted, errors) for refit in scatter.refits),
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
            drops = [
                _estimate.criterion_drop(found, place, best[place] + sign * step * error) / step**2
                for sign in (-1.0, 1.0)
            ]
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
