"""From deviations under several lights to one score per pixel, with a law for false alarms."""

import itertools
import math

import numpy as np
from scipy import special

from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.defects import SCALES_PX
from lightopt.inspection._image_blocks import (
    TILE_COLUMNS,
    filter_tile,
    gaussian_taps,
    in_image_blocks,
    in_row_blocks,
    mask_window,
)
from lightopt.inspection.detection._deviation import Deviations

LEAST_SHARE = 0.5  # a sum counts where at least this share of the variance that it would have is of usable pixels

# Sums over wide Gaussians are for faint wide defects. What is further off by itself counts as this much in them: the
# sum over the narrowest has it, and it would spread far beyond its outline.
STRONGEST_Z = 6.0

# Probabilities beyond this are too small for a number. Scores go on from there by the normal law's leading term, since
# how strong a defect is decides how far its sums spread beyond it.
TABLED_Z = 25.0

TABLE_STEPS = 256  # scores are tabulated in steps of 1/256 of a standard deviation
COARSE_STEPS = 1001  # where images are correlated, scores are worked out at so many deviations

# and as a mean over so many values of what they have in common, up to so many standard deviations
COMMON_STEPS, FARTHEST_COMMON = 801, 27.0

_LN_10 = math.log(10.0)


def noise_gain(scale: float) -> float:
    """By how much the sum over a Gaussian of a width [px] of an even deviation stands out more than one pixel of it."""
    return math.sqrt(4.0 * math.pi) * scale


def disc_gain(diameter: float) -> float:
    """By how much an even deviation of a disc [px] stands out more in the sum that suits it than in one pixel of it.

    Of a Gaussian of width s the disc fills the share 1 − exp(−r²/(2s²)).
    """
    radius = 0.5 * diameter
    return max(noise_gain(scale) * -math.expm1(-(radius**2) / (2.0 * scale**2)) for scale in SCALES_PX)


def smoothed_deviations(found: Deviations, scale: float, *, threads: int | None = None) -> tuple[Float32, Bool]:
    """Sums over a Gaussian of deviations, in standard deviations of such a sum, and where they count."""
    sums, counts = np.empty_like(found.z), np.empty(found.z.shape, np.bool_)
    lights, height, _ = found.z.shape
    weights = _weights(scale)

    def smooth(i: int, rows: slice) -> None:
        _smooth(found.z[i], found.usable[i], *weights, np.inf, rows.start, sums[i, rows], counts[i, rows])

    in_image_blocks(smooth, lights, height, threads)
    return sums, counts


def _weights(scale: float) -> tuple[Float32, Float32]:
    # of the sums over a Gaussian, and of their variance: the square of a Gaussian is narrower
    taps = gaussian_taps(scale)
    cut = int((len(taps) // 2) * (1.0 - math.sqrt(0.5)))
    return taps, np.square(taps[cut : len(taps) - cut])


@kernel
def _smooth(
    z: Float32, usable: Bool, taps: Float32, squares: Float32, most: float, top: int, sums: Float32, counts: Bool
) -> None:
    # rows of the sums from `top` on, each in its own standard deviation, and where they count; deviations of more than
    # `most` count as that
    height, width = z.shape
    reach = len(squares) // 2
    whole = squares.sum() ** 2
    least = np.float32(LEAST_SHARE) * whole
    rows = len(sums)
    variance = np.empty((rows, TILE_COLUMNS), np.float32)
    for left in range(0, width, TILE_COLUMNS):
        right = min(left + TILE_COLUMNS, width)
        if not usable[top : top + rows, left:right].any():
            sums[:, left:right] = np.float32(0.0)
            counts[:, left:right] = False
            continue
        filter_tile(z, taps, top, left, most, sums[:, left:right])
        # where all around is usable the variance is known
        inside = top >= reach and left >= reach and top + rows + reach <= height and right + reach <= width
        if inside and usable[top - reach : top + rows + reach, left - reach : right + reach].all():
            variance[:] = whole
        else:
            filter_tile(usable, squares, top, left, 1.0, variance[:, : right - left])
        for y in range(rows):
            for x in range(left, right):
                own = variance[y, x - left]
                counts[y, x] = usable[top + y, x] and own >= least
                sums[y, x] = sums[y, x] / math.sqrt(own) if counts[y, x] else np.float32(0.0)


def rank_probability(z: Float64, count: Index, rank: int) -> Float64:
    """Probability that noise alone makes the `rank`-th largest of `count` magnitudes as large as this.

    With t = 2·Φ(−z), at least `rank` of `count` independent deviates are beyond z with the probability
    I_t(rank, count − rank + 1), the regularised incomplete beta function. Fewer than `rank` are judged
    by all there are.

    z: the `rank`-th largest magnitude, or the least of fewer.
    """
    n = np.maximum(count, 1)
    k = np.minimum(rank, n)
    return special.betainc(k, n - k + 1, 2.0 * special.ndtr(-np.minimum(z, TABLED_Z)))


def score_deviations(found: Deviations, *, min_images: int, threads: int | None = None) -> Float32:
    """−log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W); 0 where no image is usable.

    min_images: A defect is what shows in so many images: its score is that of the `min_images`-th largest deviation.
        Where fewer are lit it has to show in these alone, or in one where none is, and may show in a dark one as well.
    """
    whole = np.zeros(found.z.shape[1:], np.float32)
    window = mask_window(np.asarray(found.usable.any(axis=0), np.bool_))
    if not window[0].stop:
        return whole
    inner = found.in_box(*window)
    lights, height, _ = inner.z.shape
    score = np.zeros(inner.z.shape[1:], np.float32)
    table = _table(lights, min_images, found.correlation)
    scales = [(*_weights(width), np.inf if width == min(SCALES_PX) else STRONGEST_Z) for width in SCALES_PX]

    def score_rows(rows: slice) -> None:
        sums = np.empty((lights, *score[rows].shape), np.float32)
        counts = np.empty(sums.shape, np.bool_)
        for weights in scales:
            for i in range(lights):
                _smooth(inner.z[i], inner.usable[i], *weights, rows.start, sums[i], counts[i])
            _raise_scores(sums, counts, inner.lit[:, rows], table, score[rows])

    in_row_blocks(score_rows, height, threads)
    whole[window] = score
    return whole


def _table(images: int, rank: int, correlation: float) -> Float32:
    # scores by rank − 1, the number of images that count and the deviation in steps of 1/TABLE_STEPS; in between they
    # are read off straight lines, which is off by 1e-5 at most
    z = np.arange(int(TABLED_Z * TABLE_STEPS) + 1) / TABLE_STEPS
    table = np.zeros((rank, images + 1, len(z)), np.float32)
    for k, count in itertools.product(range(1, rank + 1), range(1, images + 1)):
        table[k - 1, count] = rank_scores(z, count, min(k, count), correlation)
    return table


def rank_scores(z: Float64, count: int, k: int, correlation: float = 0.0) -> Float64:
    """−log₁₀ of :func:`rank_probability`, in double precision however small that is.

    correlation: Between the images: they have a common part of that variance, and are independent but for it.
    """
    if correlation > 0.0 and k > 1:
        coarse = np.linspace(0.0, TABLED_Z, COARSE_STEPS)
        return np.interp(z, coarse, _correlated_scores(coarse, count, k, correlation))
    # a number is too small where several images show a strong defect: there its leading term, C(count, k)·tᵏ, is it to
    # 1e-8
    ln_tail = special.log_ndtr(-z) + math.log(2.0)
    leading = special.gammaln(count + 1) - special.gammaln(k + 1) - special.gammaln(count - k + 1) + k * ln_tail
    far = ln_tail < math.log(1e-9)
    near = rank_probability(np.where(far, 0.0, z), np.full(len(z), count), k)
    return -np.where(far, leading, np.log(near)) / _LN_10


def deviation_of_score(score: float, count: int, k: int, correlation: float = 0.0) -> float:
    """The `k`-th largest of `count` magnitudes that has a score, as far as one deviation is far from likely."""
    if correlation > 0.0 and k > 1:
        z = np.linspace(0.0, TABLED_Z, COARSE_STEPS)
        return float(np.interp(score, _correlated_scores(z, count, k, correlation), z, right=np.inf))
    each = (10.0**-score / float(special.binom(count, k))) ** (1.0 / k)
    return -float(special.ndtri(0.5 * each))


def _correlated_scores(z: Float64, count: int, k: int, correlation: float) -> Float64:
    # mean of the probability over the common part
    common = np.linspace(-FARTHEST_COMMON, FARTHEST_COMMON, COMMON_STEPS)
    weight = np.exp(-0.5 * common**2) / math.sqrt(2.0 * math.pi) * (common[1] - common[0])
    shared, own = math.sqrt(correlation) * common, math.sqrt(1.0 - correlation)
    tail = special.ndtr((shared - z[:, None]) / own) + special.ndtr((-shared - z[:, None]) / own)
    chance = special.betainc(k, count - k + 1, np.minimum(tail, 1.0)) @ weight
    return np.maximum(-np.log10(np.maximum(chance, 1e-300)), 0.0)


@kernel
def _raise_scores(sums: Float32, counts: Bool, lit: Bool, table: Float32, score: Float32) -> None:
    images, height, width = sums.shape
    size = np.empty(images, np.float32)
    for y in range(height):
        for x in range(width):
            count = lights = 0
            for i in range(images):
                if counts[i, y, x]:
                    lights += lit[i, y, x]
                    # in order, the largest first
                    own = abs(sums[i, y, x])
                    k = count
                    while k > 0 and size[k - 1] < own:
                        size[k] = size[k - 1]
                        k -= 1
                    size[k] = own
                    count += 1
            if count == 0:
                continue
            k = min(len(table), max(lights, 1))
            z = size[k - 1]
            if z >= np.float32(TABLED_Z):
                further = 0.5 * (z * z - TABLED_Z * TABLED_Z) + math.log(z / TABLED_Z)
                value = table[k - 1, count, -1] + np.float32(k * further / _LN_10)
            else:
                place = z * np.float32(TABLE_STEPS)
                left = int(place)
                share = place - np.float32(left)
                lower, upper = table[k - 1, count, left], table[k - 1, count, left + 1]
                value = lower + share * (upper - lower)
            score[y, x] = max(score[y, x], value)


def threshold(false_alarms: float, pixels: int, tests: int) -> float:
    """Score that noise alone exceeds anywhere in an image with at most this probability (Bonferroni's bound).

    tests: Scores that each pixel's is the greatest of.
    """
    return -math.log10(false_alarms / max(1, pixels * tests))
