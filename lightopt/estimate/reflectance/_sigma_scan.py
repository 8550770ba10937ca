"""First step of a fit: least squares of clipped levels over the whole range of σ.

It finds every peak of the profile over σ, and whether the model describes the images at all. The profile is the best of
all other parameters at each of a row of σ, from several starts.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.run_context import Share, ignore
from lightopt.estimate.reflectance._clipped_least_squares import LeastSquares, SpecularTable, find_dust, measure_misfit
from lightopt.estimate.reflectance._estimate import Estimate, FreeParameters, Maximum, ScanPoint, maximise
from lightopt.estimate.reflectance._likelihood import Criterion, parameter_count, predicted
from lightopt.estimate.reflectance._samples import Samples, subsample
from lightopt.estimate.reflectance._vector import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D

SCAN_SAMPLES = 50_000  # pixels of the scan over σ, in all
SCAN_STRIDE = 5  # the scan takes each fifth node of the specular table: 25 σ, each 1.29 times the one before
WEAK_START = 0.1  # share of the R_s that saturates as many pixels as measured, from which least squares climb as well
MOST_PEAKS = 4
SAME_PEAK = 0.02  # climbs that end within this of ln σ have found the same peak
HELD_SIGMA = 0.05  # width of a lobe that is neither fitted nor given [rad]
Top = TypeVar("Top", Maximum, Estimate)
# σ of a peak of the profile [rad], and where the climb from it ended; the best first
Climbs = list[tuple[float, Maximum]]
LEAST_DIFFUSE = 0.1  # r_d is guessed where at least this much light arrives per unit of it
# a climb begins with wide shoulders [sensor level], so that pixels far from the first guess still pull at it
START_DEVIATION, START_EPSILON = 4.0, 0.03
# A scan only has to separate basins [nat]. Of several starts that which is best after the first steps goes on.
SCAN_TOLERANCE, SCAN_STEPS, FIRST_STEPS = 0.1, 30, 5


@dataclass(frozen=True)
class SigmaScan:
    samples: Samples  # those of the scan; `criterion` and `profile` are without dust
    free: tuple[int, ...]  # places of the parameters that are fitted, those of the likelihood's noise last
    # ln σ of the profile, and where the climbs at each began, shape (K,)
    log_sigmas: list[float]
    starts: list[Float64]
    criterion: LeastSquares
    profile: list[Maximum]
    climbs: Climbs
    misfit: float

    @property
    def best(self) -> Maximum:
        return self.climbs[0][1]

    def mean_square(self, number: int) -> float:
        """Of the profile at one of its σ [sensor level²], from the value of the criterion."""
        count = max(1, len(self.criterion.samples.sample))
        return math.exp(-2.0 * self.profile[number].value / count - 1.0) / (2.0 * math.pi)


def scan_sigma(samples: Samples, freed: FreeParameters, held: Float64 | None, progress: Share = ignore) -> SigmaScan:
    """Fit a subset of the samples by least squares at each σ of the range, and climb from the peaks.

    held: Values (R_d, R_s, σ) of those that are not fitted.
    """
    few = subsample(samples, scan_budget(samples))
    free = _free_places(samples, freed)
    guess = _first_guess(few)
    r_d = guess if freed.diffuse or held is None else float(held[0])
    table = SpecularTable(few)
    if freed.specular:
        log_sigmas = [float(node) for node in table.nodes[::SCAN_STRIDE]]
        columns = [table.column(number) for number in range(0, len(table.nodes), SCAN_STRIDE)]
    else:
        log_sigmas = [math.log(HELD_SIGMA if held is None else held[2])]
        columns = [few.specular(math.exp(log_sigmas[0]))]
    starts = [_start(few, column, math.exp(at), r_d) for at, column in zip(log_sigmas, columns, strict=True)]
    if not freed.specular and held is not None:
        starts[0][LOG_R_S] = math.log(max(held[1], 1e-6))
    fitted = free[:-2]

    def search(some: Samples, starts_at: Callable[[int], list[Float64]]) -> tuple[LeastSquares, list[Maximum], Climbs]:
        criterion = LeastSquares(some, table)
        fixed = zip(log_sigmas, columns, strict=True)
        by_sigma = {at: LeastSquares(some, table, fixed=(at, column)) for at, column in fixed}
        profile = profile_over_sigma(by_sigma.__getitem__, starts_at, log_sigmas, fitted, progress=progress)
        if LOG_SIGMA not in fitted:
            return by_sigma[log_sigmas[0]], profile, [(math.exp(log_sigmas[0]), profile[0])]
        return criterion, profile, climb_from_peaks(profile, lambda x: maximise(criterion, x, fitted))

    def saturating_and_weak(number: int) -> list[Float64]:
        weak = starts[number].copy()
        weak[LOG_R_S] += math.log(WEAK_START) if LOG_R_S in fitted else 0.0
        return [starts[number], weak]

    criterion, profile, climbs = search(few, saturating_and_weak)
    best = climbs[0][1].x
    dust = find_dust(few, predicted(few, criterion.light(best), best))
    if dust.any():
        first = profile
        criterion, profile, climbs = search(few.select(~dust), lambda number: [first[number].x])
    misfit = measure_misfit(criterion, climbs[0][1].x)
    return SigmaScan(few, free, log_sigmas, starts, criterion, profile, climbs, misfit)


def climb_from_peaks(profile: Sequence[Maximum], climb: Callable[[Float64], Top]) -> list[tuple[float, Top]]:
    tops: list[tuple[float, Top]] = []
    for peak in peaks(profile)[:MOST_PEAKS]:
        top = climb(peak.x)
        if all(abs(top.x[LOG_SIGMA] - other.x[LOG_SIGMA]) > SAME_PEAK for _, other in tops):
            tops.append((math.exp(peak.x[LOG_SIGMA]), top))
    return sorted(tops, key=lambda one: -one[1].value)


def _free_places(samples: Samples, freed: FreeParameters) -> tuple[int, ...]:
    places = [R_D] if freed.diffuse else []
    if freed.specular:
        places += [LOG_R_S, LOG_SIGMA]
    if freed.dark:
        places.append(DARK)
    if freed.gain:
        # a common factor of all gains is one of R_d and R_s: the first light that was used keeps its own
        used = sorted(set(samples.facts.light.tolist()))
        places += [FIRST_GAIN + light for light in used[1:]]
    size = parameter_count(samples)
    return (*places, size - 2, size - 1)


def scan_budget(samples: Samples) -> int:
    """Pixels per octave, light and posture that the scan and least squares use."""
    return max(50, SCAN_SAMPLES // (8 * len(samples.groups)))


def scan_points(profile: Sequence[Maximum], *, share: float = 1.0) -> tuple[ScanPoint, ...]:
    """A profile as it is reported; `share` of the observations of the estimate are in the profile's criterion."""
    best = max(one.value for one in profile)
    points = [ScanPoint(x=one.x, value=one.value, drop=2.0 * (best - one.value) / share) for one in profile]
    return tuple(sorted(points, key=lambda point: point.sigma))


def _first_guess(samples: Samples) -> float:
    # R_d [grey level] as the median over the half of the usable pixels that is furthest from any highlight
    diffuse, away = samples.diffuse[samples.sample], samples.deflection[samples.sample]
    lit, full = diffuse > 0.0, samples.saturated
    above_black = samples.level - samples.sensor.black_level
    if not lit.any() or bool(np.all(full[lit])):
        raise InputError("every pixel that the lights reach is saturated: add images at a shorter exposure")
    if bool(np.all(above_black[lit] <= 0.0)):
        raise InputError("every pixel that the lights reach is black: use a longer exposure, and check the light")
    usable = lit & ~full & (diffuse >= LEAST_DIFFUSE)
    if not usable.any():
        usable = lit & ~full
    usable &= away >= np.median(away[usable])
    light = samples.facts.factor[samples.image] * diffuse
    return max(0.0, float(np.median(above_black[usable] / light[usable])))


def _saturating_r_s(samples: Samples, specular: Float64, r_d: float) -> float:
    # R_s [grey level] with which as many pixels are saturated as were measured; without any saturated pixel, that of a
    # least-squares line through what R_d leaves
    factor = samples.facts.factor[samples.image]
    light = factor * specular[samples.sample]
    base = samples.sensor.black_level + factor * r_d * samples.diffuse[samples.sample]
    reached = light > 0.0
    if not reached.any():
        return 1.0
    if count := int(samples.saturated.sum()):
        missing = np.maximum(samples.sensor.saturated_from - base, 0.0)[reached]
        needed = np.sort(missing / light[reached])
        return max(float(needed[min(count, len(needed)) - 1]), 1e-3)
    square = float(light @ light)
    return max(float(light @ (samples.level - base)) / square, 1e-3) if square > 0.0 else 1.0


def _start(samples: Samples, specular: Float64, sigma: float, r_d: float) -> Float64:
    # parameters to climb from at a given σ, shape (K,)
    x = np.zeros(parameter_count(samples))
    x[R_D], x[LOG_SIGMA] = r_d, math.log(sigma)
    x[LOG_R_S] = math.log(_saturating_r_s(samples, specular, r_d))
    x[-2] = 2.0 * math.log(START_DEVIATION)
    x[-1] = math.log(START_EPSILON / (1.0 - START_EPSILON))
    return x


def profile_over_sigma(
    criterion_at: Callable[[float], Criterion],
    starts_at: Callable[[int], Sequence[Float64]],
    log_sigmas: Sequence[float],
    free: Sequence[int],  # places of the parameters that are fitted; σ is not, whether or not it is among them
    *,
    progress: Share = ignore,
) -> list[Maximum]:
    """The best fit at each σ, from its own starts and from the best at its neighbours on both sides."""
    fixed = [place for place in free if place != LOG_SIGMA]
    criteria = [criterion_at(log_sigma) for log_sigma in log_sigmas]
    best: list[Maximum] = []
    for number, criterion in enumerate(criteria):
        starts = [*starts_at(number)]
        if best:
            starts.append(_moved(best[-1].x, log_sigmas[number]))
        best.append(_best(criterion, starts, fixed))
        progress((number + 1) / len(criteria))
    for number in range(len(criteria) - 2, -1, -1):
        other = _best(criteria[number], [_moved(best[number + 1].x, log_sigmas[number])], fixed)
        best[number] = max(best[number], other, key=lambda one: one.value)
    return best


def profile_outwards(
    criterion_at: Callable[[float], Criterion],
    starts_at: Callable[[int], Sequence[Float64]],
    log_sigmas: Sequence[float],
    free: Sequence[int],
    *,
    begin: int,
    progress: Share = ignore,
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
        progress(len(found) / count)
    return [found[number] for number in range(count)]


def peaks(profile: Sequence[Maximum]) -> list[Maximum]:
    values = [-np.inf, *(one.value for one in profile), -np.inf]
    tops = [one for k, one in enumerate(profile) if one.value >= max(values[k], values[k + 2])]
    return sorted(tops, key=lambda one: -one.value)


def _best(
    criterion: Criterion, starts: Sequence[Float64], fixed: Sequence[int], *, most_steps: int = SCAN_STEPS
) -> Maximum:
    found = [maximise(criterion, x, fixed, most_steps=most_steps, tolerance=SCAN_TOLERANCE) for x in starts]
    return max(found, key=lambda one: one.value)


def _moved(x: Float64, log_sigma: float) -> Float64:
    there = x.copy()
    there[LOG_SIGMA] = log_sigma
    return there
