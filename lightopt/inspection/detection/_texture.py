"""Deviations from the reference of an inspection, and texture as noise.

The correlation of texture is filtered out, its spread is measured, and so is the law of the scores on it.

Grain and brush marks are neither independent from pixel to pixel nor from image to image. So sums over pixels scatter
more than their noise says, and more lights show the same chance deviation.
"""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import fft, ndimage

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.threads import in_threads
from lightopt.defects import DARK, SCALES_PX
from lightopt.inspection._image_blocks import block_sums, convolve, gaussian_taps, in_image_blocks
from lightopt.inspection.detection._deviation import (
    BLOCK_PX,
    CLIPPED,
    MEAN_OF_NORMAL,
    Deviations,
    deviations,
    normalise_rows,
)
from lightopt.inspection.detection._regions import SPREAD_PX, find_regions
from lightopt.inspection.detection._residual_score import noise_gain, smoothed_deviations
from lightopt.inspection.prediction._neighbourhood import neighbourhood_view
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._predict import ReferenceName

# the spectrum is the median over tiles of the first of these sides of which the surface has so many
TILES_PX, LEAST_TILES, MOST_TILES = (64, 32, 16), 24, 1000
USABLE_TILE = 0.8  # share of a tile's pixels that must be usable

# next to an edge texture is predicted from one side only, and a bright line along the edge looks like a defect
EDGE_PX = 4

# The spread of sums is that of their surroundings, Gaussian of this width. It holds some 200 independent sums over the
# widest Gaussian; fewer would make the scores heavy-tailed.
LOCAL_PX = 48.0

# deviations from a model that is not exact are clipped here: good parts teach them to half a standard deviation at most
GREATEST_LEARNED_Z = 1000.0

CLEAR = 3.0  # correlations of fewer standard errors than this are chance
MOST_CORRELATION = 0.95

# shares of the surface between whose scores their law is fitted: first where even large defects have little weight
MIDDLE_SHARES, UPPER_SHARES = (0.5, 0.1), (0.2, 0.02)
MOST_DEFECTIVE = 0.25  # regions and their surroundings that cover more than this share are texture


def compare(
    view: PostureView, reference: ReferenceName, neighbourhood_px: float, *, threads: int | None = None
) -> tuple[PostureView, Deviations]:
    """A view with the levels of the reference, and the deviations from them.

    Those from good parts are the model's still: a calibration has what good parts have in common beyond it.

    neighbourhood_px: Width of the neighbourhood of a place.
    """
    if reference == "model":
        return view, deviations(view, threads=threads)
    if reference == "good-parts":
        found = deviations(view, local=False, threads=threads)
        np.clip(found.z, -GREATEST_LEARNED_Z, GREATEST_LEARNED_Z, out=found.z)
        return view, found
    view, known = neighbourhood_view(view, neighbourhood_px, threads=threads)
    found = deviations(view, local=False, threads=threads)
    found.z[~known] = 0.0
    found = Deviations(found.z, found.scale, found.usable & known, found.lit & known)
    return view, whiten_texture(found, threads=threads)


def evaluable(found: Deviations, view: PostureView) -> Deviations:
    """Deviations that count where the levels of a view, and not the model's, are dark or saturated."""
    full = view.saturated & (view.predicted + view.deviation >= view.limit)
    usable = found.usable & ~full
    return replace(found, usable=usable, lit=usable & (view.predicted >= np.float32(DARK) * view.deviation))


def whiten_texture(found: Deviations, *, threads: int | None = None) -> Deviations:
    """Deviations without the texture that their surroundings predict, in units of what is left of it.

    Each image is filtered to an even spectrum, and divided by the local spread of its sums over Gaussians, that of the
    width where it is largest. Sensor noise alone stays as it is, and the smallest spread is that of sensor noise.
    """
    z, scale = np.empty_like(found.z), found.scale.copy()
    inside = np.empty_like(found.usable)
    bounds = np.empty((len(z), len(SCALES_PX)))

    def whiten(i: int) -> None:
        whitening = _whitening(found.z[i], found.usable[i])
        inside[i] = ndimage.binary_erosion(found.usable[i], iterations=EDGE_PX)
        z[i] = np.where(inside[i], _filtered(found.z[i], found.usable[i], whitening), np.float32(0.0))
        bounds[i] = [_white_spread(whitening, width) for width in SCALES_PX]

    in_threads(whiten, range(len(z)), threads)
    whitened = Deviations(z, scale, inside, found.lit & inside)
    typical = _largest_spread(whitened, bounds, threads)

    def normalise(i: int, rows: slice) -> None:
        normalise_rows(typical[i], rows.start, rows.stop, z[i], scale[i])

    in_image_blocks(normalise, len(z), z.shape[1], threads)
    return replace(whitened, correlation=_correlation(whitened, threads))


def _clipped(values: Float32, known: Bool) -> Float32:
    # without what is far off, which is no texture; 0 where not known
    if not known.any():
        return np.zeros_like(values)
    bound = np.float32(CLIPPED * float(np.median(np.abs(values[known]))) / 0.6745)
    return np.where(known, np.clip(values, -bound, bound), np.float32(0.0))


def _whitening(z: Float32, usable: Bool) -> Float64:
    # gain by frequency that makes the spectrum even, as of `rfft2` of a square tile; of one pixel where there are too
    # few tiles. White noise of variance 1 is left alone
    clipped = _clipped(z, usable)
    for side in TILES_PX:
        if side > min(z.shape):
            continue
        step = side // 2
        tiles, inside = (sliding_window_view(a, (side, side))[::step, ::step] for a in (clipped, usable))
        chosen = np.argwhere(inside.mean(axis=(2, 3)) >= USABLE_TILE)
        if len(chosen) < LEAST_TILES:
            continue
        hann = 0.5 - 0.5 * np.cos(2.0 * math.pi * np.arange(side) / side)
        window = np.outer(hann, hann)
        chosen = chosen[:: -(-len(chosen) // MOST_TILES)]
        spectra = np.stack([np.abs(np.asarray(fft.rfft2(tiles[y, x] * window))) ** 2 for y, x in chosen])
        # the square of a normal deviate's amplitude is exponential: its median is ln 2 times its mean
        spectrum = np.median(spectra, axis=0) / (math.log(2.0) * np.sum(window**2))
        return 1.0 / np.sqrt(np.maximum(spectrum, 1.0))
    return np.ones((1, 1))


def _filtered(z: Float32, usable: Bool, whitening: Float64) -> Float32:
    # what the clipped surroundings predict is taken off, so that a strong defect leaves no echo beside it
    side = len(whitening)
    if side == 1 or not usable.any():
        return z
    # beyond its border the texture goes on as before it, mirrored, so that the border is no edge
    nearest = ndimage.distance_transform_edt(~usable, return_distances=False, return_indices=True)
    assert nearest is not None
    mirror = [np.clip(2 * a - b, 0, n - 1) for a, b, n in zip(nearest, np.indices(z.shape), z.shape, strict=True)]
    clipped = _clipped(z, usable)
    texture = np.where(usable[tuple(mirror)], clipped[tuple(mirror)], clipped[tuple(nearest)])
    weights = np.fft.fftshift(np.asarray(fft.irfft2(1.0 - whitening, (side, side))))[1:, 1:]
    return z - convolve(texture.astype(np.float64), weights).astype(np.float32)


def _white_spread(whitening: Float64, width: float) -> float:
    # standard deviation of sums over a Gaussian of filtered white noise, in that of white noise
    side = len(whitening)
    if side == 1:
        return 1.0
    taps = np.zeros(side)
    own = gaussian_taps(width)[:side]
    taps[: len(own)] = own
    gain = np.square(np.abs(np.fft.fft(taps)))
    weight = np.outer(gain, gain[: whitening.shape[1]])
    weight[:, 1 : (side + 1) // 2] *= 2.0  # the other half of the frequencies
    return float(np.sqrt(np.sum(weight * whitening**2) / np.sum(weight)))


def _largest_spread(found: Deviations, bounds: Float64, threads: int | None) -> Float32:
    # of the sums over all Gaussians around each block of pixels, at least `bounds`; shape (lights, rows, columns)
    lights, height, width = found.z.shape
    result = np.zeros((lights, -(-height // BLOCK_PX), -(-width // BLOCK_PX)), np.float32)

    def around(values: Float32 | Bool) -> Float64:
        return ndimage.gaussian_filter(block_sums(values, BLOCK_PX), LOCAL_PX / BLOCK_PX)

    for scale, least in zip(SCALES_PX, bounds.T, strict=True):
        sums, counts = smoothed_deviations(found, scale, threads=threads)
        for own, known, bound, out in zip(sums, counts, least, result, strict=True):
            share = np.maximum(around(known), 1e-6 * BLOCK_PX**2)
            spread = around(np.abs(_clipped(own, known))) / share / MEAN_OF_NORMAL
            np.maximum(out, np.maximum(spread, bound), out=out, casting="same_kind")
    return result


def _correlation(found: Deviations, threads: int | None) -> float:
    # the greatest between any two images, of sums over the middle Gaussian; 0 where chance makes as much
    scale = SCALES_PX[1]
    sums, counts = smoothed_deviations(found, scale, threads=threads)
    clipped = [_clipped(own, known) for own, known in zip(sums, counts, strict=True)]
    greatest = 0.0
    for i, k in combinations(range(len(sums)), 2):
        both = counts[i] & counts[k]
        independent = np.count_nonzero(both) / noise_gain(scale) ** 2
        if independent < 1.0:
            continue
        a, b = (one[both].astype(np.float64) for one in (clipped[i], clipped[k]))
        own = abs(float(np.mean(a * b))) / max(math.sqrt(float(np.mean(a * a) * np.mean(b * b))), 1e-12)
        if own > CLEAR / math.sqrt(independent):
            greatest = max(greatest, own)
    return min(greatest, MOST_CORRELATION)


def texture_threshold(score: Float32, found: Deviations, least: float, false_alarms: float) -> float:
    """Score that texture exceeds anywhere in a posture with at most about this probability, and no less than `least`.

    The share of the surface above a score is taken to fall exponentially, as it does for normal deviates of whatever
    spread. The rate is fitted to the scores of the surface itself, without defects: these are regions that stand out
    from its middle scores, unless they cover more than :data:`MOST_DEFECTIVE` of it.
    """
    usable = np.asarray(found.usable.any(axis=0), np.bool_)
    if not usable.any():
        return least
    middle = max(least, _extrapolated(score[usable], MIDDLE_SHARES, false_alarms))
    labels, _ = find_regions(score, middle)
    rest = usable & np.logical_not(ndimage.binary_dilation(labels > 0, iterations=SPREAD_PX))
    if np.count_nonzero(rest) < (1.0 - MOST_DEFECTIVE) * np.count_nonzero(usable):
        rest = usable
    return max(least, _extrapolated(score[rest], UPPER_SHARES, false_alarms))


def _extrapolated(score: Float32, shares: tuple[float, float], false_alarms: float) -> float:
    # the score that so small a share exceeds that the whole has these false alarms, on the line through two shares
    low, up = (float(np.quantile(score, 1.0 - share)) for share in shares)
    decades = math.log10(shares[0] * len(score) / false_alarms)
    return low + (up - low) / math.log10(shares[0] / shares[1]) * decades
