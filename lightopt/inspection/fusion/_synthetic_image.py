"""The synthetic image of a posture: its images fused into one without highlights, and its uncertainty."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.threads import in_threads
from lightopt.inspection._image_blocks import block_sums, filter_tile, gaussian_taps, in_row_blocks, mask_window
from lightopt.inspection.fusion._gradient_fusion import Fusion, FusionRule, fuse_with_prediction, pixel_weights
from lightopt.inspection.fusion._poisson import poisson_grid
from lightopt.inspection.prediction._posture_view import PostureView

# rules that average the gradients of images; the others choose one of them, by noise as much as by shading
AVERAGING: Final = ("paper",)

# weight of an edge at which no image is used: its difference is that of the good part, or 0 where that is not known,
# unless the others want otherwise
FILL_WEIGHT = 1e-3

MARGIN_PX = 2  # around the pixels of the mask, as far as the rules reach
PROBES = 4
PROBE_TOLERANCE = 1e-4
# the uncertainty is the spread of so many images made from levels with noise added, smoothed over so many pixels; what
# noise makes of a rule is the mean of as many made from the prediction
SPREAD_PX = 4.0

PRIOR_PX = 15.0
# a gradient at which no image is used is taken to be about as large as those around, Gaussian of this width, which are
# added up in blocks of this side first
BLOCK_PX = 4


@dataclass(frozen=True)
class SyntheticImage:
    level: Float32  # [grey level at exposure 1], shape (H, W); 0 outside of the mask
    # its standard deviation: the noise of the images, propagated; what was filled in where no image is used; what noise
    # makes of edges by helping them through a rule or not, or the uncertainty of that where it is taken off
    deviation: Float32
    filled: Bool  # pixels of the mask around which no image is used, shape (H, W)
    mask: Bool  # pixels that have a level, shape (H, W)


def synthetic_image(
    view: PostureView, fusion: Fusion, *, probes: int = PROBES, threads: int | None = None
) -> SyntheticImage:
    """The image of a posture without highlights; `fusion` and `probes` as :func:`fuse_images` takes them."""
    weights = pixel_weights(view.saturated, view.predicted, view.specular, view.deviation, view.limit, threads=threads)
    return fuse_images(
        view.level,
        view.deviation,
        weights,
        view.clean,
        fusion=fusion,
        predicted=view.predicted,
        specular=view.specular,
        probes=probes,
        threads=threads,
    )


def fuse_images(
    levels: Float32,
    deviations: Float32,
    weights: Float32,
    mask: Bool,
    *,
    fusion: Fusion,
    predicted: Float32 | None = None,
    specular: Float32 | None = None,
    seed: int = 0,
    probes: int = PROBES,
    threads: int | None = None,
) -> SyntheticImage:
    """Fuse the images of a posture by their gradients and integrate those.

    The predicted light of the highlights that is left where an image is used is taken off. Where one is not used, its
    shading is missing from a mean of gradients: they change from one set of images to another, and a former highlight
    stands out by what that adds up to. On the good part that is known from the prediction, and is put back. Noise helps
    gradients through a rule or keeps them out, which is no scatter but a bias; rules that choose one gradient follow it
    as much as shading. Of those it is taken off, as estimated from the prediction with noise; where gradients are
    averaged it counts as uncertainty.

    levels, deviations: Of the images and of their noise, shape (images, H, W) [grey level].
    weights: From :func:`pixel_weights`, same shape.
    mask: Pixels to make an image of, shape (H, W).
    predicted, specular: Levels of the good part, and the highlights' share of them, shape of `levels`; nothing is taken
        off without.
    probes: How many times noise is added to find the uncertainty; 0 for an uncertainty of 0.
    """
    rows, columns = (slice(max(0, side.start - MARGIN_PX), side.stop + MARGIN_PX) for side in mask_window(mask))
    box = (slice(None), rows, columns)
    levels, deviations, weights, inner = levels[box], deviations[box], weights[box], mask[rows, columns]
    rule = FusionRule.of(weights, deviations, fusion)
    averaging = fusion in AVERAGING
    if predicted is None or specular is None:
        draws, fused = 0, rule.fuse(levels)
        missing = bias = [np.zeros(g.shape) for g in fused]
    else:
        levels, diffuse = levels - specular[box], predicted[box] - specular[box]
        # the bias of a rule that chooses is taken off the image, whether or not its uncertainty is wanted
        draws = probes if averaging else PROBES
        fused, missing, bias = fuse_with_prediction(rule, levels, diffuse, draws=draws, seed=seed, threads=threads)
    complete = [g + more for g, more in zip(fused, missing, strict=True)]
    unknown = [edges.unknown for edges in rule.edges]
    grid = poisson_grid(inner, *(np.where(u, FILL_WEIGHT, 1.0) for u in unknown))
    between = inner[:, 1:] & inner[:, :-1], inner[1:] & inner[:-1]  # edges beyond the mask have no say
    filling = any(bool(np.any(u & own)) for u, own in zip(unknown, between, strict=True))
    typical = [_typical_size(g, u) for g, u in zip(complete, unknown, strict=True)] if probes and filling else []
    nothing = np.zeros(inner.shape)

    def image() -> Float64:
        total = weights.sum(axis=0, dtype=np.float64)
        mean = (weights * levels).sum(axis=0, dtype=np.float64) / np.maximum(total, 1e-9)
        return grid.integrate(*complete, level=mean)

    def scatter(number: int) -> Float64:
        rng = np.random.default_rng((seed, 1, number))
        errors = rule.fuse_with_noise(levels, rng)
        for error, own in zip(errors, fused, strict=True):
            error -= own
        for error, u, size in zip(errors, unknown, typical, strict=False):  # nothing is typical where all is known
            np.copyto(error, size * rng.standard_normal(u.shape, dtype=np.float32), where=u)
        return probe(*errors)

    probe = partial(grid.integrate, level=nothing, tolerance=PROBE_TOLERANCE)
    tasks = [image, *([partial(probe, *bias)] if draws else []), *(partial(scatter, i) for i in range(probes))]
    level, *errors = in_threads(lambda task: task(), tasks, threads)
    by_noise = errors.pop(0) if draws else nothing
    square = sum((np.square(error) / probes for error in errors), nothing)
    if averaging:
        square = square + np.square(by_noise)
    elif draws:
        # smooth, lest its own noise shows; as a mean of so many it has that share of one's variance
        level = level - np.where(inner, _smoothed(by_noise, inner, threads), 0.0)
        square = square * (1.0 + 1.0 / draws)
    whole, spread = np.zeros(mask.shape, np.float32), np.zeros(mask.shape, np.float32)
    filled = np.zeros(mask.shape, np.bool_)
    whole[rows, columns] = level
    spread[rows, columns] = np.where(inner, np.sqrt(_smoothed(square, inner, threads)), 0.0)
    filled[rows, columns] = inner & _all_unknown(*unknown)
    return SyntheticImage(level=whole, deviation=spread, filled=filled, mask=mask)


def _all_unknown(unknown_x: Bool, unknown_y: Bool) -> Bool:
    # pixels of which no edge is known
    known = np.zeros((unknown_x.shape[0], unknown_y.shape[1]), np.bool_)
    known[:, 1:] |= ~unknown_x
    known[:, :-1] |= ~unknown_x
    known[1:] |= ~unknown_y
    known[:-1] |= ~unknown_y
    return ~known


def _typical_size(gradient: Float64, unknown: Bool) -> Float32:
    # root mean square of the known differences around each edge, by blocks of edges
    known = ~unknown
    square = np.where(known, np.square(gradient), 0.0)
    typical = math.sqrt(float(square.sum()) / max(float(known.sum()), 1.0))
    # means of blocks
    shares, squares = (
        ndimage.gaussian_filter(block_sums(values, BLOCK_PX) / BLOCK_PX**2, PRIOR_PX / BLOCK_PX)
        for values in (known, square)
    )
    prior = np.where(shares > 1e-3, np.sqrt(squares / np.maximum(shares, 1e-3)), typical).astype(np.float32)
    rows, columns = gradient.shape
    return prior.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)[:rows, :columns]


def _smoothed(values: Float64, mask: Bool, threads: int | None) -> Float64:
    # means over a Gaussian of SPREAD_PX, of the pixels of a mask alone
    taps = gaussian_taps(SPREAD_PX)
    inside = np.where(mask, values, 0.0).astype(np.float32)
    share, total = np.empty_like(inside), np.empty_like(inside)

    def filter_rows(rows: slice) -> None:
        filter_tile(mask, taps, rows.start, 0, np.inf, share[rows])
        filter_tile(inside, taps, rows.start, 0, np.inf, total[rows])

    in_row_blocks(filter_rows, len(mask), threads)
    return total.astype(np.float64) / np.maximum(share, 1e-3)
