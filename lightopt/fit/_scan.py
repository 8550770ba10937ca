"""Find the right end of the ridge of R_s and σ: the best fit at each of a row of σ."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.fit._estimate import ScanPoint
from lightopt.fit._likelihood import LOG_R_S, LOG_SIGMA, R_D, Likelihood
from lightopt.fit._maximise import maximise
from lightopt.fit._samples import Samples
from lightopt.fit._start import start_at

__all__ = ["best_at", "scan_sigma"]

Float64 = NDArray[np.float64]

LEAST_SIGMA, MOST_SIGMA = 0.001, 0.3
"""Widths of lobes that are looked at [rad]; Ward found 0.001 to 0.2 on real surfaces (paper, section 4.3)."""

SCAN_POINTS = 25
SCAN_STEPS = 30
GOLDEN_STEPS = 7


def best_at(
    samples: Samples,
    log_sigma: float,
    free: Sequence[int],
    r_d: float,
    *,
    log_r_s: float | None = None,
    threads: int | None = None,
) -> tuple[ScanPoint, Float64]:
    """The best fit at one ln σ, and its parameters, shape (K,).

    Parameters
    ----------
    samples
        A few pixels.
    log_sigma
        ln σ.
    free
        Places of the parameters that are fitted; σ is not, whether or not it is among them.
    r_d
        Where to begin [grey level].
    log_r_s
        Where R_s is held; guessed from the saturated pixels where None.
    threads
        Number of threads; the result does not depend on it.
    """
    sigma = math.exp(log_sigma)
    specular = samples.specular(sigma, threads=threads)
    likelihood = Likelihood(samples, np.array([log_sigma]), specular[:, None], threads=threads)
    x = start_at(samples, specular, sigma, r_d)
    if log_r_s is not None:
        x[LOG_R_S] = log_r_s
    fixed = [place for place in free if place != LOG_SIGMA]
    found = maximise(likelihood, x, fixed, most_steps=SCAN_STEPS, tolerance=0.5)
    point = ScanPoint(
        sigma=sigma,
        R_d=float(found.x[R_D]),
        R_s=math.exp(found.x[LOG_R_S]),
        value=found.evaluation.value,
    )
    return point, found.x


def scan_sigma(
    samples: Samples,
    free: Sequence[int],
    r_d: float,
    *,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[tuple[ScanPoint, ...], Float64]:
    """A row of σ, then a golden section around the best of them; all that was tried, by σ, and the best parameters.

    Parameters
    ----------
    samples, free, r_d, threads
        As in :func:`best_at`.
    progress
        Called as σ are done.
    """
    tried: list[tuple[ScanPoint, Float64]] = []

    def at(log_sigma: float) -> float:
        tried.append(best_at(samples, log_sigma, free, r_d, threads=threads))
        if progress is not None:
            progress(min(1.0, len(tried) / (SCAN_POINTS + GOLDEN_STEPS + 2)))
        return tried[-1][0].value

    row = np.linspace(math.log(LEAST_SIGMA), math.log(MOST_SIGMA), SCAN_POINTS)
    top = int(np.argmax([at(float(log_sigma)) for log_sigma in row]))
    low, high = float(row[max(0, top - 1)]), float(row[min(len(row) - 1, top + 1)])
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    inner = [high - ratio * (high - low), low + ratio * (high - low)]
    values = [at(inner[0]), at(inner[1])]
    for _ in range(GOLDEN_STEPS):
        if values[0] > values[1]:
            high, inner[1], values[1] = inner[1], inner[0], values[0]
            inner[0] = high - ratio * (high - low)
            values[0] = at(inner[0])
        else:
            low, inner[0], values[0] = inner[0], inner[1], values[1]
            inner[1] = low + ratio * (high - low)
            values[1] = at(inner[1])
    points = tuple(sorted((point for point, _ in tried), key=lambda point: point.sigma))
    return points, max(tried, key=lambda result: result[0].value)[1]
