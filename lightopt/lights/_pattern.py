"""Patterns of lights: sums of stripes, each along one side, so that lights that differ in phase share their integrals.

A pattern is an array of terms, shape (b, TERM_NUMBERS), each a row (coefficient, axis, wave, phase, duty): coefficient
times a function of x, which is u for axis 0 and v for axis 1 [mm],

    duty 0: cos(wave·x + phase), which is 1 for wave 0 and phase 0
    duty > 0: 1 where wave·x + phase is within duty·π of a multiple of 2π, else 0
"""

import math

import numpy as np

from lightopt.core.arrays import Float64

TERM_NUMBERS = 5

UNIFORM = np.array([[1.0, 0.0, 0.0, 0.0, 0.0]])
"""The pattern that is 1 everywhere."""
UNIFORM.flags.writeable = False


def sine_terms(axis: int, *, period: float, phase: float) -> Float64:
    """Stripes ½·(1 + cos(2π·x/period + phase)); [mm], [rad]."""
    wave = 2.0 * math.pi / period
    cosine = [0.5 * math.cos(phase), axis, wave, 0.0, 0.0]
    sine = [-0.5 * math.sin(phase), axis, wave, -0.5 * math.pi, 0.0]
    return np.array([[0.5, 0.0, 0.0, 0.0, 0.0], cosine, sine])


def bar_terms(axis: int, *, period: float, phase: float, duty: float) -> Float64:
    """Bars that take up the share `duty` of a period [mm], in the middle of one where 2π·x/period + phase is 0."""
    return np.array([[1.0, axis, 2.0 * math.pi / period, phase, duty]])
