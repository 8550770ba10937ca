"""The default fit: maximum likelihood over all images, from a scan over σ to the last digit."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._estimate import Estimate, Freed, ScanPoint
from lightopt.fit._highlights import share_of_dust, share_of_gross, share_of_shape
from lightopt.fit._likelihood import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D, Likelihood
from lightopt.fit._maximise import Maximum, maximise
from lightopt.fit._samples import Samples, thinned
from lightopt.fit._scan import best_at, scan_sigma
from lightopt.fit._start import first_guess
from lightopt.fit._uncertainty import uncertainty

__all__ = ["estimate", "refine"]

Float64 = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is going on and the share of it that is done, 0 to 1."""

SCAN_SAMPLES = 50_000
"""Pixels of the scan over σ, in all."""

CLUSTERED = 2.0
LEAST_DUST = 5e-4
"""Where this many times as many pixels are unexplained as among those away from the highlights, it is not dust."""

ANOTHER_SHAPE = 0.3
"""More than this share of the squared residual goes with the angle from the mirror direction alone where the lobe is no
Gaussian (0.7 to 0.96 for tails like GGX's and for a second lobe, 0.03 for normals guessed from facets)."""

NO_DUST = -500.0
WRONG_DEVIATION = 16.0
"""Then nothing is left out but gross dust, each pixel counts for as many as it stands for, and the climb begins with
shoulders that reach them all [sensor level]: the fit that is nearest over whole images predicts others best."""

HELD_SIGMA = 0.05
"""Width of a lobe that is not fitted and not said."""

TABLE_NODES = 5
MOST_TABLES = 8
WIDEST_TABLE = 0.06
NARROWEST_TABLE = 0.003
TABLE_DEVIATIONS, TABLE_INTERVALS = 6.0, 3.0
"""The specular light is tabulated at ln σ this many standard errors around the estimate, without and with what the
model gets wrong, so that the likelihood is a smooth function of σ whatever quadrature is behind it."""


@dataclass(frozen=True)
class _Climbed:
    likelihood: Likelihood
    maximum: Maximum
    free: tuple[int, ...]
    covariance: Float64
    inflation: Float64

    @property
    def by_area(self) -> bool:
        """Whether a pixel counts for as many as it stands for."""
        return self.likelihood.by_area

    @property
    def width(self) -> float:
        """That a table around this maximum should have."""
        if LOG_SIGMA not in self.free:
            return WIDEST_TABLE
        i = self.free.index(LOG_SIGMA)
        error = math.sqrt(self.covariance[i, i])
        wanted = error * max(TABLE_DEVIATIONS, TABLE_INTERVALS * math.sqrt(self.inflation[i]))
        return float(np.clip(wanted, NARROWEST_TABLE, WIDEST_TABLE))


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
    freed = freed or Freed()
    budget = max(50, SCAN_SAMPLES // (8 * len(samples.groups)))
    few = thinned(samples, budget)
    free = _places(samples, freed)
    guess = first_guess(few)
    r_d = guess if freed.diffuse or held is None else float(held[0])
    if freed.specular:
        scan, best = scan_sigma(
            few, free, r_d, threads=threads, progress=lambda share: report("scanning σ", share)
        )
    else:
        log_r_s = None if held is None else math.log(max(held[1], 1e-6))
        log_sigma = math.log(HELD_SIGMA if held is None else held[2])
        point, best = best_at(few, log_sigma, free, r_d, log_r_s=log_r_s, threads=threads)
        scan = (point,)
    coarse = _climb(few, best, free, WIDEST_TABLE, threads)
    unexplained = _share(coarse.maximum.x)
    dust = share_of_dust(coarse.likelihood, coarse.maximum.x)
    if dust is not None and unexplained > CLUSTERED * dust + LEAST_DUST:
        # what the model cannot explain lies where the highlights are: the model's fault, which is not to be left out
        free = free[:-1]
        start = coarse.maximum.x.copy()
        another_shape = share_of_shape(coarse.likelihood, start) > ANOTHER_SHAPE
        if another_shape:
            gross = share_of_gross(coarse.likelihood, start)
            start[-1] = math.log(gross) if gross > LEAST_DUST else NO_DUST
            start[-2] = 2.0 * math.log(WRONG_DEVIATION)
        else:
            start[-1] = math.log(max(dust, LEAST_DUST))
        coarse = _climb(few, start, free, WIDEST_TABLE, threads, by_area=another_shape)
    report("refining", 0.2)
    final = _climb(samples, coarse.maximum.x, free, coarse.width, threads, by_area=coarse.by_area)
    report("refining", 0.7)
    if not 0.5 * coarse.width <= final.width <= 1.5 * coarse.width:
        final = _climb(samples, final.maximum.x, free, final.width, threads, by_area=final.by_area)
    report("refining", 1.0)
    found = _finished(final, scan)
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
    by_area = start.likelihood.by_area
    return _finished(_climb(samples, start.x, free, WIDEST_TABLE, threads, by_area=by_area), start.scan)


def _finished(final: _Climbed, scan: tuple[ScanPoint, ...]) -> Estimate:
    return Estimate(
        x=final.maximum.x,
        free=final.free,
        covariance=final.covariance,
        inflation=final.inflation,
        likelihood=final.likelihood,
        maximum=final.maximum,
        scan=scan,
        unexplained=_share(final.maximum.x),
    )


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


def _climb(
    samples: Samples,
    x: Float64,
    free: Sequence[int],
    width: float,
    threads: int | None,
    *,
    by_area: bool = False,
) -> _Climbed:
    # the specular light is tabulated around σ; where the climb leaves the table, around the place that it left for
    moves = 0
    while True:
        offsets = width * np.linspace(-1.0, 1.0, TABLE_NODES) if LOG_SIGMA in free else np.zeros(1)
        nodes = x[LOG_SIGMA] + offsets
        table = np.stack([samples.specular(math.exp(node), threads=threads) for node in nodes], axis=1)
        likelihood = Likelihood(samples, nodes, table, by_area=by_area, threads=threads)
        maximum = maximise(likelihood, x, free)
        moves += 1
        inside = abs(float(maximum.x[LOG_SIGMA] - x[LOG_SIGMA])) <= 0.7 * width
        if inside or LOG_SIGMA not in free or moves == MOST_TABLES:
            return _Climbed(likelihood, maximum, tuple(free), *uncertainty(likelihood, maximum.x, free))
        x = maximum.x.copy()
        x[LOG_SIGMA] = np.clip(x[LOG_SIGMA], nodes[0] - width, nodes[-1] + width)
