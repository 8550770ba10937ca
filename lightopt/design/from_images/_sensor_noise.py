"""The sensor's noise from good samples: variance against level, as in a photon transfer curve.

Mixed differences of neighbouring pixels show noise, and not how parts differ, which is smooth. The median of their
squares leaves out edges. A line through variance against level gives the constant part (read noise and rounding) and
that of photons (EMVA 1288, Release 4.0, equation 16).
"""

from collections.abc import Sequence

import numpy as np
from scipy import optimize

from lightopt.core.arrays import Bool, Float32, Float64, Index

ROUNDING = 1.0 / 12.0  # variance of rounding to whole levels

_GROUP = 16.0  # levels of 8 bits that a group of pixels spans
_LEAST_PIXELS = 20  # in a group
_MEDIAN = 0.4549364  # of the square of a normal deviate
_OFF = 0.05  # by so much a group may be off the line, as a share
_PHOTONS = 0.2  # of the least variance may be constant where all groups are of nearly one level


def noise_points(rest: Float32, valid: Bool, levels: Float32, places: Index, *, bits: int, differ: bool) -> Float64:
    """Level, variance and number of pixels of groups of pixels, shape (groups, 3).

    rest: Of good samples less their mean, shape (n, H, W), of the variance of one sample
    valid: Good pixels of the part, shape (n, H, W)
    levels: Mean of the good samples, shape (H, W)
    places: Flat numbers of the pixels to use
    bits: Of the levels
    differ: Whether differences of neighbours are still to be taken
    """
    width = levels.shape[1]
    places = places[(places % width < width - 1) & (places < levels.size - width)]
    corners = places, places + 1, places + width, places + width + 1
    flat, whole = rest.reshape(len(rest), -1), valid.reshape(len(valid), -1)
    used = np.all([whole[:, at] for at in corners], axis=0)
    own = [flat[:, at] for at in corners]
    squares = (0.5 * (own[0] - own[1] - own[2] + own[3]) if differ else own[0]) ** 2
    at = np.broadcast_to(levels.ravel()[places], used.shape)[used]
    squares = squares[used]
    number = np.floor(at / (_GROUP * 2.0 ** (bits - 8))).astype(np.intp)
    groups = [number == i for i in np.flatnonzero(np.bincount(number, minlength=1) >= _LEAST_PIXELS)]
    found = [(float(at[one].mean()), np.median(squares[one]) / _MEDIAN, int(one.sum())) for one in groups]
    return np.array(found, np.float64).reshape(-1, 3)


def sensor_noise(points: Sequence[Float64]) -> tuple[float, float]:
    """Variance at level 0 and its increase per level, of groups of pixels as above."""
    level, variance, count = np.concatenate([np.zeros((0, 3)), *points]).T
    variance = np.maximum(variance, ROUNDING)
    weight = 1.0 / (variance * np.sqrt(2.0 / count + _OFF**2))
    rows = np.stack([weight, weight * level], axis=1)
    # as much of photons as the groups allow, which is the worse case for images that are short
    prior = 1.0 / (_PHOTONS * float(variance.min(initial=np.inf))) if len(level) else 1.0
    matrix = np.concatenate([rows, [[prior, 0.0], [0.0, 1e-9]]])
    constant, per_level = optimize.nnls(matrix, np.append(weight * (variance - ROUNDING), [0.0, 0.0]))[0]
    return ROUNDING + float(constant), float(per_level)
