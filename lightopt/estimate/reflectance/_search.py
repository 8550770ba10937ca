"""The default fit: one criterion over all σ, every peak of it climbed, the best of them down to the last digit.

Least squares of clipped levels come first, over the whole range of σ. They say whether the model describes the images:
where it does, the likelihood of noise and outliers is maximised, which is sharper and knows dust; where it does not,
least squares are the answer, since they predict images best, and intervals come from the scatter between lights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.estimate.reflectance._clipped_least_squares import LeastSquares, SpecularTable
from lightopt.estimate.reflectance._estimate import CHI2_95, Estimate, Freed, Optimum, ScanPoint
from lightopt.estimate.reflectance._jackknife import UNDETERMINED, leave_groups_out, with_errors
from lightopt.estimate.reflectance._lack_of_fit import LackOfFit, find_dust, measure_lack_of_fit
from lightopt.estimate.reflectance._likelihood import Likelihood, predicted
from lightopt.estimate.reflectance._likelihood_criterion import (
    DARK,
    FIRST_GAIN,
    LOG_R_S,
    LOG_SIGMA,
    R_D,
    Criterion,
)
from lightopt.estimate.reflectance._newton import Maximum, has_settled, maximise
from lightopt.estimate.reflectance._profile_intervals import fall
from lightopt.estimate.reflectance._samples import Samples, thinned
from lightopt.estimate.reflectance._sigma_profile import peaks, profile_outwards, profile_over_sigma
from lightopt.estimate.reflectance._start import first_guess, start_at
from lightopt.estimate.reflectance._uncertainty import uncertainty
from lightopt.optics import Reflectance

Float64 = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""

SCAN_SAMPLES = 50_000
LIKELIHOOD_SHARE = 4
"""Pixels of the scan over σ, in all, and by how much fewer the likelihood scans: it starts where least squares end."""

SCAN_STRIDE = 5
"""The scan looks at each fifth node of the specular table: 25 σ, each 1.29 times the one before."""

WEAK_START = 0.1
"""Share of the R_s that saturates as many pixels as measured, from which least squares climb as well."""

WORSE_PREDICTION = 1.03
"""The likelihood's answer is only taken where it predicts the scan's pixels about as well as least squares [rms]."""

MOST_PEAKS = 4
SAME_PEAK = 0.02
"""Climbs that end within this of ln σ have found the same."""

CLOSE_CALL = 20.0
"""Peaks and points of the scan that are within this of the best [nat] are looked at on all samples, which decide."""

MOST_RESTARTS = 3

ERROR_STEPS = (1.0, 0.3, 0.1)
"""How far from the best the fall of the criterion is looked at [standard errors]; the first that is within range."""

HELD_SIGMA = 0.05
"""Width of a lobe that is not fitted and not said."""

TABLE_NODES, WIDE_TABLE_NODES = 5, 9
MOST_TABLES = 8
USUAL_TABLE = 0.06
NARROWEST_TABLE, WIDEST_TABLE = 0.003, 0.24
TABLE_DEVIATIONS, TABLE_INTERVALS = 6.0, 3.0
"""The likelihood's specular light is tabulated at ln σ this many standard errors around the estimate, without and with
what the model gets wrong, so that it is a smooth function of σ whatever quadrature is behind it."""


@dataclass(frozen=True)
class _Climbed:
    likelihood: Likelihood
    maximum: Maximum
    free: tuple[int, ...]
    covariance: Float64
    inflation: Float64

    @property
    def value(self) -> float:
        return self.maximum.evaluation.value

    @property
    def width(self) -> float:
        """That a table around this maximum should have."""
        if LOG_SIGMA not in self.free:
            return USUAL_TABLE
        i = self.free.index(LOG_SIGMA)
        error = math.sqrt(self.covariance[i, i])
        wanted = error * max(TABLE_DEVIATIONS, TABLE_INTERVALS * math.sqrt(self.inflation[i]))
        return float(np.clip(wanted, NARROWEST_TABLE, WIDEST_TABLE))

    @property
    def reach(self) -> float:
        """How far below this maximum something may be and still matter, for the intervals or by chance [nat]."""
        return max(CLOSE_CALL, 0.5 * CHI2_95 * float(np.max(self.inflation, initial=1.0)))


@dataclass(frozen=True)
class _Found:
    # an optimum of all samples, and the start of its climb; one far below the best is as the scan's pixels have it
    start_sigma: float
    maximum: Maximum
    climbed: _Climbed | None

    @property
    def value(self) -> float:
        return self.maximum.evaluation.value

    @property
    def optimum(self) -> Optimum:
        criterion = None if self.climbed is None else self.climbed.likelihood
        return _optimum(self.start_sigma, self.maximum, criterion)


@dataclass(frozen=True)
class _Squares:
    # least squares over all σ: the profile, the climbs from its peaks, the best of them first
    criterion: LeastSquares
    profile: list[Maximum]
    climbs: list[tuple[float, Maximum]]
    lack_of_fit: LackOfFit

    @property
    def best(self) -> Maximum:
        return self.climbs[0][1]

    def mean_square(self, number: int) -> float:
        # of the profile at one of its σ [sensor level²], from the value of the criterion
        count = max(1, len(self.criterion.samples.sample))
        return math.exp(-2.0 * self.profile[number].evaluation.value / count - 1.0) / (2.0 * math.pi)


@dataclass(frozen=True)
class _SigmaScan:
    # the range of ln σ looked at, with the samples and the starts that were used
    samples: Samples
    free: tuple[int, ...]
    row: list[float]
    starts: list[Float64]
    squares: _Squares


def estimate(
    samples: Samples,
    *,
    freed: Freed | None = None,
    held: Float64 | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Fit R_d, R_s and σ, and what else is freed, to samples.

    Parameters
    ----------
    samples
        From :func:`lightopt.estimate.reflectance.collect_samples`.
    freed
        What may change.
    held
        Values (R_d, R_s, σ) of what may not; required for those.
    threads
        Number of threads; the result does not depend on it.
    progress
        Called as the fit goes on.

    Raises
    ------
    InputError
        Every pixel is saturated or black.
    """
    report = progress or (lambda _stage, _share: None)
    scanned = _scan_sigma(
        samples, freed or Freed(), held, threads, lambda share: report("scanning σ", 0.5 * share)
    )
    squares, free = scanned.squares, scanned.free
    if squares.lack_of_fit.significant:
        report("refining", 0.5)
        return _by_least_squares(samples, squares, free, threads)
    fewer = thinned(scanned.samples, max(50, _scan_budget(samples) // LIKELIHOOD_SHARE))
    found = _by_likelihood(samples, fewer, scanned, threads, report)
    ratio = squares.criterion.mean_square(found.x) / squares.criterion.mean_square(squares.best.x)
    if ratio > WORSE_PREDICTION**2:
        return _by_least_squares(samples, squares, free, threads)
    return found


def rough_reflectance(
    samples: Samples, reflectance: Reflectance, *, freed: Freed | None = None, threads: int | None = None
) -> Reflectance:
    """Reflectance by least squares alone, which predicts images well enough to find a part by; without intervals.

    Parameters
    ----------
    samples
        From :func:`lightopt.estimate.reflectance.collect_samples`.
    reflectance
        Whose R_d, R_s and σ are replaced.
    freed
        What may change.
    threads
        Number of threads; the result does not depend on it.

    Raises
    ------
    InputError
        Every pixel is saturated or black.
    """
    x = _scan_sigma(samples, freed or Freed(), None, threads, lambda _share: None).squares.best.x
    return replace(reflectance, R_d=float(x[R_D]), R_s=math.exp(x[LOG_R_S]), sigma=math.exp(x[LOG_SIGMA]))


def refine(
    samples: Samples, start: Estimate, *, only_reflectance: bool = False, threads: int | None = None
) -> Estimate:
    """Fit the same parameters to other samples by the same criterion, from an estimate that cannot be far off.

    Parameters
    ----------
    samples
        The others.
    start
        Where to climb from.
    only_reflectance
        Whether gains and dark level stay as they are.
    threads
        Number of threads; the result does not depend on it.
    """
    size = start.criterion.size
    free = tuple(p for p in start.free if not only_reflectance or p < DARK or p >= size - 2)
    if start.describes:
        return _of_likelihood(_climb(samples, start.x, free, USUAL_TABLE, threads), start.scan)
    # as many pixels as the estimate itself is from
    few = thinned(samples, _scan_budget(samples))
    criterion = LeastSquares(few, SpecularTable(few, threads=threads), threads=threads)
    criterion = criterion.without(find_dust(few, predicted(few, criterion.light(start.x), start.x)))
    top = maximise(criterion, start.x, free)
    errors = np.array([start.standard_error(place) for place in free])
    top = replace(top, converged=has_settled(top, free, errors))
    return replace(start, x=top.x, free=free, criterion=criterion, maximum=top, optima=())


def _scan_sigma(
    samples: Samples,
    freed: Freed,
    held: Float64 | None,
    threads: int | None,
    progress: Callable[[float], None],
) -> _SigmaScan:
    few = thinned(samples, _scan_budget(samples))
    free = _places(samples, freed)
    guess = first_guess(few)
    r_d = guess if freed.diffuse or held is None else float(held[0])
    table = SpecularTable(few, threads=threads)
    if freed.specular:
        row = [float(node) for node in table.nodes[::SCAN_STRIDE]]
        columns = [table.column(number) for number in range(0, len(table.nodes), SCAN_STRIDE)]
        log_r_s = None
    else:
        row = [math.log(HELD_SIGMA if held is None else held[2])]
        columns = [few.specular(math.exp(row[0]), threads=threads)]
        log_r_s = None if held is None else math.log(max(held[1], 1e-6))
    starts = [start_at(few, column, math.exp(at), r_d) for at, column in zip(row, columns, strict=True)]
    if log_r_s is not None:
        starts[0][LOG_R_S] = log_r_s
    squares = _least_squares(few, table, row, columns, starts, free[:-2], threads, progress)
    return _SigmaScan(few, tuple(free), row, starts, squares)


def _least_squares(
    few: Samples,
    table: SpecularTable,
    row: Sequence[float],
    columns: Sequence[Float64],
    starts: Sequence[Float64],
    free: Sequence[int],
    threads: int | None,
    progress: Callable[[float], None],
) -> _Squares:
    def search(
        samples: Samples, starts_at: Callable[[int], list[Float64]]
    ) -> tuple[LeastSquares, list[Maximum], list[tuple[float, Maximum]]]:
        criterion = LeastSquares(samples, table, threads=threads)
        by_sigma = {
            at: LeastSquares(samples, table, fixed=(at, column), threads=threads)
            for at, column in zip(row, columns, strict=True)
        }
        profile = profile_over_sigma(by_sigma.__getitem__, starts_at, row, free, progress=progress)
        if LOG_SIGMA not in free:
            return by_sigma[row[0]], profile, [(math.exp(row[0]), profile[0])]
        return criterion, profile, _climbed(profile, lambda x: maximise(criterion, x, free))

    def wide(number: int) -> list[Float64]:
        weak = starts[number].copy()
        weak[LOG_R_S] += math.log(WEAK_START) if LOG_R_S in free else 0.0
        return [starts[number], weak]

    criterion, profile, climbs = search(few, wide)
    best = climbs[0][1].x
    dust = find_dust(few, predicted(few, criterion.light(best), best))
    if dust.any():
        first = profile
        criterion, profile, climbs = search(few.keep(~dust), lambda number: [first[number].x])
    lack = measure_lack_of_fit(criterion, climbs[0][1].x, dust=float(np.mean(dust)))
    return _Squares(criterion, profile, climbs, lack)


def _climbed(profile: Sequence[Maximum], climb: Callable[[Float64], Maximum]) -> list[tuple[float, Maximum]]:
    # from each peak of a profile to its top; σ of the peak and the top, the best first
    tops: list[tuple[float, Maximum]] = []
    for peak in peaks(profile)[:MOST_PEAKS]:
        top = climb(peak.x)
        if all(abs(top.x[LOG_SIGMA] - other.x[LOG_SIGMA]) > SAME_PEAK for _, other in tops):
            tops.append((math.exp(peak.x[LOG_SIGMA]), top))
    return sorted(tops, key=lambda one: -one[1].evaluation.value)


def _by_least_squares(
    samples: Samples, squares: _Squares, free: Sequence[int], threads: int | None
) -> Estimate:
    best, criterion = squares.best, squares.criterion
    plain = tuple(free[:-2])
    scatter = leave_groups_out(criterion, best.x, plain)
    spread = np.sqrt(np.diag(scatter.covariance))
    # no less than that of independent pixels, which the scatter of few groups may be by chance
    alone = np.sqrt(1.0 / np.maximum(np.diag(best.evaluation.curvature)[list(plain)], 1e-300))
    errors = np.clip(np.maximum(spread, alone), 0.0, UNDETERMINED)
    covariance = with_errors(scatter.covariance, errors)
    best = replace(best, converged=has_settled(best, plain, errors))
    # the noise that the likelihood would see around this reflectance, for figures that are compared
    noise = maximise(_likelihood_at(samples, float(best.x[LOG_SIGMA]), threads), best.x, free[-2:])
    found = Estimate(
        x=noise.x,
        free=plain,
        covariance=covariance,
        inflation=np.ones(len(plain)),
        critical=scatter.quantile**2,
        criterion=criterion,
        maximum=best,
        scan=_scan_points([*squares.profile, best]),
        optima=tuple(
            _optimum(start, top, criterion)
            for start, top in ((squares.climbs[0][0], best), *squares.climbs[1:])
        ),
        mean_log_likelihood=noise.evaluation.value / max(1, len(samples.sample)),
        unexplained=_share(noise.x),
        lack_of_fit=squares.lack_of_fit,
        scatter=scatter.of,
        unsettled_refits=sum(not has_settled(refit, plain, errors) for refit in scatter.refits),
    )
    # a standard error is where the criterion has fallen by this: 1 for a model that is right
    inflation = np.ones(len(plain))
    for i, (place, error) in enumerate(zip(plain, errors, strict=True)):
        for step in ERROR_STEPS:
            # where one error away is out of range, nearer: the criterion falls like a parabola
            drops = [
                fall(found, place, best.x[place] + sign * step * error) / step**2 for sign in (-1.0, 1.0)
            ]
            drops = [drop for drop in drops if 0.0 < drop < math.inf]
            if drops:
                inflation[i] = np.mean(drops)
                break
    root = np.sqrt(inflation)
    return replace(found, covariance=covariance / np.outer(root, root), inflation=inflation)


def _by_likelihood(
    samples: Samples,
    few: Samples,
    scanned: _SigmaScan,
    threads: int | None,
    report: Progress,
) -> Estimate:
    row, starts, squares, free = scanned.row, scanned.starts, scanned.squares, scanned.free

    def starts_at(number: int) -> list[Float64]:
        # what least squares leave at this σ, and the usual start with its wide shoulders
        at = squares.profile[number].x
        other = at.copy()
        other[-2] = math.log(squares.mean_square(number))
        other[-1] = starts[number][-1]
        return [other, starts[number]]

    values = [point.evaluation.value for point in squares.profile]
    profile = profile_outwards(
        lambda at: _likelihood_at(few, at, threads),
        starts_at,
        row,
        free,
        begin=values.index(max(values)),
        progress=lambda share: report("scanning σ", 0.5 + 0.5 * share),
    )
    coarse: dict[int, _Climbed] = {}

    def climb(x: Float64) -> Maximum:
        climbed = _climb(few, x, free, USUAL_TABLE, threads)
        coarse[id(climbed.maximum)] = climbed
        return climbed.maximum

    tops = _climbed(profile, climb)
    report("refining", 0.2)
    final, optima = _best_first(
        _on_samples(samples, [(start, coarse[id(top)]) for start, top in tops], threads)
    )
    report("refining", 0.9)
    scan, better = _profile_on_samples(samples, few, profile, final, threads)
    for _ in range(MOST_RESTARTS):
        if better is None:
            break
        again = _final(samples, _climb(few, better, free, USUAL_TABLE, threads), threads, start=better)
        start = math.exp(better[LOG_SIGMA])
        final, optima = _best_first([*optima, _Found(start, again.maximum, again)])
        scan, better = _profile_on_samples(samples, few, profile, final, threads)
    found = _of_likelihood(final, ())
    if better is not None:  # there is something better still: said, and not passed for the best
        found = replace(found, maximum=replace(found.maximum, converged=False))
        scan = _scan_points(profile, share=_share_of(few, samples))
    report("refining", 1.0)
    return replace(
        found,
        scan=scan,
        optima=tuple(one.optimum for one in optima),
        unexplained=max(found.unexplained, _share(tops[0][1].x)),
        lack_of_fit=squares.lack_of_fit,
    )


def _on_samples(
    samples: Samples, tops: Sequence[tuple[float, _Climbed]], threads: int | None
) -> list[_Found]:
    # optima of the scan's pixels, the best first, as optima of all samples. One that is far below stays where it is,
    # with the value that all samples have there, unless that is not far below
    best = tops[0][1].value
    close = [(start, top) for start, top in tops if best - top.value < CLOSE_CALL]
    finals = [(start, _final(samples, top, threads)) for start, top in close]
    found = [_Found(start, final.maximum, final) for start, final in finals]
    least = max(final.value - final.reach for _, final in finals)
    for start, top in tops[len(close) :]:
        there = _best_at(samples, top.maximum.x, top.free, threads)
        if there.evaluation.value > least:
            final = _final(samples, top, threads)
            found.append(_Found(start, final.maximum, final))
        else:
            found.append(_Found(start, replace(there, converged=top.maximum.converged), None))
    return found


def _best_first(found: Sequence[_Found]) -> tuple[_Climbed, list[_Found]]:
    # the best of all, and all from the best on, without those that have ended where a better one did
    kept: list[_Found] = []
    for one in sorted(found, key=lambda one: -one.value):
        at = one.maximum.x[LOG_SIGMA]
        if all(abs(at - other.maximum.x[LOG_SIGMA]) > SAME_PEAK for other in kept):
            kept.append(one)
    best = kept[0].climbed
    assert best is not None  # one that is not far below has been climbed to
    return best, kept


def _best_at(samples: Samples, x: Float64, free: Sequence[int], threads: int | None) -> Maximum:
    # the best of all other parameters at the σ of `x`
    likelihood = _likelihood_at(samples, float(x[LOG_SIGMA]), threads)
    return maximise(likelihood, x, [place for place in free if place != LOG_SIGMA])


def _likelihood_at(samples: Samples, log_sigma: float, threads: int | None) -> Likelihood:
    # at one σ
    light = samples.specular(math.exp(log_sigma), threads=threads)
    return Likelihood(samples, np.array([log_sigma]), light[:, None], threads=threads)


def _final(
    samples: Samples, coarse: _Climbed, threads: int | None, *, start: Float64 | None = None
) -> _Climbed:
    x = coarse.maximum.x if start is None else start
    final = _climb(samples, x, coarse.free, coarse.width, threads)
    if not 0.5 * coarse.width <= final.width <= 1.5 * coarse.width:
        final = _climb(samples, final.maximum.x, coarse.free, final.width, threads)
    return final


def _profile_on_samples(
    samples: Samples, few: Samples, profile: Sequence[Maximum], final: _Climbed, threads: int | None
) -> tuple[tuple[ScanPoint, ...], Float64 | None]:
    # The profile of the scan's pixels with the estimate itself on it. Where those pixels do not surely prefer the
    # estimate, all samples decide: they either have something better to climb from, or say how much worse it is.
    share = _share_of(few, samples)
    if LOG_SIGMA not in final.free:
        return _scan_points([replace(profile[0], x=final.maximum.x)]), None
    here = _best_at(few, final.maximum.x, final.free, threads)
    value = here.evaluation.value
    near = max(CLOSE_CALL, share * final.reach)
    shown: list[Maximum] = [replace(here, x=final.maximum.x)]
    for point in profile:
        if point.evaluation.value > value - near:
            whole = _best_at(samples, point.x, final.free, threads)
            if whole.evaluation.value > final.value:
                return (), whole.x
            worse = share * (final.value - whole.evaluation.value)
            point = replace(whole, evaluation=replace(whole.evaluation, value=value - worse))
        shown.append(point)
    return _scan_points(shown, share=share), None


def _scan_points(profile: Sequence[Maximum], *, share: float = 1.0) -> tuple[ScanPoint, ...]:
    # `share` of the observations that the estimate is from are in the profile's criterion
    best = max(one.evaluation.value for one in profile)
    points = [
        ScanPoint(x=one.x, value=one.evaluation.value, fall=2.0 * (best - one.evaluation.value) / share)
        for one in profile
    ]
    return tuple(sorted(points, key=lambda point: point.sigma))


def _share_of(few: Samples, samples: Samples) -> float:
    return len(few.sample) / max(1, len(samples.sample))


def _optimum(start_sigma: float, top: Maximum, criterion: Criterion | None) -> Optimum:
    return Optimum(
        start_sigma=start_sigma,
        x=top.x,
        value=top.evaluation.value,
        converged=top.converged,
        criterion=criterion,
    )


def _of_likelihood(final: _Climbed, scan: tuple[ScanPoint, ...]) -> Estimate:
    return Estimate(
        x=final.maximum.x,
        free=final.free,
        covariance=final.covariance,
        inflation=final.inflation,
        criterion=final.likelihood,
        maximum=final.maximum,
        scan=scan,
        mean_log_likelihood=final.value / max(1, len(final.likelihood.samples.level)),
        unexplained=_share(final.maximum.x),
    )


def _scan_budget(samples: Samples) -> int:
    # pixels per octave, light and posture that the scan and least squares look at
    return max(50, SCAN_SAMPLES // (8 * len(samples.groups)))


def _share(x: Float64) -> float:
    return 1.0 / (1.0 + math.exp(-x[-1]))


def _places(samples: Samples, freed: Freed) -> list[int]:
    places = [R_D] if freed.diffuse else []
    if freed.specular:
        places += [LOG_R_S, LOG_SIGMA]
    if freed.dark:
        places.append(DARK)
    if freed.gain:
        # a common factor of all gains is one of R_d and R_s: the first light that was used keeps its own
        used = sorted(set(samples.facts.light.tolist()))
        places += [FIRST_GAIN + light for light in used[1:]]
    size = FIRST_GAIN + len(samples.lights) + 2
    return [*places, size - 2, size - 1]


def _climb(samples: Samples, x: Float64, free: Sequence[int], width: float, threads: int | None) -> _Climbed:
    # the specular light is tabulated around σ; where the climb leaves the table, around the place that it left for
    moves = 0
    while True:
        count = TABLE_NODES if width <= USUAL_TABLE else WIDE_TABLE_NODES
        offsets = width * np.linspace(-1.0, 1.0, count) if LOG_SIGMA in free else np.zeros(1)
        nodes = x[LOG_SIGMA] + offsets
        table = np.stack([samples.specular(math.exp(node), threads=threads) for node in nodes], axis=1)
        likelihood = Likelihood(samples, nodes, table, threads=threads)
        maximum = maximise(likelihood, x, free)
        moves += 1
        inside = abs(float(maximum.x[LOG_SIGMA] - x[LOG_SIGMA])) <= 0.7 * width
        if inside or LOG_SIGMA not in free or moves == MOST_TABLES:
            settled = replace(maximum, converged=maximum.converged and (inside or LOG_SIGMA not in free))
            return _Climbed(likelihood, settled, tuple(free), *uncertainty(likelihood, maximum.x, free))
        x = maximum.x.copy()
        x[LOG_SIGMA] = np.clip(x[LOG_SIGMA], nodes[0] - width, nodes[-1] + width)
