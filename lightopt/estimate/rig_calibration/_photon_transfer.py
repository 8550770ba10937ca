"""Photon transfer: a camera's conversion gain, read noise, black level, linearity and saturation, from pairs of frames.

EMVA Standard 1288, release 4.0 (doi:10.5281/zenodo.3951558), sections 6 and 8, with two changes: the line of the
variance is weighted by the variance of its points, and the noise of dark frames is that of a rounded and clipped
Gaussian, so that a black level at 0 is allowed. Intervals are by the delete-one jackknife over blocks of the image.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr, stdtrit

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError, refuse
from lightopt.estimate.rig_calibration._deviations import Measured, measured

LEAST_LEVELS = 6
FITTED_SHARE = 0.7  # of saturation, up to which the variance is fitted (section 6.6)
BLOCKS, LEAST_BLOCK_SIDE = 8, 4  # along each side of the image, [px]
ROUNDING_VARIANCE = 1.0 / 12.0  # [sensor level²]
PAIR_DIFFERENCE = 0.03  # share of the signal by which the mean levels of a pair may differ
PATTERN_SHARE, PATTERN_SPREADS = 0.003, 3.0  # those of its blocks, beyond a common factor: of the signal, of the noise
LEAST_ABOVE_ONE = 1e-4  # share of pixels above level 1 that tells the noise of frames that are mostly at level 0
TARGET_SHARE, BLOCK_SHARE = 0.3, 0.25  # of the level of the target's brightest pixels; of the pixels of a block
SATURATED_SHARE = 1e-3  # a pair with more pixels than this at saturation is not fitted
PILE = 0.01  # share of the pixels of a saturated frame at its highest level
COLLAPSED = 0.5  # share of the expected variance below which a frame is saturated


@dataclass(frozen=True, kw_only=True, eq=False)
class FramePair:
    first: NDArray[Any]  # delivered levels, whole numbers, shape (H, W) [sensor level]
    second: NDArray[Any]
    exposure: float  # exposure time, in any unit that is common to all pairs


@dataclass(frozen=True, kw_only=True, eq=False)
class PhotonTransfer:
    """The sensor as the pairs show it; the names are those of :class:`lightopt.optics.Sensor`."""

    electrons_per_level: Measured  # 1/K of the conversion gain K [sensor level]
    read_noise_levels: Measured  # standard deviation of the noise without light, without rounding [sensor level]
    black_level: Measured  # mean level without light, before clipping at 0 [sensor level]
    saturation_level: float | None  # where the brightest frames pile up [sensor level]; None: none is saturated
    # largest deviation of the mean level from a line in the exposure time [% of the range]; NaN: the light was varied
    linearity_error: float
    exposures: Float64  # of the pairs, ascending, shape (k,)
    means: Float64  # level above black [sensor level], shape (k,)
    variances: Float64  # temporal, without rounding [sensor level²], shape (k,)
    fitted: Bool  # pairs that the conversion gain is from, shape (k,)


def photon_transfer(pairs: Sequence[FramePair], darks: Sequence[FramePair], *, bit_depth: int) -> PhotonTransfer:
    """Measure a camera by pairs of frames at six or more levels and pairs of dark frames.

    darks: Pairs without light; of several exposures, each lit pair is compared with the nearest one
    Raises InputError: Where frames are missing, do not belong together, saturate or move; one message per problem
    """
    top = (1 << bit_depth) - 1
    pairs = sorted(pairs, key=lambda pair: pair.exposure)
    _check_frames(pairs, darks, top)
    # dark surroundings have another noise where it is clipped at level 0
    brightest = 0.5 * (pairs[-1].first.astype(np.float64) + pairs[-1].second)
    target = brightest >= TARGET_SHARE * np.percentile(brightest, 90.0)
    lit, dark = _sums(pairs, target), _sums(darks, target)
    _check_pairs(pairs, lit, float(np.mean(_moments(dark)[0])))
    exposures = np.array([pair.exposure for pair in pairs])
    nearest = [int(np.argmin([abs(d.exposure - exposure) for d in darks])) for exposure in exposures]
    saturation = _saturation_level(pairs, lit, dark, top)
    limit = float(top) if saturation is None else saturation

    below = np.array([max(np.mean(f >= limit) for f in (p.first, p.second)) < SATURATED_SHARE for p in pairs])
    first = _estimate(lit, dark, nearest, below)
    room = limit - first.black
    fitted = below & (first.means <= FITTED_SHARE * room) & (first.means > 0.0)
    if np.sum(fitted) < LEAST_LEVELS:
        raise InputError(
            f"photon transfer: {int(np.sum(fitted))} of {len(pairs)} pairs are above dark and below "
            f"{FITTED_SHARE:.0%} of saturation (level {limit:g}), {LEAST_LEVELS} are needed: use shorter exposures"
        )
    whole = _estimate(lit, dark, nearest, fitted)
    if not whole.gain > 0.0:
        raise InputError("photon transfer: the noise does not grow with the level: switch off averaging and gamma")
    left_out = [_estimate(lit[:, k], dark[:, k], nearest, fitted) for k in ~np.eye(lit.shape[1], dtype=np.bool_)]
    line_error = math.nan
    if len(np.unique(exposures[below])) > 2:
        # equal weight for equal shares of the level (section 6.7)
        level = whole.means[below]
        weight = 1.0 / np.maximum(level, 0.01 * room)
        line = np.polynomial.Polynomial.fit(exposures[below], level, 1, w=weight)
        line_error = 100.0 * float(np.abs(level - line(exposures[below])).max()) / room
    return PhotonTransfer(
        electrons_per_level=_jackknife(1.0 / whole.gain, [1.0 / e.gain for e in left_out]),
        read_noise_levels=_jackknife(whole.noise, [e.noise for e in left_out]),
        black_level=_jackknife(whole.black, [e.black for e in left_out]),
        saturation_level=saturation,
        linearity_error=line_error,
        exposures=exposures,
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
    spread = math.sqrt(max(variance - ROUNDING_VARIANCE, 0.01))
    # far from 0 and with more than half a level of noise, rounding adds 1/12 and nothing else (Widrow et al. 1996)
    if mean > 6.0 * spread and spread > 0.5:
        return mean, spread

    def off(x: Float64) -> Float64:
        centre, spread = x[0], math.exp(x[1])
        level = np.arange(max(0, math.floor(centre - 9.0 * spread)), math.ceil(max(centre, 0.0) + 9.0 * spread) + 2.0)
        above = ndtr(-(level[1:] - 0.5 - centre) / spread)  # probability of each level but the first, or a higher one
        probability = -np.diff(np.concatenate([[1.0], above, [0.0]]))
        here = float(probability @ level)
        return np.array([here - mean, float(probability @ np.square(level - here)) - variance])

    centre, logarithm = least_squares(off, [mean, math.log(spread)], method="lm", xtol=1e-12, ftol=1e-12).x
    return float(centre), math.exp(logarithm)


class _Estimate(NamedTuple):
    means: Float64
    variances: Float64
    black: float
    noise: float
    gain: float


def _sums(pairs: Sequence[FramePair], target: Bool) -> Float64:
    # per pair and block: pixels of the target, Σ(a + b)/2, Σ(a − b), Σ(a − b)²; shape (k, blocks, 4). Blocks that show
    # little of the target are left out
    rows, columns = (side // BLOCKS for side in pairs[0].first.shape)
    found: list[Float64] = []
    for pair in pairs:
        a, b = pair.first.astype(np.float64), pair.second.astype(np.float64)
        terms = target * np.stack([np.ones_like(a), 0.5 * (a + b), a - b, np.square(a - b)])
        blocks = terms[:, : rows * BLOCKS, : columns * BLOCKS].reshape(4, BLOCKS, rows, BLOCKS, columns)
        found.append(blocks.sum(axis=(2, 4)).reshape(4, -1).T)
    sums = np.array(found)
    return sums[:, sums[0, :, 0] >= BLOCK_SHARE * rows * columns]


def _moments(sums: Float64) -> tuple[Float64, Float64]:
    # mean level, and temporal variance ½⟨(A − B)²⟩ − ½(μA − μB)² (equation 27); each of shape (k,)
    n, level, difference, square = np.moveaxis(sums.sum(axis=1), -1, 0)
    return level / n, 0.5 * square / n - 0.5 * np.square(difference / n)


def _estimate(lit: Float64, dark: Float64, nearest: list[int], fitted: Bool) -> _Estimate:
    mean, variance = _moments(lit)
    gaussians = [gaussian_of_levels(float(m), float(v)) for m, v in zip(*_moments(dark), strict=True)]
    blacks, noises = np.array(gaussians).T
    means, variances = mean - blacks[nearest], variance - ROUNDING_VARIANCE
    x, y = means[fitted], (variances - np.square(noises[nearest]))[fitted]
    weight = 1.0 / np.square(np.maximum(variance[fitted], ROUNDING_VARIANCE))  # the variance of a variance is 2σ⁴/N
    gain = float(np.sum(weight * x * y) / max(float(np.sum(weight * x * x)), 1e-300))
    return _Estimate(means, variances, float(np.mean(blacks)), math.sqrt(float(np.mean(np.square(noises)))), gain)


def _jackknife(value: float, left_out: list[float]) -> Measured:
    # Efron 1982, doi:10.1137/1.9781611970319, chapter 3
    freedom = len(left_out) - 1
    error = math.sqrt(freedom * float(np.var(left_out)))
    return measured(value, error, errors_95=float(stdtrit(freedom, 0.975)))


def _saturation_level(pairs: Sequence[FramePair], lit: Float64, dark: Float64, top: int) -> float | None:
    # where the brightest frame piles up: there many pixels share a level, or their noise is lost
    (mean, variance), (black, noise) = _moments(lit), _moments(dark)
    brightest = int(np.argmax(mean))
    values, counts = np.unique(pairs[brightest].first, return_counts=True)
    share = counts / counts.sum()
    if share[-1] > PILE and (values[-1] == top or share[-1] > 2.0 * share[-2:-1].sum()):
        return float(values[-1])
    signal, own = mean - black.mean(), variance - noise.mean()
    expected = float(np.median(own / np.maximum(signal, 1e-9))) * signal[brightest]
    return float(values[np.searchsorted(np.cumsum(share), PILE)]) if own[brightest] < COLLAPSED * expected else None


def _check_frames(pairs: Sequence[FramePair], darks: Sequence[FramePair], top: int) -> None:
    problems: list[str] = []
    if not darks:
        problems.append("no dark frames: cover the lens, switch the lights off, and capture a pair at the same gain")
    if len(pairs) < LEAST_LEVELS:
        problems.append(f"{len(pairs)} levels, {LEAST_LEVELS} are needed: capture pairs at more exposure times")
    shape, least = (pairs or darks or [None])[0], BLOCKS * LEAST_BLOCK_SIDE
    shape = (0, 0) if shape is None else shape.first.shape
    for name, pair in [*((f"pair at exposure {p.exposure:g}", p) for p in pairs), *(("dark pair", p) for p in darks)]:
        both = np.stack([pair.first, pair.second]) if pair.first.shape == pair.second.shape else np.zeros((2, 0, 0))
        if both.shape[1:] != shape or len(shape) != 2 or min(shape) < least:
            problems.append(
                f"{name}: shapes {pair.first.shape} and {pair.second.shape}: expected (H, W), the same for all frames, "
                f"of at least {least} pixels each"
            )
        elif not np.issubdtype(both.dtype, np.integer) or both.min() < 0 or both.max() > top:
            problems.append(
                f"{name}: expected whole levels from 0 to {top}, found {both.dtype} from {both.min()} to "
                f"{both.max()}: give the frames as the camera delivers them"
            )
        elif name == "dark pair" and np.mean(both == 0) > 0.5 and np.mean(both > 1) < LEAST_ABOVE_ONE:
            problems.append(f"{name}: nearly all pixels are at 0, which hides noise: raise the camera's black level")
    refuse(f"photon transfer: {problem}" for problem in problems)


def _check_pairs(pairs: Sequence[FramePair], lit: Float64, black: float) -> None:
    problems: list[str] = []
    for pair, sums, mean, variance in zip(pairs, lit, *_moments(lit), strict=True):
        signal = max(float(mean) - black, 0.0)
        difference, level = sums[:, 2] / sums[:, 0], sums[:, 1] / sums[:, 0] - black
        shift = abs(float(np.mean(difference)))
        # a common change of the light leaves a difference in proportion to the level
        pattern = difference - level * float(np.sum(difference * level) / max(float(np.sum(level * level)), 1e-9))
        noise = math.sqrt(2.0 * max(float(variance), ROUNDING_VARIANCE) / float(sums[0, 0]))
        problem = ""
        if shift > PAIR_DIFFERENCE * signal + 5.0 * noise:
            problem = f"the frames differ by {shift:.3g} levels of {signal:.3g}: exposure or light changed between them"
        elif float(np.sqrt(np.mean(np.square(pattern)))) > PATTERN_SPREADS * noise + PATTERN_SHARE * signal:
            problem = "the difference of the frames has a pattern: something moved, or other light came in"
        if problem:
            problems.append(f"photon transfer: pair at exposure {pair.exposure:g}: {problem}")
    refuse(problems)
