"""The noise that the images show."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.estimate.reflectance._likelihood import significant
from lightopt.estimate.reflectance._samples import Samples
from lightopt.optics import Sensor

LEVEL_BINS, LEAST_PER_BIN = 12, 150
# levels nearer than this many deviations to black or to saturation are clipped, and show less noise than there is
CLEAR_OF_ENDS = 4.0

# residuals beyond this many deviations are dust; what is left of a Gaussian's variance within
TRIM, TRIMMED_VARIANCE = 3.0, 0.97334

_WINDOW = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]])
SIGNIFICANT = 3.0
WELL_KNOWN = 0.3  # a figure is determined where its standard error is no more than this share of it


@dataclass(frozen=True, kw_only=True)
class MeasuredNoise:
    """Noise of the camera, from the variance of measured minus predicted level over the level."""

    # deviation without light, and its standard error [sensor level]; None where not determined
    read_noise: float | None = None
    read_noise_error: float | None = None
    # photo-electrons per level and their standard error; None where not determined
    electrons: float | None = None
    electrons_error: float | None = None
    hindrance: str = ""  # why something is not determined, or empty

    def as_dict(self) -> dict[str, Any]:
        names = ("read_noise_levels", "read_noise_standard_error", "electrons_per_level", "electrons_standard_error")
        values = (self.read_noise, self.read_noise_error, self.electrons, self.electrons_error)
        numbers = {k: None if v is None else significant(v, 4) for k, v in zip(names, values, strict=True)}
        return {**numbers, "hindrance": self.hindrance or None}


def measure_noise(samples: Samples, mean: Float64, *, describes: bool = True) -> MeasuredNoise:
    """Read noise, and shot noise where the variance grows with the level (EMVA Standard 1288, photon transfer)."""
    if not describes:
        return MeasuredNoise(hindrance="the model does not describe these images, and its error is not noise")
    typical = image_noise(samples)
    # by the level that is predicted: that of a pixel itself would be chosen along with its noise
    clear = (mean > CLEAR_OF_ENDS * typical) & (mean < samples.sensor.saturated_from - CLEAR_OF_ENDS * typical)
    clear &= (samples.diffuse[samples.sample] > 0.0) & ~samples.saturated
    # a mean of N frames has an N-th of the variance
    frames = samples.facts.frames[samples.image][clear]
    signal = np.maximum(mean - samples.sensor.black_level, 0.0)[clear]
    residual = (samples.level[clear] - mean[clear]) * np.sqrt(frames)
    if len(signal) < 2 * LEAST_PER_BIN:
        return MeasuredNoise(hindrance="too few lit pixels that are neither black nor saturated")
    order = np.argsort(signal, kind="stable")
    bins = np.array_split(order, min(LEVEL_BINS, len(order) // LEAST_PER_BIN))
    rounding = float(np.mean(frames)) / 12.0
    at = np.array([float(np.mean(signal[b])) for b in bins])
    variance = np.array([_variance(residual[b]) for b in bins]) - rounding
    error = (variance + rounding) * np.sqrt(2.0 / np.array([len(b) for b in bins]))
    if np.median(variance) < rounding:
        return MeasuredNoise(hindrance="the noise is less than that of rounding to whole levels")
    return _photon_transfer(at, variance, error, samples.sensor)


def noise_warnings(noise: MeasuredNoise) -> Iterator[str]:
    """Warn where the noise is not, or only partly, written."""
    if noise.read_noise is None and noise.electrons is None:
        yield f"the noise is not written: {noise.hindrance}"
    elif noise.hindrance:
        yield f"only a part of the noise is written: {noise.hindrance}"


def _photon_transfer(signal: Float64, variance: Float64, error: Float64, sensor: Sensor) -> MeasuredNoise:
    # the line through variance over level: read noise squared at 0, levels per electron its slope
    design = np.stack([np.ones(len(signal)), signal], axis=1) / error[:, None]
    inverse = np.linalg.pinv(design.T @ design)
    line = inverse @ design.T @ (variance / error)
    freedom = max(1, len(signal) - 2)
    spread = max(1.0, float(np.sum((design @ line - variance / error) ** 2)) / freedom)
    a, b = (float(value) for value in line)
    a_error, b_error = (math.sqrt(spread * float(inverse[k, k])) for k in (0, 1))
    own = 0.0 if sensor.electrons_per_level is None else 1.0 / sensor.electrons_per_level
    shot = MeasuredNoise(hindrance="" if own else "no shot noise is seen beside the read noise")
    if b > SIGNIFICANT * b_error and b_error < WELL_KNOWN * b:
        shot = MeasuredNoise(electrons=1.0 / b, electrons_error=b_error / b**2)
    elif abs(own - b) > SIGNIFICANT * b_error:
        most = b + SIGNIFICANT * b_error
        least = f": there are at least {1.0 / most:.3g} electrons per level" if most > 0.0 else ""
        return MeasuredNoise(
            hindrance=f"the images show less shot noise than the rig file's electrons_per_level gives{least}"
            if own > b
            else "the noise changes with the level, but not significantly enough to separate read noise from shot "
            "noise; add images of other levels"
        )
    else:
        weight = 1.0 / error**2
        a = float(np.sum(weight * (variance - own * signal)) / np.sum(weight))
        a_error = math.sqrt(spread / float(np.sum(weight)))
    if a <= 0.0 or 0.5 * a_error > WELL_KNOWN * a:
        return replace(shot, hindrance="shot noise hides the read noise; add darker images")
    read = math.sqrt(a)
    return replace(shot, read_noise=read, read_noise_error=0.5 * a_error / read)


def _variance(values: Float64) -> float:
    # without the tails: edges and dust
    spread = max(1.4826 * float(np.median(np.abs(values))), 0.2)
    for _ in range(2):
        inside = values[np.abs(values) <= TRIM * spread]
        spread = math.sqrt(float(np.mean(inside**2)) / TRIMMED_VARIANCE)
    return spread**2


def image_noise(samples: Samples) -> float:
    """Typical deviation of a lit pixel from the plane through its neighbours [sensor level]; 0 where there is none.

    Immerkær 1996, doi:10.1006/cviu.1996.0060: what a 3 × 3 window leaves of anything that is a plane or a saddle.
    """
    row, column = samples.places
    height, width = samples.images[0].levels.shape
    use = (row > 0) & (row < height - 1) & (column > 0) & (column < width - 1)
    use &= (samples.diffuse[samples.sample] > 0.0) & (samples.level > 0.0) & ~samples.saturated
    index = np.flatnonzero(use)
    if not len(index):
        return 0.0
    index = index[np.argsort(samples.image[index], kind="stable")]
    ends = np.searchsorted(samples.image[index], np.arange(1, len(samples.images)))
    responses: list[Float64] = []  # 6 times the noise
    for image, here in zip(samples.images, np.split(index, ends), strict=True):
        r, c = row[here], column[here]
        response = np.zeros(len(here))
        for (y, x), factor in np.ndenumerate(_WINDOW):
            response += factor * image.levels[r + y - 1, c + x - 1]
        responses.append(response)
    return 1.4826 * float(np.median(np.abs(np.concatenate(responses)))) / 6.0
