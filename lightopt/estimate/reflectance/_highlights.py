"""The pixels that no highlight reaches."""

from __future__ import annotations

import math

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._criterion import FIRST_GAIN, LOG_R_S, LOG_SIGMA
from lightopt.estimate.reflectance._samples import Samples

HIGHLIGHT_LEVEL = 0.1
"""Pixels that a highlight lights by less than this are diffuse only [grey level at exposure 1]."""

WIDENINGS = (2.0, 1.5, 1.2, 1.0)
"""For that, the lobe is taken this much wider than it was found, as far as any pixels are left: real lobes have heavier
tails than a Gaussian, and what is left of them goes into R_d."""

LEAST_PIXELS = 200
"""So many pixels must be left."""

LEAST_R_S = 1e-3


def diffuse_only(samples: Samples, x: Float64) -> tuple[Samples, float]:
    """The observations that a lobe wider than the one found leaves dark, and how much wider it was taken.

    Raises InputError: there are none.
    """
    lit = samples.diffuse[samples.sample] > 0.0
    unlit = samples.deflection[samples.sample] == np.pi
    for widening in WIDENINGS:
        plain = lit & _beyond(samples, x, widening)
        if np.count_nonzero(plain & ~samples.saturated) >= LEAST_PIXELS:
            return samples.select(plain | unlit), widening
    raise InputError(
        "no diffuse-only pixel: the highlights reach every pixel that is lit. Add images under lights that the surface "
        "mirrors elsewhere, or fit all coefficients at once: fit-specular --joint"
    )


def _beyond(samples: Samples, x: Float64, widening: float) -> Bool:
    peak = max(math.exp(x[LOG_R_S]), LEAST_R_S) * float(np.exp(np.max(np.abs(x[FIRST_GAIN:-2]))))
    reach = math.sqrt(2.0 * math.log(max(peak / HIGHLIGHT_LEVEL, 1.0)))
    return samples.deflection[samples.sample] > widening * math.exp(x[LOG_SIGMA]) * reach
