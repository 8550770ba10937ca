"""Where a fit begins: R_d from the pixels furthest from any highlight, R_s from how many pixels are saturated."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._criterion import FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.reflectance._samples import Samples

Float64 = NDArray[np.float64]

LEAST_DIFFUSE = 0.1
"""R_d is guessed where at least this much light arrives per unit of it."""

START_EPSILON = 0.03
START_DEVIATION = 4.0
"""A climb begins with wide shoulders [sensor level], so that pixels far from the first guess still pull at it."""


def first_guess(samples: Samples) -> float:
    """R_d [grey level] as the median over the half of the usable pixels that is furthest from any highlight.

    Raises InputError: every pixel is saturated or black.
    """
    diffuse = samples.diffuse[samples.sample]
    away = samples.deflection[samples.sample]
    lit = diffuse > 0.0
    full = samples.saturated
    black = samples.level <= samples.sensor.black_level
    if not lit.any() or bool(np.all(full[lit])):
        raise InputError(
            "every pixel that the lights reach is saturated; nothing tells how bright the surface is. Add images "
            "at a shorter exposure"
        )
    if bool(np.all(black[lit])):
        raise InputError(
            "every pixel that the lights reach is black; nothing tells how bright the surface is. Add images at a "
            "longer exposure, and check that the light was on"
        )
    usable = lit & ~full & (diffuse >= LEAST_DIFFUSE)
    if not usable.any():
        usable = lit & ~full
    usable &= away >= np.median(away[usable])
    light = samples.facts.factor[samples.image] * diffuse
    return max(0.0, float(np.median((samples.level - samples.sensor.black_level)[usable] / light[usable])))


def saturating_r_s(samples: Samples, specular: Float64, r_d: float) -> float:
    """R_s [grey level] with which as many pixels are saturated as were measured.

    Without any saturated pixel, that of a least-squares line through what R_d leaves.

    specular: Per unit of R_s, shape (n,).
    r_d: Diffuse coefficient [grey level].
    """
    factor = samples.facts.factor[samples.image]
    light = factor * specular[samples.sample]
    base = samples.sensor.black_level + factor * r_d * samples.diffuse[samples.sample]
    count = int(samples.saturated.sum())
    reached = light > 0.0
    if count:
        missing = np.maximum(samples.sensor.saturated_from - base, 0.0)[reached]
        needed = np.sort(missing / light[reached])
        if len(needed):
            return max(float(needed[min(count, len(needed)) - 1]), 1e-3)
        return 1.0
    square = float(light @ light)
    return max(float(light @ (samples.level - base)) / square, 1e-3) if square > 0.0 else 1.0


def start_at(samples: Samples, specular: Float64, sigma: float, r_d: float) -> Float64:
    """Parameters to climb from at a given σ, shape (K,); arguments as in :func:`saturating_r_s`, σ in [rad]."""
    x = np.zeros(FIRST_GAIN + len(samples.lights) + 2)
    x[R_D], x[LOG_SIGMA] = r_d, math.log(sigma)
    x[LOG_R_S] = math.log(saturating_r_s(samples, specular, r_d))
    x[-2] = 2.0 * math.log(START_DEVIATION)
    x[-1] = math.log(START_EPSILON / (1.0 - START_EPSILON))
    return x
