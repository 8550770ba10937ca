"""The sensor: its levels, saturation and noise, and how it quantises what the camera sees."""

import math
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64, UInt8
from lightopt.core.errors import InputError

Level = TypeVar("Level", bound=np.floating[Any])


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A sensor, by EMVA Standard 1288, release 4.0.

    Raises InputError: When a value is out of its range
    """

    bit_depth: int  # bits of a delivered level, 1 to 16
    # delivered level from which a pixel counts as saturated; full scale, 2^bit_depth − 1, when not given. Real cameras
    # top out lower: 4080 of 4095, for instance.
    saturation_level: float | None = None
    black_level: float = 0.0  # delivered level without light
    read_noise_levels: float = 0.0  # standard deviation of the read noise [sensor level]
    # photo-electrons that make one sensor level; None for a sensor without shot noise
    electrons_per_level: float | None = None
    dsnu_levels: float = 0.0  # standard deviation over the pixels of the level without light [sensor level]
    prnu: float = 0.0  # standard deviation over the pixels of what they make of the same light, as a share of it
    linearity_error: float = 0.0  # mean deviation from the best line, as a share of the level: it is compressive

    def __post_init__(self) -> None:
        problems: list[str] = []
        if not 1 <= self.bit_depth <= 16 or self.bit_depth != int(self.bit_depth):
            raise InputError(f"sensor: bit_depth: expected a whole number from 1 to 16, found {self.bit_depth}")
        top = self.max_level
        if self.saturation_level is not None and not 0 < self.saturation_level <= top:
            problems.append(f"saturation_level: expected above 0 up to {top}, found {self.saturation_level}")
        if not 0 <= self.black_level < self.saturated_from:
            expected = f"from 0 to below the saturation level {self.saturated_from:g}"
            problems.append(f"black_level: expected {expected}, found {self.black_level}")
        not_negative = {n: getattr(self, n) for n in ("read_noise_levels", "dsnu_levels", "prnu", "linearity_error")}
        problems += [
            f"{name}: expected 0 or more, found {value}"
            for name, value in not_negative.items()
            if not (value >= 0 and math.isfinite(value))
        ]
        electrons = self.electrons_per_level
        if electrons is not None and not (electrons > 0 and math.isfinite(electrons)):
            problems.append(f"electrons_per_level: expected above 0, found {electrons}")
        if problems:
            raise InputError(*(f"sensor: {problem}" for problem in problems))

    @property
    def max_level(self) -> int:
        return (1 << int(self.bit_depth)) - 1

    @property
    def saturated_from(self) -> float:
        """Delivered level from which a pixel counts as saturated."""
        return float(self.max_level) if self.saturation_level is None else float(self.saturation_level)

    @property
    def fixed_pattern(self) -> bool:
        """Whether pixels differ in what they make of the same light."""
        return self.dsnu_levels > 0 or self.prnu > 0

    @overload
    def noise_variance(self, signal: float, *, frames: int = 1) -> float: ...

    @overload
    def noise_variance(self, signal: NDArray[Level], *, frames: int | Float64 = 1) -> NDArray[Level]: ...

    def noise_variance(self, signal: Any, *, frames: Any = 1) -> Any:
        """Variance of a delivered level: read and shot noise, which averaging reduces, fixed pattern and rounding.

        signal: Level above the black level [sensor level], of any shape; below 0 there is no shot noise
        frames: Of how many frames the level is the rounded mean
        Returns: [sensor level²], of the signal's shape and kind.
        """
        levels_per_electron = 1.0 / self.electrons_per_level if self.electrons_per_level else 0.0
        lit = max(signal, 0.0) if isinstance(signal, float) else np.maximum(signal, 0)
        noise = (self.read_noise_levels**2 + levels_per_electron * lit) / frames + 1.0 / 12.0
        if self.fixed_pattern:
            noise = noise + (self.dsnu_levels**2 + np.square(self.prnu * lit))
        return noise


Levels = Float32 | Float64
Quantised = UInt8 | NDArray[np.uint16]

# Pixels worked on at a time: bounds the float64 copies. Noise is drawn block by block, so changing it changes noise.
_BLOCK_PIXELS = 1 << 18

_PATTERN_SEED = 1288  # A camera has one fixed pattern, whatever image it takes.

# Of levels s·(1 + κ·(1 − s/top)) the mean deviation from the line that fits best, both as shares of the level, from
# 5 to 95 % of the top (EMVA 1288, section on linearity), is so many times κ.
_LINEARITY_OF_BEND = 0.1457

_LEAST_NOISE = 0.3

# means below this are drawn by inversion; of those more than 80 counts have a probability under 1e-20
_FEW_ELECTRONS, _MOST_OF_FEW = 20.0, 80


def expose(
    levels: Levels, *, sensor: Sensor, exposure: float, full_scale: float, rng: np.random.Generator | None = None
) -> Quantised:
    """Quantise what the camera sees: scaled, noisy with a generator, rounded half up, clipped to the bit depth.

    Sensor level = black level + exposure · levels · (2^b − 1) / full scale. Shot noise is Poisson in the
    photo-electrons above black, read noise is Gaussian, and with noise comes the fixed pattern of the pixels (EMVA
    Standard 1288, release 4.0, section 2). A linearity error bends the levels, with noise and without.

    levels: Linear image, shape (H, W) [grey level at exposure 1, the light's gain applied]
    exposure: Relative to the exposure at which the levels hold
    full_scale: Grey level that makes a full-scale sensor level at exposure 1: the scale of the reflectance
    Returns: uint8 (up to 8 bits) or uint16, right-aligned, shape of `levels`.
    Raises InputError: When the levels are not of shape (H, W), NaN or infinite, or the exposure or full scale is not a
        positive number
    """
    for name, value in (("exposure", exposure), ("full_scale", full_scale)):
        if not (value > 0 and math.isfinite(value)):
            raise InputError(f"{name}: expected a number above 0, found {value}")
    scale = exposure * sensor.max_level / full_scale
    if levels.ndim != 2:
        raise InputError(f"image to expose: expected shape (H, W), found {levels.shape}")
    small = sensor.bit_depth <= 8
    quantised: Quantised = np.empty(levels.shape, np.uint8) if small else np.empty(levels.shape, np.uint16)
    rows = max(1, _BLOCK_PIXELS // max(1, levels.shape[1]))
    pattern = np.random.default_rng(_PATTERN_SEED) if rng is not None and sensor.fixed_pattern else None
    for top in range(0, levels.shape[0], rows):
        block = levels[top : top + rows].astype(np.float64)
        finite = np.isfinite(block)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            raise InputError(
                f"image to expose: {int((~finite).sum())} levels are not finite in rows {top} to "
                f"{top + len(block) - 1}, the first at row {top + row}, column {column}: {block[row, column]}"
            )
        block *= scale
        if pattern is not None:
            block *= 1.0 + sensor.prnu * pattern.standard_normal(block.shape)
        if rng is not None:
            _add_noise(block, sensor=sensor, rng=rng)
        if pattern is not None:
            block += sensor.dsnu_levels * pattern.standard_normal(block.shape)
        if sensor.linearity_error > 0:
            share = np.clip(block / (sensor.saturated_from - sensor.black_level), 0.0, 1.0)
            block *= 1.0 + sensor.linearity_error / _LINEARITY_OF_BEND * (1.0 - share)
        block += sensor.black_level + 0.5
        np.floor(block, out=block)
        np.clip(block, 0, sensor.max_level, out=block)
        quantised[top : top + rows] = block
    return quantised


def _add_noise(signal: Float64, *, sensor: Sensor, rng: np.random.Generator) -> None:
    """Add shot and read noise to the signal above black [sensor level], in place."""
    if sensor.electrons_per_level is not None:
        # Only light makes shot noise: what is below zero (a dark-corrected input) is left as it is.
        # As many draws for every pixel, whatever its light: another image of the same seed has the same noise.
        uniform, normal = rng.random(signal.shape), rng.standard_normal(signal.shape)
        lit = signal > 0
        electrons = _poisson(signal[lit] * sensor.electrons_per_level, uniform[lit], normal[lit])
        signal[lit] = electrons / sensor.electrons_per_level
    if sensor.read_noise_levels > 0:
        signal += sensor.read_noise_levels * rng.standard_normal(signal.shape)


def _poisson(mean: Float64, uniform: Float64, normal: Float64) -> Float64:
    """Poisson numbers from one uniform and one normal draw each; all of shape (k,).

    Small means by inversion, others by the Cornish–Fisher expansion of the quantile (Cornish and Fisher 1938,
    doi:10.2307/1400905), which is off by one count in less than 1 % of the draws.
    """
    z, root = normal, np.sqrt(mean)
    skew = (z * z - 1.0) / 6.0
    bend = np.where(mean > 0, (z - z**3) / (72.0 * np.maximum(root, 1e-300)), 0.0)
    counts = np.floor(mean + root * z + skew + bend + 0.5)
    few = np.flatnonzero(mean < _FEW_ELECTRONS)
    probability = np.exp(-mean[few])
    below, count = np.zeros(len(few)), np.zeros(len(few))
    for number in range(1, _MOST_OF_FEW):
        below += probability
        count += uniform[few] >= below
        probability *= mean[few] / number
    counts[few] = count
    return counts


def clipped_mean(level: Float64, noise: float) -> tuple[Float64, Float64]:
    """Mean of noisy levels that are rounded, and none of which is below 0, and its slope; both of shape (k,).

    level: Without noise, shape (k,) [sensor level]
    noise: Standard deviation; taken as no less than 0.3 levels, below which the mean is a staircase
    """
    from scipy import special  # takes long to load, and a capture seldom needs it

    noise = max(noise, _LEAST_NOISE)
    mean, slope = level.copy(), np.ones(len(level))
    low = np.flatnonzero(level < 6.0 * noise)
    # the mean is the sum over k of the probability that the rounded level is k or more
    z = (level[low, None] + 0.5 - np.arange(1.0, 14.0 * noise + 2.0)) / noise
    mean[low] = special.ndtr(z).sum(axis=1)
    slope[low] = np.exp(-0.5 * np.square(z)).sum(axis=1) / (noise * math.sqrt(2.0 * math.pi))
    return mean, slope


def saturated(quantised: Quantised, sensor: Sensor) -> Bool:
    """Where the delivered level reaches the sensor's saturation level; boolean, shape of `quantised`."""
    return quantised >= sensor.saturated_from


def image_rng(seed: int, *, light: int, posture: int, exposure: int) -> np.random.Generator:
    """Make the generator of one image's noise: independent of other images', the same in any order.

    light, posture, exposure: Index of the image's light, posture and exposure in the rig, the part and the run
    Raises InputError: When a number is negative
    """
    for name, value in (("seed", seed), ("light", light), ("posture", posture), ("exposure", exposure)):
        if value < 0:
            raise InputError(f"noise {name}: expected 0 or more, found {value}")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(light, posture, exposure)))
