"""From deviations under several lights to one score per pixel, with a law for false alarms."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import special

from lightopt.inspection._deviation import Deviations
from lightopt.inspection._filter import BLOCK_ROWS, filtered, gaussian_taps, row_blocks
from lightopt.kernels import kernel
from lightopt.rendering import in_threads

__all__ = [
    "SCALES_PX",
    "disc_gain",
    "noise_gain",
    "rank_probability",
    "score_deviations",
    "smoothed_deviations",
    "threshold",
]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

SCALES_PX = (1.0, 2.0, 3.5)
"""Widths of the Gaussians that deviations are added up with: small and large defects have one that suits them."""

LEAST_SHARE = 0.5
"""A sum counts where at least this share of the variance that it would have is of usable pixels."""

TABLED_Z = 25.0
"""Probabilities beyond this are too small for a number. Scores go on from there by the normal law's leading term, since
how strong a defect is decides how far its sums spread beyond it."""

TABLE_STEPS = 256
"""Scores are tabulated in steps of 1/256 of a standard deviation."""


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


def smoothed_deviations(
    found: Deviations, scale: float, *, threads: int | None = None
) -> tuple[Float32, Bool]:
    """Sums over Gaussians of deviations, in standard deviations of such a sum, and where they count; (lights, H, W).

    Parameters
    ----------
    found
        Of a posture.
    scale
        Width of the Gaussian [px].
    threads
        Number of threads; the result does not depend on it.
    """
    sums, counts = np.zeros_like(found.z), np.zeros(found.z.shape, np.bool_)
    for i, (z, usable) in enumerate(zip(found.z, found.usable, strict=True)):
        sums[i], counts[i] = _sums(z, usable, gaussian_taps(scale), threads)
    return sums, counts


def _sums(z: Float32, usable: Bool, taps: Float32, threads: int | None) -> tuple[Float32, Bool]:
    # the square of a Gaussian is narrower
    cut = int((len(taps) // 2) * (1.0 - math.sqrt(0.5)))
    squares = np.square(taps[cut : len(taps) - cut])
    sums = filtered(z, taps, threads=threads)
    variance = filtered(usable.astype(np.float32), squares, threads=threads)
    least = np.float32(LEAST_SHARE * float(squares.sum()) ** 2)
    counts = np.empty(usable.shape, np.bool_)

    def block(top: int) -> None:
        rows = slice(top, top + BLOCK_ROWS)
        counts[rows] = usable[rows] & (variance[rows] >= least)
        sums[rows] *= counts[rows] / np.sqrt(np.maximum(variance[rows], np.float32(1e-12)))

    in_threads(block, row_blocks(len(z)), threads)
    return sums, counts


def rank_probability(z: Float64, count: NDArray[np.intp], rank: int) -> Float64:
    """Probability that noise alone makes the `rank`-th largest of `count` magnitudes as large as this.

    With t = 2·Φ(−z), at least `rank` of `count` independent deviates are beyond z with the probability
    I_t(rank, count − rank + 1), the regularised incomplete beta function. Fewer than `rank` are judged
    by all there are.

    Parameters
    ----------
    z
        The `rank`-th largest magnitude, or the least of fewer.
    count
        Of how many, same shape.
    rank
        1 for the largest.
    """
    tail = 2.0 * special.ndtr(-np.minimum(z, TABLED_Z))
    k = np.minimum(rank, np.maximum(count, 1))
    return special.betainc(k, np.maximum(count, 1) - k + 1, tail)


def score_deviations(found: Deviations, *, seen_by: int, threads: int | None = None) -> Float32:
    """−log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W); 0 where nothing tells.

    Parameters
    ----------
    found
        Of a posture.
    seen_by
        A defect is what shows in so many images: its score is that of the `seen_by`-th largest deviation.
    threads
        Number of threads; the result does not depend on it.
    """
    whole = np.zeros(found.z.shape[1:], np.float32)
    sides = [np.flatnonzero(found.usable.any(axis=axes)) for axes in ((0, 2), (0, 1))]
    if not all(map(len, sides)):
        return whole
    window = tuple(slice(int(side[0]), int(side[-1]) + 1) for side in sides)
    box = (slice(None), *window)
    inner = Deviations(found.z[box], found.scale[box], found.usable[box])
    score = np.zeros(inner.z.shape[1:], np.float32)
    table = _table(len(found.z), seen_by)
    for width in SCALES_PX:
        sums, counts = smoothed_deviations(inner, width, threads=threads)

        def block(top: int, sums: Float32 = sums, counts: Bool = counts) -> None:
            _raise(sums, counts, table, seen_by, top, min(top + BLOCK_ROWS, len(score)), score)

        in_threads(block, row_blocks(len(score)), threads)
    whole[window] = score
    return whole


def _table(images: int, rank: int) -> Float32:
    # scores by the number of images that count and the deviation in steps of 1/TABLE_STEPS; in between they are read
    # off straight lines, which is off by 1e-5 at most
    z = np.arange(int(TABLED_Z * TABLE_STEPS) + 1) / TABLE_STEPS
    rows = [-np.log10(rank_probability(z, np.full(len(z), count), rank)) for count in range(1, images + 1)]
    return np.stack([np.zeros(len(z)), *rows]).astype(np.float32)


@kernel
def _raise(
    sums: Float32, counts: Bool, table: Float32, rank: int, top: int, bottom: int, score: Float32
) -> None:
    images, _, width = sums.shape
    size = np.empty(images, np.float32)
    for y in range(top, bottom):
        for x in range(width):
            count = 0
            for i in range(images):
                if counts[i, y, x]:
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
            k = min(rank, count)
            z = size[k - 1]
            if z >= np.float32(TABLED_Z):
                further = 0.5 * (z * z - TABLED_Z * TABLED_Z) + math.log(z / TABLED_Z)
                value = table[count, -1] + np.float32(k * further / _LN_10)
            else:
                place = z * np.float32(TABLE_STEPS)
                left = int(place)
                share = place - np.float32(left)
                value = table[count, left] + share * (table[count, left + 1] - table[count, left])
            score[y, x] = max(score[y, x], value)


def threshold(false_alarms: float, pixels: int, tests: int) -> float:
    """Score that noise alone exceeds anywhere in an image with at most this probability (Bonferroni's bound).

    Parameters
    ----------
    false_alarms
        Expected false alarms per posture.
    pixels
        That are judged.
    tests
        Scores that each pixel's is the greatest of.
    """
    return -math.log10(false_alarms / max(1, pixels * tests))
