"""From deviations under several lights to one score per pixel, with a law for false alarms."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special

from lightopt.inspection._deviation import Deviations

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
"""A sum counts where at least this share of its pixels is usable."""

GREATEST_Z = 25.0
"""Deviations beyond this are as certain as numbers can tell."""


def noise_gain(scale: float) -> float:
    """By how much the sum over a Gaussian of a width [px] of an even deviation stands out more than one pixel of it."""
    return math.sqrt(4.0 * math.pi) * scale


def disc_gain(diameter: float) -> float:
    """By how much an even deviation of a disc [px] stands out more in the sum that suits it than in one pixel of it.

    Of a Gaussian of width s the disc fills the share 1 − exp(−r²/(2s²)).
    """
    radius = 0.5 * diameter
    return max(noise_gain(scale) * -math.expm1(-(radius**2) / (2.0 * scale**2)) for scale in SCALES_PX)


def smoothed_deviations(found: Deviations, scale: float) -> tuple[Float32, Bool]:
    """Sums over Gaussians of deviations, in standard deviations of such a sum, and where they count; (lights, H, W).

    Parameters
    ----------
    found
        Of a posture.
    scale
        Width of the Gaussian [px].
    """
    kernel = _gaussian(scale)
    sums = np.zeros_like(found.z)
    counts = np.zeros(found.z.shape, np.bool_)
    for i, (z, usable) in enumerate(zip(found.z, found.usable, strict=True)):
        weight = usable.astype(np.float32)
        variance = _filtered(weight, kernel * kernel)
        counts[i] = usable & (_filtered(weight, kernel) >= LEAST_SHARE)
        total = _filtered(z, kernel)
        sums[i] = np.where(counts[i], total / np.sqrt(np.maximum(variance, 1e-12)), 0.0)
    return sums, counts


def _gaussian(scale: float) -> Float64:
    reach = math.ceil(4.0 * scale)
    kernel = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / scale))
    return kernel / kernel.sum()


def _filtered(image: Float32, kernel: Float64) -> Float32:
    # nothing lies beyond the image: a pixel that was mirrored there would count twice
    down = ndimage.correlate1d(image, kernel, axis=0, mode="constant")
    return np.asarray(ndimage.correlate1d(down, kernel, axis=1, mode="constant"), np.float32)


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
    tail = 2.0 * special.ndtr(-np.minimum(z, GREATEST_Z))
    k = np.minimum(rank, np.maximum(count, 1))
    return special.betainc(k, np.maximum(count, 1) - k + 1, tail)


def score_deviations(found: Deviations, *, seen_by: int) -> Float32:
    """−log₁₀ of the probability that noise alone looks as much like a defect, shape (H, W); 0 where nothing tells.

    Parameters
    ----------
    found
        Of a posture.
    seen_by
        A defect is what shows in so many images: its score is that of the `seen_by`-th largest deviation.
    """
    score = np.zeros(found.z.shape[1:], np.float32)
    for scale in SCALES_PX:
        sums, counts = smoothed_deviations(found, scale)
        count = counts.sum(axis=0)
        size = np.sort(np.where(counts, np.abs(sums), np.float32(-1.0)), axis=0)[::-1]
        rank = np.clip(np.minimum(seen_by, count) - 1, 0, len(size) - 1)
        kth = np.take_along_axis(size, rank[None], axis=0)[0].astype(np.float64)
        chance = rank_probability(np.maximum(kth, 0.0), count, seen_by)
        np.maximum(score, np.where(count > 0, -np.log10(chance), 0.0), out=score, casting="unsafe")
    return score


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
