"""The default fit: maximum likelihood over all images, from a scan over σ to the last digit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._likelihood import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, Likelihood
from lightopt.fit._maximise import Maximum, information, maximise
from lightopt.fit._samples import Samples, thinned
from lightopt.fit._start import first_guess, start_at

__all__ = ["Estimate", "Freed", "ScanPoint", "estimate", "refine"]

Float64 = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""

LEAST_SIGMA, MOST_SIGMA = 0.001, 0.3
"""Widths of lobes that are looked at [rad]; Ward found 0.001 to 0.2 on real surfaces (paper, section 4.3)."""

SCAN_POINTS = 25
SCAN_SAMPLES = 50_000
"""Pixels of the scan over σ, in all."""

SCAN_STEPS = 30
GOLDEN_STEPS = 7
CLUSTERED = 2.0
LEAST_DUST = 5e-4
"""Where this many times as many pixels are unexplained as among those away from the highlights, it is not dust."""

HIGHLIGHT_LEVEL = 0.1
WIDENINGS = (2.0, 1.5, 1.2, 1.0)
LEAST_FAR = 500
"""Pixels are away from the highlights where a lobe so many times wider than the one found leaves less than this level;
the widest that leaves enough pixels is taken."""

TABLE_NODES = 5
MOST_TABLES = 8
WIDEST_TABLE = 0.06
NARROWEST_TABLE = 0.003
TABLE_DEVIATIONS = 6.0
"""The specular light is tabulated at ln σ this many standard errors around the estimate, so that the likelihood is a
smooth function of σ whatever quadrature is behind it."""


@dataclass(frozen=True, kw_only=True)
class Freed:
    """What a fit may change beside R_d, R_s and σ.

    Attributes
    ----------
    diffuse, specular
        Whether R_d, and whether R_s and σ are fitted.
    gain
        Gain of every light, relative to the first one.
    dark
        A constant dark level.
    """

    diffuse: bool = True
    specular: bool = True
    gain: bool = False
    dark: bool = False


@dataclass(frozen=True, kw_only=True)
class ScanPoint:
    """The best fit at one σ.

    Attributes
    ----------
    sigma
        [rad].
    R_d, R_s
        [grey level].
    value
        Log-likelihood of the scan's pixels [nat].
    """

    sigma: float
    R_d: float
    R_s: float
    value: float


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Where the likelihood is greatest, and how sharply.

    Attributes
    ----------
    x
        Parameters, shape (K,), as :mod:`lightopt.fit._likelihood` orders them.
    free
        Places of the parameters that were fitted.
    covariance
        Of those, shape (k, k), if the model is right.
    inflation
        By how much the variance of each of those is larger when what the model gets wrong is alike within a piece of
        the image; at least 1, shape (k,).
    likelihood
        Near the maximum.
    maximum
        How the climb ended.
    scan
        Along σ.
    unexplained
        Share of the pixels that the model would have left out if it could.
    """

    x: Float64
    free: tuple[int, ...]
    covariance: Float64
    inflation: Float64
    likelihood: Likelihood
    maximum: Maximum
    scan: tuple[ScanPoint, ...]
    unexplained: float

    @property
    def R_d(self) -> float:  # noqa: N802
        """[grey level]."""
        return float(self.x[R_D])

    @property
    def R_s(self) -> float:  # noqa: N802
        """[grey level]."""
        return math.exp(self.x[LOG_R_S])

    @property
    def sigma(self) -> float:
        """[rad]."""
        return math.exp(self.x[LOG_SIGMA])

    @property
    def tau(self) -> float:
        """Deviation that the sensor's noise does not explain [sensor level]."""
        return math.exp(0.5 * self.x[-2])

    @property
    def epsilon(self) -> float:
        """Share of the pixels that the fit takes for dust, glints and the like."""
        return 1.0 / (1.0 + math.exp(-self.x[-1]))

    @property
    def mean_log_likelihood(self) -> float:
        """Of a level [nat]."""
        return self.maximum.evaluation.value / len(self.likelihood.samples.level)

    def standard_error(self, place: int) -> float:
        """Standard error of a parameter, for what the model gets wrong as well; 0 for one that was held."""
        if place not in self.free:
            return 0.0
        i = self.free.index(place)
        return math.sqrt(self.covariance[i, i] * self.inflation[i])

    def correlation(self, first: int, second: int) -> float:
        """Correlation of two parameters that were fitted."""
        i, j = self.free.index(first), self.free.index(second)
        return float(self.covariance[i, j] / math.sqrt(self.covariance[i, i] * self.covariance[j, j]))


def estimate(
    samples: Samples,
    *,
    freed: Freed = Freed(),
    held: Float64 | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Fit R_d, R_s and σ, and what else is freed, to samples.

    Parameters
    ----------
    samples
        From :func:`lightopt.fit.collect_samples`.
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
    budget = max(50, SCAN_SAMPLES // (8 * len(samples.groups)))
    few = thinned(samples, budget)
    free = _places(samples, freed)
    guess = first_guess(few)
    r_d = guess if freed.diffuse or held is None else float(held[0])
    scan: list[ScanPoint] = []
    best = _scan(few, free, r_d, freed, held, scan, threads, report)
    coarse = _climb_with_table(few, best, free, WIDEST_TABLE, threads)
    unexplained = 1.0 / (1.0 + math.exp(-coarse[1].x[-1]))
    dust = _share_of_dust(few, coarse[0], coarse[1].x)
    if dust is not None and unexplained > CLUSTERED * dust + LEAST_DUST:
        # what the model cannot explain lies where the highlights are: the model's fault, which is not to be left out
        free = free[:-1]
        start = coarse[1].x.copy()
        start[-1] = math.log(max(dust, LEAST_DUST))
        coarse = _climb_with_table(few, start, free, WIDEST_TABLE, threads)
    report("refining", 0.2)
    width = _width(coarse, free)
    final = _climb_with_table(samples, coarse[1].x, free, width, threads)
    report("refining", 0.7)
    if (narrow := _width(final, free)) < 0.5 * width:
        final = _climb_with_table(samples, final[1].x, free, narrow, threads)
    report("refining", 1.0)
    found = _finished(final, free, tuple(sorted(scan, key=lambda point: point.sigma)))
    return replace(found, unexplained=max(found.unexplained, unexplained))


def refine(
    samples: Samples, start: Estimate, *, only_reflectance: bool = False, threads: int | None = None
) -> Estimate:
    """Fit the same parameters to other samples, from an estimate that cannot be far off.

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
    noise = (start.likelihood.log_tau2, start.likelihood.logit_epsilon)
    free = [p for p in start.free if not only_reflectance or p < DARK or p in noise]
    return _finished(_climb_with_table(samples, start.x, free, WIDEST_TABLE, threads), free, start.scan)


def _finished(
    final: tuple[Likelihood, Maximum, Float64], free: Sequence[int], scan: tuple[ScanPoint, ...]
) -> Estimate:
    likelihood, maximum, covariance = final
    # White 1982, doi:10.2307/1912526; summed by pieces of the image, as for clusters of observations
    scores = likelihood.scores(maximum.x)[:, list(free)]
    pieces = len(scores)
    middle = scores.T @ scores * (pieces / max(1, pieces - len(free)))
    sandwich = covariance @ middle @ covariance
    inflation = np.maximum(1.0, np.diag(sandwich) / np.maximum(np.diag(covariance), 1e-300))
    return Estimate(
        x=maximum.x,
        free=tuple(free),
        covariance=covariance,
        inflation=inflation,
        likelihood=likelihood,
        maximum=maximum,
        scan=scan,
        unexplained=1.0 / (1.0 + math.exp(-maximum.x[-1])),
    )


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


def _scan(
    few: Samples,
    free: Sequence[int],
    r_d: float,
    freed: Freed,
    held: Float64 | None,
    scan: list[ScanPoint],
    threads: int | None,
    report: Progress,
) -> Float64:
    # the best fit at each of a row of σ, then a golden section around the best of them
    fixed = [place for place in free if place != LOG_SIGMA]

    def at(log_sigma: float) -> tuple[float, Float64]:
        sigma = math.exp(log_sigma)
        specular = few.specular(sigma, threads=threads)
        likelihood = Likelihood(few, np.array([log_sigma]), specular[:, None], threads=threads)
        x = start_at(few, specular, sigma, r_d)
        if not freed.specular and held is not None:
            x[LOG_R_S] = math.log(max(held[1], 1e-6))
        found = maximise(likelihood, x, fixed, most_steps=SCAN_STEPS, tolerance=0.5)
        scan.append(
            ScanPoint(
                sigma=sigma,
                R_d=float(found.x[R_D]),
                R_s=math.exp(found.x[LOG_R_S]),
                value=found.evaluation.value,
            )
        )
        return found.evaluation.value, found.x

    if not freed.specular:
        return at(math.log(held[2] if held is not None else 0.05))[1]
    row = np.linspace(math.log(LEAST_SIGMA), math.log(MOST_SIGMA), SCAN_POINTS)
    results: list[tuple[float, Float64]] = []
    for i, log_sigma in enumerate(row):
        results.append(at(float(log_sigma)))
        report("scanning σ", (i + 1) / (SCAN_POINTS + GOLDEN_STEPS))
    top = int(np.argmax([value for value, _ in results]))
    low, high = float(row[max(0, top - 1)]), float(row[min(len(row) - 1, top + 1)])
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    inner = [high - ratio * (high - low), low + ratio * (high - low)]
    found = [at(inner[0]), at(inner[1])]
    for i in range(GOLDEN_STEPS):
        if found[0][0] > found[1][0]:
            high, inner[1], found[1] = inner[1], inner[0], found[0]
            inner[0] = high - ratio * (high - low)
            found[0] = at(inner[0])
        else:
            low, inner[0], found[0] = inner[0], inner[1], found[1]
            inner[1] = low + ratio * (high - low)
            found[1] = at(inner[1])
        report("scanning σ", (SCAN_POINTS + i + 1) / (SCAN_POINTS + GOLDEN_STEPS))
    return max([*results, *found], key=lambda result: result[0])[1]


def _share_of_dust(samples: Samples, likelihood: Likelihood, x: Float64) -> float | None:
    # share of outliers among the pixels that no highlight reaches; dust falls everywhere alike
    reach = math.sqrt(2.0 * math.log(max(math.exp(x[LOG_R_S]) / HIGHLIGHT_LEVEL, 1.0)))
    angle = samples.deflection[samples.sample]
    lit = samples.diffuse[samples.sample] > 0.0
    for widening in WIDENINGS:
        far = lit & (angle > widening * math.exp(x[LOG_SIGMA]) * reach)
        count = int(np.count_nonzero(far))
        if count >= LEAST_FAR:
            part = Likelihood(
                samples.keep(far), likelihood.log_sigmas, likelihood.specular, threads=likelihood.threads
            )
            # the slope by logit ε is the sum of what each pixel is an outlier by, minus ε
            share = 1.0 / (1.0 + math.exp(-x[-1]))
            return max(0.0, share + float(part.evaluate(x).gradient[-1]) / count)
    return None


def _climb_with_table(
    samples: Samples, x: Float64, free: Sequence[int], width: float, threads: int | None
) -> tuple[Likelihood, Maximum, Float64]:
    # the specular light is tabulated around σ; where the climb leaves the table, around the place that it left for
    moves = 0
    while True:
        offsets = width * np.linspace(-1.0, 1.0, TABLE_NODES) if LOG_SIGMA in free else np.zeros(1)
        nodes = x[LOG_SIGMA] + offsets
        table = np.stack([samples.specular(math.exp(node), threads=threads) for node in nodes], axis=1)
        likelihood = Likelihood(samples, nodes, table, threads=threads)
        maximum = maximise(likelihood, x, free)
        moves += 1
        inside = abs(float(maximum.x[LOG_SIGMA] - x[LOG_SIGMA])) <= 0.7 * width
        if inside or LOG_SIGMA not in free or moves == MOST_TABLES:
            return likelihood, maximum, _covariance(likelihood, maximum.x, free)
        x = maximum.x.copy()
        x[LOG_SIGMA] = np.clip(x[LOG_SIGMA], nodes[0] - width, nodes[-1] + width)


def _covariance(likelihood: Likelihood, x: Float64, free: Sequence[int]) -> Float64:
    matrix = information(likelihood, x, free)
    # a noise that is nothing or a share of no pixels is at its bound and tells nothing of the others
    scale = np.sqrt(np.maximum(np.abs(np.diag(matrix)), 1e-12))
    scaled = np.nan_to_num(matrix / np.outer(scale, scale))
    values, vectors = np.linalg.eigh(scaled)
    inverse = (vectors / np.maximum(values, 1e-10)) @ vectors.T
    return inverse / np.outer(scale, scale)


def _width(result: tuple[Likelihood, Maximum, Float64], free: Sequence[int]) -> float:
    if LOG_SIGMA not in free:
        return WIDEST_TABLE
    i = list(free).index(LOG_SIGMA)
    return float(np.clip(TABLE_DEVIATIONS * math.sqrt(result[2][i, i]), NARROWEST_TABLE, WIDEST_TABLE))
