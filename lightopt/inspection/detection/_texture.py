"""Texture as noise: its correlation is filtered out, its spread is measured, and so is the law of the scores on it.

Grain and brush marks are neither independent from pixel to pixel nor from image to image. So sums over pixels scatter
more than their noise says, and more lights show the same chance deviation.
"""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft, ndimage, signal

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.threads import in_threads
from lightopt.inspection._image_blocks import gaussian_taps, in_image_blocks
from lightopt.inspection.detection._deviation import BLOCK_PX, CLIPPED, MEAN_OF_NORMAL, Deviations, normalise_rows
from lightopt.inspection.detection._regions import SPREAD_PX, find_regions
from lightopt.inspection.detection._residual_score import SCALES_PX, noise_gain, smoothed_deviations

# the spectrum is the median over tiles of one of these sides, the first of which the surface has so many
TILES_PX, LEAST_TILES = (64, 32, 16), 24
USABLE_TILE = 0.8  # share of a tile's pixels that must be usable

# Next to an edge texture is predicted from one side only, and a bright line beside it looks like a defect
EDGE_PX = 4

# The spread of sums is that of their surroundings, Gaussian of this width: it holds some 200 independent sums over the
# widest Gaussian, of which fewer would make the scores heavy-tailed.
LOCAL_PX = 48.0

# Shares of the surface between whose scores the law is fitted. Below the second there may be defects.
UPPER_SHARE, LOWER_SHARE = 0.2, 0.02
ROUNDS = 5

CLEAR, MOST_CORRELATION = 3.0, 0.95


def whiten_texture(found: Deviations, *, threads: int | None = None) -> Deviations:
    """Deviations from which the texture that their surroundings predict is filtered, in units of what is left.

    Each image is filtered to an even spectrum, and divided by the local spread of its sums over Gaussians, the largest
    of all widths. Neither raises a deviation above its number of standard deviations of the sensor's noise.
    """
    z, scale, inside = np.empty_like(found.z), found.scale.copy(), np.empty_like(found.usable)
    bounds: list[list[float]] = []
    for i, (own, usable) in enumerate(zip(found.z, found.usable, strict=True)):
        whitening = _whitening(own, usable)
        z[i] = _filtered(own, usable, whitening)
        inside[i] = ndimage.binary_erosion(usable, iterations=EDGE_PX)
        bounds.append([_white_spread(whitening, width) for width in SCALES_PX])
    z[~inside] = 0.0
    whitened = Deviations(z, scale, inside, found.lit & inside)
    typical = _largest_spread(whitened, bounds, threads)

    def normalise(i: int, rows: slice) -> None:
        normalise_rows(typical[i], rows.start, rows.stop, z[i], scale[i])

    in_image_blocks(normalise, len(z), z.shape[1], threads)
    return replace(whitened, correlation=_correlation(whitened))


def _clip(z: Float32, usable: Bool) -> Float32:
    # what is far beyond the texture is a defect, and says nothing of it
    spread = float(np.median(np.abs(z[usable]))) / 0.6745 if usable.any() else 0.0
    bound = np.float32(CLIPPED * max(spread, 1.0))
    return np.where(usable, np.clip(z, -bound, bound), np.float32(0.0))


def _whitening(z: Float32, usable: Bool) -> Float64:
    # gain by frequency that makes the spectrum even, as of `rfft2` of a square tile
    clipped = _clip(z, usable)
    for side in TILES_PX:
        if side > min(z.shape):
            continue
        window = np.outer(signal.windows.hann(side, sym=False), signal.windows.hann(side, sym=False))
        step = side // 2
        tiles, inside = (sliding_window_view(a, (side, side))[::step, ::step] for a in (clipped, usable))
        chosen = np.argwhere(inside.mean(axis=(2, 3)) >= USABLE_TILE)
        if len(chosen) < LEAST_TILES:
            continue
        spectra = np.stack([np.abs(np.asarray(fft.rfft2(tiles[y, x] * window))) ** 2 for y, x in chosen])
        spectrum = np.median(spectra, axis=0) / (math.log(2.0) * np.sum(window**2))
        return 1.0 / np.sqrt(np.maximum(spectrum, 1.0))
    return np.ones((1, 1))


def _filtered(z: Float32, usable: Bool, whitening: Float64) -> Float32:
    # what the clipped surroundings predict is taken off, so that a strong defect leaves no echo beside it
    side = len(whitening)
    if side == 1:
        return z.copy()
    kernel = np.fft.fftshift(np.asarray(fft.irfft2(1.0 - whitening, (side, side))))[1:, 1:].astype(np.float32)
    predicted = signal.oaconvolve(_mirrored(_clip(z, usable), usable), kernel, mode="same")
    return np.where(usable, z - predicted.astype(np.float32), np.float32(0.0))


def _mirrored(z: Float32, usable: Bool) -> Float32:
    # the texture goes on beyond the border of what is usable as before it, so that the border is no edge
    if not usable.any():
        return z
    nearest = ndimage.distance_transform_edt(~usable, return_distances=False, return_indices=True)
    assert nearest is not None
    mirror = [np.clip(2 * a - b, 0, n - 1) for a, b, n in zip(nearest, np.indices(z.shape), z.shape, strict=True)]
    return np.where(usable[tuple(mirror)], z[tuple(mirror)], z[tuple(nearest)])


def _white_spread(whitening: Float64, width: float) -> float:
    # standard deviation of sums over a Gaussian of white noise after the filter, in that before it
    side = len(whitening)
    if side == 1:
        return 1.0
    taps = np.zeros(side)
    own = gaussian_taps(width)[:side]
    taps[: len(own)] = own
    gain = np.abs(np.fft.fft(taps)) ** 2
    weight = gain[:, None] * gain[None, : whitening.shape[1]]
    weight[:, 1 : (side + 1) // 2] *= 2.0  # the other half of the frequencies
    return float(np.sqrt(np.sum(weight * whitening**2) / np.sum(weight)))


def _largest_spread(found: Deviations, bounds: list[list[float]], threads: int | None) -> Float32:
    # of the sums over all Gaussians around each block of pixels, shape (lights, rows, columns) of the blocks
    lights, height, width = found.z.shape
    rows, columns = -(-height // BLOCK_PX), -(-width // BLOCK_PX)
    result = np.zeros((lights, rows, columns), np.float32)

    def block_sums(values: Float32) -> Float64:
        padded = np.zeros((rows * BLOCK_PX, columns * BLOCK_PX))
        padded[:height, :width] = values
        return padded.reshape(rows, BLOCK_PX, columns, BLOCK_PX).sum(axis=(1, 3))

    for k, scale in enumerate(SCALES_PX):
        sums, counts = smoothed_deviations(found, scale, threads=threads)

        def measure(i: int, sums: Float32 = sums, counts: Bool = counts, k: int = k) -> None:
            size = np.abs(_clip_sums(sums[i], counts[i]))
            total, share = (
                ndimage.gaussian_filter(block_sums(a), LOCAL_PX / BLOCK_PX) for a in (size, counts[i].astype(np.float32))
            )
            spread = total / np.maximum(share, 1e-6 * BLOCK_PX**2) / MEAN_OF_NORMAL
            np.maximum(result[i], np.maximum(spread, bounds[i][k]), out=result[i], casting="same_kind")

        in_threads(measure, range(lights), threads)
    return result


def _correlation(found: Deviations) -> float:
    # the greatest between any two images, of sums over the middle Gaussian; 0 where chance makes as much
    scale = SCALES_PX[1]
    sums, counts = smoothed_deviations(found, scale)
    clipped = [_clip_sums(own, known) for own, known in zip(sums, counts, strict=True)]
    greatest = 0.0
    for i, k in combinations(range(len(sums)), 2):
        both = counts[i] & counts[k]
        independent = np.count_nonzero(both) / noise_gain(scale) ** 2
        if independent < 1.0:
            continue
        a, b = clipped[i][both].astype(np.float64), clipped[k][both].astype(np.float64)
        own = abs(float(np.mean(a * b))) / max(float(a.std() * b.std()), 1e-12)
        if own > CLEAR / math.sqrt(independent):
            greatest = max(greatest, own)
    return min(greatest, MOST_CORRELATION)


def _clip_sums(sums: Float32, counts: Bool) -> Float32:
    spread = float(np.median(np.abs(sums[counts]))) / 0.6745 if counts.any() else 0.0
    bound = np.float32(CLIPPED * spread)
    return np.where(counts, np.clip(sums, -bound, bound), np.float32(0.0))


def texture_threshold(score: Float32, usable: Bool, least: float, false_alarms: float) -> float:
    """Score that texture exceeds anywhere in a posture with at most about this probability, and no less than `least`.

    The share of the surface that exceeds a score falls exponentially with the score, whatever the spread of normal
    deviates and the correlation of the images; the rate is fitted to the scores of the surface itself, without regions
    that a threshold from the whole surface finds.
    """
    counted, high = usable, least
    for _ in range(ROUNDS):
        own = score[counted].astype(np.float64)
        if not len(own):
            break
        low, up = np.quantile(own, [1.0 - UPPER_SHARE, 1.0 - LOWER_SHARE])
        decades = math.log10(UPPER_SHARE * len(own) / false_alarms)
        high = max(least, float(low + (up - low) / math.log10(UPPER_SHARE / LOWER_SHARE) * decades))
        labels, count = find_regions(score, high)
        around = usable & ~ndimage.binary_dilation(labels > 0, iterations=SPREAD_PX)
        if not count or np.array_equal(around, counted):
            break
        counted = around
    return high
