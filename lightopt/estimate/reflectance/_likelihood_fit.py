"""The estimate where the model describes the images: the greatest likelihood of noise and outliers.

A subset of the samples is scanned over σ, from where least squares ended. Every peak is climbed, first on the subset,
then on all samples, which decide between peaks.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.run_context import RunContext, Share, part_of
from lightopt.estimate.reflectance._estimate import CHI2_95, Estimate, Maximum, Optimum, ScanPoint, maximise
from lightopt.estimate.reflectance._likelihood import LOG_SIGMA, Likelihood, likelihood_at, outlier_share
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._sigma_scan import (
    SAME_PEAK,
    SigmaScan,
    climb_from_peaks,
    profile_outwards,
    scan_budget,
    scan_points,
)
from lightopt.estimate.reflectance._uncertainty import uncertainty

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


def likelihood_estimate(samples: Samples, scan: SigmaScan, run: RunContext) -> Estimate:
    """Maximise the likelihood of all samples from what a scan by least squares found."""
    few = subsample(scan.samples, max(50, scan_budget(samples) // SUBSET_SHARE))
    profile = _profile_on_subset(few, scan, part_of(run.stage("scanning σ"), 0.5, 1.0))
    tops = climb_from_peaks(profile, lambda x: climb(few, x, scan.free, USUAL_TABLE))
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
        points = scan_points(profile, share=_share_of(few, samples))
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
            covariance, inflation = uncertainty(likelihood, maximum.x, free)
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
        if all(abs(at - other.top.x[LOG_SIGMA]) > SAME_PEAK for other, _ in distinct):
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
    return max(CLOSE_CALL, 0.5 * CHI2_95 * float(np.max(found.inflation, initial=1.0)))


def _profile_on_subset(few: Samples, scan: SigmaScan, progress: Share) -> list[Maximum]:
    def starts_at(number: int) -> list[Float64]:
        # what least squares leave at this σ, and the usual start with its wide shoulders
        at = scan.profile[number].x
        other = at.copy()
        other[-2] = math.log(scan.mean_square(number))
        other[-1] = scan.starts[number][-1]
        return [other, scan.starts[number]]

    values = [point.value for point in scan.profile]
    at, begin = scan.log_sigmas, values.index(max(values))
    return profile_outwards(lambda s: likelihood_at(few, s), starts_at, at, scan.free, begin=begin, progress=progress)


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
        return scan_points([replace(profile[0], x=final.x)]), None
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
    return scan_points(shown, share=share), None


def _best_at(samples: Samples, x: Float64, free: Sequence[int]) -> Maximum:
    # the best of all other parameters at the σ of `x`
    likelihood = likelihood_at(samples, float(x[LOG_SIGMA]))
    return maximise(likelihood, x, [place for place in free if place != LOG_SIGMA])


def _share_of(few: Samples, samples: Samples) -> float:
    return len(few.sample) / max(1, len(samples.sample))
