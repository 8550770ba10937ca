"""Does the model describe the images? Its least squares against the noise, without dust."""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.estimate.reflectance._clipped_least_squares import LeastSquares
from lightopt.estimate.reflectance._criterion import DARK
from lightopt.estimate.reflectance._likelihood import clipped_levels, predicted
from lightopt.estimate.reflectance._noise import image_noise
from lightopt.estimate.reflectance._samples import Samples

RINGS = 3
# pixels of one exposure are compared with those of a like geometry: rings per octave of the angle from the mirror
# direction, and steps of the diffuse light
DIFFUSE_STEPS = 10

LEAST_ALIKE = 20
# a pixel is dust where its residual is so many deviations, and at least this share of the full scale, from the middle
# of the pixels of a like geometry
DUST_SPREADS, DUST_LEVELS = 8.0, 0.06

MOST_DUST = 0.1  # where more of a geometry's pixels than this are far off, that is the model's fault

# the model describes the images while the residual of least squares is no more than this many times the noise [rms]:
# what the model gets wrong is then less than three quarters of the noise
MOST_MISFIT = 1.25


@dataclass(frozen=True, kw_only=True)
class LackOfFit:
    """The residual of least squares against the noise.

    ratio: Residual over noise, both rms over the lit pixels of the images of one exposure; that of the worst exposure.
    """

    ratio: float

    @property
    def significant(self) -> bool:
        """Whether the model does not describe the images."""
        return self.ratio > MOST_MISFIT


def find_dust(samples: Samples, mean: Float64) -> Bool:
    """Observations that are far from all others of a like geometry, shape (N,).

    A model that is wrong is wrong alike there, so that its misfit is not taken for dust.

    mean: Predicted levels, not clipped, shape (N,).
    """
    level, model = clipped_levels(samples, mean)
    residual = level - model
    ring = np.floor(RINGS * np.log2(np.maximum(samples.deflection, 1e-4) / 1e-4)).astype(np.intp)
    step = np.floor(DIFFUSE_STEPS * samples.diffuse).astype(np.intp)
    exposure = np.unique(samples.facts.factor, return_inverse=True)[1]
    key = ((ring * 1000 + np.minimum(step, 999)) * 100)[samples.sample] + exposure[samples.image]
    middle, count = _medians(key, residual)
    spread, _ = _medians(key, np.abs(residual - middle))
    limit = np.maximum(DUST_SPREADS * 1.4826 * spread, DUST_LEVELS * samples.sensor.max_level)
    far = (np.abs(residual - middle) > limit) & (count >= LEAST_ALIKE)
    _, group = np.unique(key, return_inverse=True)
    share = np.bincount(group, weights=far) / np.bincount(group)
    return far & (share <= MOST_DUST)[group]


def measure_lack_of_fit(criterion: LeastSquares, x: Float64) -> LackOfFit:
    """Compare the residual of least squares with the noise of the rig file or, where they show more, of the images."""
    s = criterion.samples
    sensor = s.sensor
    mean = predicted(s, criterion.light(x), x)
    top = sensor.saturated_from
    lit = s.diffuse[s.sample] > 0.0
    seen = lit & ~(s.saturated & (mean >= top))
    if not seen.any():
        return LackOfFit(ratio=0.0)
    level, model = clipped_levels(s, mean)
    signal = np.minimum(mean, top) - sensor.black_level - x[DARK]
    variance = sensor.noise_variance(signal, frames=s.facts.frames[s.image])
    variance = np.maximum(variance, image_noise(s) ** 2)
    exposure = np.unique(s.facts.factor, return_inverse=True)[1][s.image]
    weight = criterion.weight * seen
    squares = np.bincount(exposure, weights=weight * (level - model) ** 2)
    floors = np.bincount(exposure, weights=weight * variance)
    ratio = math.sqrt(float(np.max(squares[floors > 0.0] / floors[floors > 0.0])))
    return LackOfFit(ratio=ratio)


def _medians(key: Index, values: Float64) -> tuple[Float64, Index]:
    # per value, the median and the number of those with its key
    order = np.lexsort((values, key))
    sorted_key = key[order]
    starts = np.flatnonzero(np.append(True, sorted_key[1:] != sorted_key[:-1]))
    counts = np.diff(np.append(starts, len(key)))
    ranked = values[order]
    middles = 0.5 * (ranked[starts + (counts - 1) // 2] + ranked[starts + counts // 2])
    group = np.empty(len(key), np.intp)
    group[order] = np.repeat(np.arange(len(starts)), counts)
    return middles[group], counts[group]
