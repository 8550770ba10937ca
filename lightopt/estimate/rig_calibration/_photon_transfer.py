"""Photon transfer: a camera's conversion gain, read noise, black level, linearity and saturation, from pairs of frames.

EMVA Standard 1288, release 4.0 (doi:10.5281/zenodo.3951558), sections 6 and 8, with two changes: the line of the
variance is weighted by the variance of its points, and the noise of dark frames is that of a rounded and clipped
Gaussian, so that a black level at 0 is allowed. Intervals are by the delete-one jackknife over blocks of the image.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import t as student

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.estimate.rig_calibration._measured import Measured, measured

LEAST_LEVELS = 6
FITTED_SHARE = 0.7  # of saturation, up to which the variance is fitted (section 6.6)
BLOCKS = 8  # along each side of the image
LEAST_BLOCK_SIDE = 4  # [px]
ROUNDING_VARIANCE = 1.0 / 12.0  # [sensor level²]

# a pair is refused where its mean levels differ by more than this share of the signal …
PAIR_DIFFERENCE = 0.03
# … or where the means of its blocks differ by more than their noise and this share explain
PATTERN_SHARE = 0.003
PATTERN_SPREADS = 3.0

LEAST_ABOVE_ONE = 1e-4  # share of pixels above level 1 that tells the noise of frames that are mostly at level 0

SATURATED_SHARE = 1e-3  # a pair with more pixels than this at saturation is not fitted
COLLAPSED = 0.5  # share of the predicted variance below which a frame is saturated


@dataclass(frozen=True, kw_only=True, eq=False)
class FramePair:
    """Two frames of a still scene under the same light.

    first, second: Delivered levels, whole numbers, shape (H, W) [sensor level]
    exposure: Exposure time, in any unit that is common to all pairs
    """

    first: NDArray[Any]
    second: NDArray[Any]
    exposure: float


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotonTransfer:
    """The sensor as the pairs show it; the names are those of :class:`lightopt.optics.Sensor`.

    levels_per_electron: Conversion gain K [sensor level]
    electrons_per_level: 1/K
    read_noise_levels: Standard deviation of the noise without light, without rounding [sensor level]
    black_level: Mean level without light, before clipping at 0 [sensor level]
    saturation_level: Level at which the brightest frames pile up [sensor level]; None where none is saturated
    linearity_error: Largest deviation of the mean level from a straight line in the exposure time [% of the range]
    exposures, means, variances: Of the pairs by exposure: mean level above black and temporal variance without
        rounding, shape (k,) [sensor level, sensor level²]
    fitted: Pairs that the conversion gain is from, shape (k,)
    """

    levels_per_electron: Measured
    electrons_per_level: Measured
    read_noise_levels: Measured
    black_level: Measured
    saturation_level: float | None
    linearity_error: float
    exposures: Float64
    means: Float64
    variances: Float64
    fitted: Bool


def photon_transfer(pairs: Sequence[FramePair], darks: Sequence[FramePair], *, bit_depth: int) -> PhotonTransfer:
    """Measure a camera by pairs of frames at six or more levels and pairs of dark frames.

    darks: Pairs without light; of several exposures, each lit pair is compared with the nearest one
    Raises InputError: Where frames are missing, do not belong together, saturate or move; one message per problem
    """
    top = (1 << bit_depth) - 1
    _check(pairs, darks, top)
    pairs = sorted(pairs, key=lambda pair: pair.exposure)
    lit, dark = _sums(pairs), _sums(darks)
    nearest = [int(np.argmin([abs(d.exposure - pair.exposure) for d in darks])) for pair in pairs]
    saturation = _saturation_level(pairs, lit, dark, top)
    limit = float(top) if saturation is None else saturation

    whole = _estimate(lit, dark, nearest, None)
    room = limit - whole.black
    clear = np.array([_share_from(pair, limit) < SATURATED_SHARE for pair in pairs])
    fitted = clear & (whole.means <= FITTED_SHARE * room) & (whole.means > 0.0)
    if np.sum(fitted) < LEAST_LEVELS:
        raise InputError(
            f"photon transfer: {int(np.sum(fitted))} of {len(pairs)} pairs are above dark and below "
            f"{FITTED_SHARE:.0%} of saturation (level {limit:g}), {LEAST_LEVELS} are needed: use shorter exposures, "
            f"spread between 5 and {FITTED_SHARE:.0%}"
        )
    whole = _estimate(lit, dark, nearest, fitted)
    blocks = lit.shape[1]
    keep = ~np.eye(blocks, dtype=np.bool_)
    left_out = [_estimate(lit[:, k], dark[:, k], nearest, fitted) for k in keep]
    return PhotonTransfer(
        levels_per_electron=_jackknife(whole.gain, [e.gain for e in left_out]),
        electrons_per_level=_jackknife(1.0 / whole.gain, [1.0 / e.gain for e in left_out]),
        read_noise_levels=_jackknife(whole.noise, [e.noise for e in left_out]),
        black_level=_jackknife(whole.black, [e.black for e in left_out]),
        saturation_level=saturation,
        linearity_error=_linearity_error(pairs, whole.means, clear, room),
        exposures=np.array([pair.exposure for pair in pairs]),
        means=whole.means,
        variances=whole.variances,
        fitted=fitted,
    )


def gaussian_of_levels(mean: float, variance: float) -> tuple[float, float]:
    """Mean and standard deviation of a Gaussian that, rounded and clipped at 0, has this mean and variance.

    All in sensor levels. Noise that rounding hides, below about 0.13 levels, is given as 0.
    """
    if variance < 1e-4:
        return mean, 0.0
    # far from 0 and with more than half a level of noise, rounding adds 1/12 and nothing else (Widrow et al. 1996)
    centre, spread = mean, math.sqrt(max(variance - ROUNDING_VARIANCE, 0.01))
    if centre > 6.0 * spread and spread > 0.5:
        return centre, spread
    for _ in range(60):
        here = np.array(_rounded_moments(centre, spread))
        step = 1e-4
        slope = np.stack(
            [
                (np.array(_rounded_moments(centre + step, spread)) - here) / step,
                (np.array(_rounded_moments(centre, spread * (1.0 + step))) - here) / step,
            ],
            axis=1,
        )
        change = np.linalg.lstsq(slope, np.array([mean, variance]) - here, rcond=1e-6)[0]
        change = np.clip(change, -0.3, 0.3)
        centre, spread = centre + float(change[0]), spread * math.exp(float(change[1]))
        if float(np.abs(change).max()) < 1e-10:
            break
    return centre, spread


def _rounded_moments(centre: float, spread: float) -> tuple[float, float]:
    first = max(0, math.floor(centre - 9.0 * spread))
    last = max(first + 1, math.ceil(centre + 9.0 * spread) + 1)
    level = np.arange(first, last + 1, dtype=np.float64)
    above = ndtr(-(level[1:] - 0.5 - centre) / spread)  # probability of each level after the first, or a higher one
    probability = -np.diff(np.concatenate([[1.0], above, [0.0]]))
    mean = float(probability @ level)
    return mean, float(probability @ np.square(level - mean))


@dataclass(frozen=True)
class _Estimate:
    means: Float64
    variances: Float64
    black: float
    noise: float
    gain: float


def _sums(pairs: Sequence[FramePair]) -> Float64:
    # per pair and block: pixels, Σ(a + b)/2, Σ(a − b), Σ(a − b)²; shape (k, BLOCKS², 4)
    rows, columns = (side // BLOCKS for side in pairs[0].first.shape)

    def total(values: Float64) -> Float64:
        cut = values[: rows * BLOCKS, : columns * BLOCKS]
        return cut.reshape(BLOCKS, rows, BLOCKS, columns).sum(axis=(1, 3)).ravel()

    found: list[Float64] = []
    for pair in pairs:
        a, b = pair.first.astype(np.float64), pair.second.astype(np.float64)
        size = np.full(BLOCKS**2, float(rows * columns))
        found.append(np.stack([size, total(0.5 * (a + b)), total(a - b), total(np.square(a - b))], axis=1))
    return np.array(found)


def _moments(sums: Float64) -> tuple[Float64, Float64]:
    # mean level, and temporal variance ½⟨(A − B)²⟩ − ½(μA − μB)² (equation 27); each of shape (k,)
    n, level, difference, square = np.moveaxis(sums.sum(axis=1), -1, 0)
    return level / n, 0.5 * square / n - 0.5 * np.square(difference / n)


def _estimate(lit: Float64, dark: Float64, nearest: list[int], fitted: Bool | None) -> _Estimate:
    mean, variance = _moments(lit)
    dark_gaussians = [gaussian_of_levels(float(m), float(v)) for m, v in zip(*_moments(dark), strict=True)]
    blacks, noises = (np.array(values) for values in zip(*dark_gaussians, strict=True))
    means = mean - blacks[nearest]
    variances = variance - ROUNDING_VARIANCE
    gain = math.nan
    if fitted is not None:
        x, y = means[fitted], (variances - np.square(noises[nearest]))[fitted]
        # the variance of a variance is 2σ⁴/N
        weight = 1.0 / np.square(np.maximum(variance[fitted], ROUNDING_VARIANCE))
        gain = float(np.sum(weight * x * y) / np.sum(weight * x * x))
        if not gain > 0.0:
            raise InputError(
                "photon transfer: the noise does not grow with the level: these are not frames as the camera delivers "
                "them; switch off averaging, noise reduction and gamma"
            )
    noise = math.sqrt(float(np.mean(np.square(noises))))
    return _Estimate(means, variances, float(np.mean(blacks)), noise, gain)


def _jackknife(value: float, left_out: list[float]) -> Measured:
    # Efron 1982, doi:10.1137/1.9781611970319, chapter 3
    count = len(left_out)
    error = math.sqrt((count - 1) * float(np.var(left_out)))
    return measured(value, error, errors_95=float(student.ppf(0.975, count - 1)))


def _share_from(pair: FramePair, level: float) -> float:
    return max(float(np.mean(frame >= level)) for frame in (pair.first, pair.second))


def _saturation_level(pairs: Sequence[FramePair], lit: Float64, dark: Float64, top: int) -> float | None:
    """Level where the brightest frame piles up: there many pixels share a level, and its noise is lost."""
    mean, variance = _moments(lit)
    dark_mean, dark_variance = (float(np.mean(values)) for values in _moments(dark))
    brightest = int(np.argmax(mean))
    values, counts = np.unique(pairs[brightest].first, return_counts=True)
    if counts[-1] > 0.01 * counts.sum() and (values[-1] == top or counts[-1] > 2 * counts[-2:-1].sum()):
        return float(values[-1])
    slope = (variance - dark_variance) / np.maximum(mean - dark_mean, 1e-9)
    if variance[brightest] - dark_variance < COLLAPSED * float(np.median(slope)) * (mean[brightest] - dark_mean):
        return float(values[np.searchsorted(np.cumsum(counts), 0.01 * counts.sum())])
    return None


def _linearity_error(pairs: Sequence[FramePair], means: Float64, clear: Bool, room: float) -> float:
    exposures = np.array([pair.exposure for pair in pairs])[clear]
    if len(np.unique(exposures)) < 3:
        return math.nan  # the light was varied, not the exposure time
    level = means[clear]
    # equal weight for equal shares of the level (section 6.7)
    line = np.polynomial.Polynomial.fit(exposures, level, 1, w=1.0 / np.maximum(level, 0.01 * room))
    return 100.0 * float(np.abs(level - line(exposures)).max()) / room


def _check(pairs: Sequence[FramePair], darks: Sequence[FramePair], top: int) -> None:
    problems: list[str] = []
    if not darks:
        problems.append("no dark frames: cover the lens, switch the lights off, and capture a pair at the same gain")
    if len(pairs) < LEAST_LEVELS:
        problems.append(f"{len(pairs)} levels, {LEAST_LEVELS} are needed: capture pairs at more exposure times")
    every = [*((f"pair at exposure {p.exposure:g}", p) for p in pairs), *(("dark pair", p) for p in darks)]
    shape = every[0][1].first.shape if every else ()
    if every and (len(shape) != 2 or min(shape) < BLOCKS * LEAST_BLOCK_SIDE):
        problems.append(f"frames of shape {shape}: expected (H, W) of at least {BLOCKS * LEAST_BLOCK_SIDE} pixels each")
    for name, pair in every:
        for frame in (pair.first, pair.second):
            if frame.shape != shape:
                problems.append(f"{name}: shape {frame.shape}, others have {shape}")
            elif not np.issubdtype(frame.dtype, np.integer) or frame.min() < 0 or frame.max() > top:
                problems.append(
                    f"{name}: expected whole levels from 0 to {top}, found {frame.dtype} from {frame.min()} to "
                    f"{frame.max()}: give the frames as the camera delivers them"
                )
    for dark in darks:
        values = np.concatenate([np.ravel(dark.first), np.ravel(dark.second)])
        if np.mean(values == 0) > 0.5 and np.mean(values > 1) < LEAST_ABOVE_ONE:
            problems.append(
                "dark pair: nearly all pixels are at level 0, which hides the noise: raise the camera's black level"
            )
    if not problems:
        problems = _pair_problems(pairs, darks)
    if problems:
        raise InputError(*(f"photon transfer: {problem}" for problem in problems))


def _pair_problems(pairs: Sequence[FramePair], darks: Sequence[FramePair]) -> list[str]:
    problems: list[str] = []
    black, _ = _moments(_sums(darks))
    for pair, sums in zip(pairs, _sums(pairs), strict=True):
        name = f"pair at exposure {pair.exposure:g}"
        mean, variance = (float(values[0]) for values in _moments(sums[None]))
        signal = mean - float(np.mean(black))
        difference = sums[:, 2] / sums[:, 0]
        shift = float(np.mean(difference))
        # a common change of the light leaves a difference in proportion to the level
        level = sums[:, 1] / sums[:, 0] - float(np.mean(black))
        pattern = difference - level * float(np.sum(difference * level) / max(np.sum(level * level), 1e-9))
        noise = math.sqrt(2.0 * max(variance, ROUNDING_VARIANCE) / float(sums[0, 0]))
        if abs(shift) > PAIR_DIFFERENCE * max(signal, 0.0) + 5.0 * noise:
            problems.append(
                f"{name}: the frames differ by {abs(shift):.3g} levels of {signal:.3g}: they have different exposures, "
                "or the light is not steady yet; capture both in a row, with the light warmed up"
            )
        elif float(np.sqrt(np.mean(np.square(pattern)))) > PATTERN_SPREADS * noise + PATTERN_SHARE * max(signal, 0.0):
            problems.append(
                f"{name}: the difference of the frames has a pattern: light, part or camera moved between them, or "
                "other light comes in; fix them and capture the pair again"
            )
    return problems
