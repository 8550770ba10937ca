"""The pixels that no highlight reaches."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.fit._likelihood import FIRST_GAIN, LOG_R_S, LOG_SIGMA, Likelihood, predicted
from lightopt.fit._samples import Samples

__all__ = ["WIDENINGS", "diffuse_only", "share_of_dust", "share_of_gross", "share_of_shape"]

Float64 = NDArray[np.float64]

HIGHLIGHT_LEVEL = 0.1
"""Pixels that a highlight lights by less than this are diffuse only [grey level at exposure 1]."""

WIDENINGS = (2.0, 1.5, 1.2, 1.0)
"""For that, the lobe is taken this much wider than it was found, as far as any pixels are left: real lobes have heavier
tails than a Gaussian, and what is left of them goes into R_d."""

LEAST_PIXELS = 200
LEAST_FAR = 500
"""So many pixels must be left: for R_d, and for a share of a few in a thousand."""

LEAST_R_S = 1e-3
RINGS = 3
"""Rings of a highlight per octave of the angle."""

LEVEL_CAP = 0.15
"""Residuals count as at most this share of the sensor's full scale, dust and all."""

GROSS, LEAST_SPREAD = 15.0, 0.5
"""Residuals beyond this many typical ones (at least of so many sensor levels) are no tail of a lobe."""


def diffuse_only(samples: Samples, x: Float64) -> tuple[Samples, float]:
    """The observations that a lobe wider than the one found leaves dark, and how much wider it was taken.

    Parameters
    ----------
    samples
        The observations.
    x
        Parameters, shape (K,).

    Raises
    ------
    InputError
        There are none.
    """
    lit = samples.diffuse[samples.sample] > 0.0
    unlit = samples.deflection[samples.sample] == np.pi
    for widening in WIDENINGS:
        plain = lit & _beyond(samples, x, widening)
        if np.count_nonzero(plain & ~samples.saturated) >= LEAST_PIXELS:
            return samples.keep(plain | unlit), widening
    raise InputError(
        "no diffuse-only pixel: the highlights reach every pixel that is lit. Add images under lights that the surface "
        "mirrors elsewhere, or fit all coefficients at once: fit-specular --joint"
    )


def share_of_dust(likelihood: Likelihood, x: Float64) -> float | None:
    """Share of outliers among the pixels that no highlight reaches; dust falls everywhere alike. None without such.

    Parameters
    ----------
    likelihood, x
        A fit.
    """
    samples = likelihood.samples
    lit = samples.diffuse[samples.sample] > 0.0
    for widening in WIDENINGS:
        far = lit & _beyond(samples, x, widening)
        count = int(np.count_nonzero(far))
        if count >= LEAST_FAR:
            part = Likelihood(
                samples.keep(far), likelihood.log_sigmas, likelihood.specular, threads=likelihood.threads
            )
            # the slope by logit ε is the sum of what each pixel is an outlier by, minus ε
            share = 1.0 / (1.0 + math.exp(-x[-1]))
            return max(0.0, share + float(part.evaluate(x).gradient[-1]) / count)
    return None


def share_of_gross(likelihood: Likelihood, x: Float64) -> float:
    """Share of observations away from the highlights that are far from all others there; 0 where there are too few.

    Tails of a lobe reach some levels, dust and glints reach anything.

    Parameters
    ----------
    likelihood, x
        A fit.
    """
    samples = likelihood.samples
    lit = samples.diffuse[samples.sample] > 0.0
    far = lit & _beyond(samples, x, WIDENINGS[-1])
    if np.count_nonzero(far) < LEAST_FAR:
        return 0.0
    weights, _ = likelihood.specular_weights(float(x[LOG_SIGMA]))
    residual = np.abs(samples.level - predicted(samples, likelihood.specular @ weights, x))[far]
    return float(np.mean(residual > GROSS * max(1.4826 * float(np.median(residual)), LEAST_SPREAD)))


def share_of_shape(likelihood: Likelihood, x: Float64) -> float:
    """Share of the mean squared residual that goes with the angle from the mirror direction alone.

    A lobe of another shape leaves a residual that depends on that angle and on the exposure; wrong normals leave as
    much above as below.

    Parameters
    ----------
    likelihood, x
        A fit.
    """
    samples = likelihood.samples
    top = samples.sensor.saturated_from
    weights, _ = likelihood.specular_weights(float(x[LOG_SIGMA]))
    mean = np.clip(predicted(samples, likelihood.specular @ weights, x), 0.0, top)
    residual = np.minimum(samples.level, top) - mean
    cap = LEVEL_CAP * samples.sensor.max_level
    residual = np.clip(residual, -cap, cap)
    lit = samples.diffuse[samples.sample] > 0.0
    angle = np.log2(np.maximum(samples.deflection[samples.sample], 1e-4))
    exposures = np.unique(samples.facts.factor, return_inverse=True)[1][samples.image]
    group = np.floor(RINGS * (angle - math.log2(1e-4))).astype(np.intp) + 1000 * exposures
    _, ring = np.unique(group[lit], return_inverse=True)
    counts = np.bincount(ring)
    sums = np.bincount(ring, weights=residual[lit])
    return float(np.sum(sums**2 / counts) / max(float(np.sum(residual[lit] ** 2)), 1e-300))


def _beyond(samples: Samples, x: Float64, widening: float) -> NDArray[np.bool_]:
    peak = max(math.exp(x[LOG_R_S]), LEAST_R_S) * float(np.exp(np.max(np.abs(x[FIRST_GAIN:-2]))))
    reach = math.sqrt(2.0 * math.log(max(peak / HIGHLIGHT_LEVEL, 1.0)))
    return samples.deflection[samples.sample] > widening * math.exp(x[LOG_SIGMA]) * reach
