"""The synthetic image of a posture: its images fused into one without highlights, and how far to trust it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.inspection._filter import BLOCK_ROWS, filter_tile, gaussian_taps, row_blocks
from lightopt.inspection._fusion import Edges, Fusion, fuse_gradients
from lightopt.inspection._poisson import mask_window, poisson_grid
from lightopt.kernels import kernel
from lightopt.rendering import in_threads

__all__ = ["PROBES", "SyntheticImage", "fuse_images", "trust_weights"]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
T = TypeVar("T")

BLOOMING_PX = 2
"""Pixels this near to a saturated one are not trusted: charge, glare and lens spread there."""

LIT = 3.0
"""A pixel that is predicted to be less than this many standard deviations of noise above black is in shadow."""

AVERAGING: Final = ("paper",)
"""Rules that average the gradients of images; the others choose one of them, by noise as much as by shading."""

FILL_WEIGHT = 1e-3
"""Weight of an edge of which no image tells: its difference is that of the good part, or 0 where that is not known,
unless the others want otherwise."""

MARGIN_PX = 2
"""Around the pixels of the mask, as far as the rules look."""

PROBES = 4
PROBE_TOLERANCE = 1e-4
SPREAD_PX = 4.0
"""The uncertainty is the spread of so many images made from levels with noise added, smoothed over so many pixels; what
noise makes of a rule is the mean of as many made from the prediction."""

PRIOR_PX = 15.0
BLOCK_PX = 4
"""Where no image tells a gradient, it is taken to be about as large as those around, Gaussian of this width, which are
added up in blocks of this side first."""


@dataclass(frozen=True)
class SyntheticImage:
    """An image without highlights.

    Attributes
    ----------
    level
        [grey level at exposure 1], shape (H, W); 0 outside of the mask.
    deviation
        Its standard deviation: the noise of the images, propagated, what was filled in where no image tells, and what
        noise makes of edges by helping them through a rule or not, or what is not known of that where it is taken off.
    filled
        Pixels of the mask at which no image tells any gradient, shape (H, W).
    mask
        Pixels that have a level, shape (H, W).
    """

    level: Float32
    deviation: Float32
    filled: Bool
    mask: Bool


def trust_weights(
    saturated: Bool,
    predicted: Float32,
    specular: Float32,
    deviations: Float32,
    limit: Float32,
    *,
    threads: int | None = None,
) -> Float32:
    """How far each pixel of each image tells of the surface and not of a highlight or a shadow, 0 to 1.

    0 where it is saturated or predicted to be, and next to that; 0 in shadow; the less the steeper the flank of the
    highlight that is predicted there.

    Parameters
    ----------
    saturated
        As measured, shape (images, H, W).
    predicted, specular
        Levels of the good part, and the highlights' share of them [grey level], same shape.
    deviations
        Standard deviation of the noise [grey level], same shape.
    limit
        Level from which a pixel is saturated [grey level], same shape.
    threads
        Number of threads; the result does not depend on it.
    """
    weights = np.empty(predicted.shape, np.float32)
    images, height, _ = predicted.shape
    pieces = [(i, top) for i in range(images) for top in row_blocks(height)]

    def piece(number: int) -> None:
        i, top = pieces[number]
        mine = weights[i, top : top + BLOCK_ROWS]
        _trust(saturated[i], predicted[i], specular[i], deviations[i], limit[i], top, mine)

    in_threads(piece, range(len(pieces)), threads)
    return weights


@kernel
def _trust(
    saturated: Bool,
    predicted: Float32,
    specular: Float32,
    deviations: Float32,
    limit: Float32,
    top: int,
    weights: Float32,
) -> None:
    # rows of an image's weights from `top` on
    height, width = predicted.shape
    rows = len(weights)
    full = np.zeros((rows, width), np.bool_)
    for y in range(max(0, top - BLOOMING_PX), min(height, top + rows + BLOOMING_PX)):
        first, last = max(0, y - BLOOMING_PX - top), min(rows, y + BLOOMING_PX + 1 - top)
        for x in range(width):
            if saturated[y, x] or predicted[y, x] >= limit[y, x]:
                full[first:last, max(0, x - BLOOMING_PX) : x + BLOOMING_PX + 1] = True
    for row in range(rows):
        y = top + row
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            weights[row, x] = 0.0
            noise = deviations[y, x]
            if full[row, x] or predicted[y, x] < LIT * noise:
                continue
            before, after = max(x - 1, 0), min(x + 1, width - 1)
            down = (specular[below, x] - specular[above, x]) / max(below - above, 1)
            right = (specular[y, after] - specular[y, before]) / max(after - before, 1)
            weights[row, x] = 1.0 / (1.0 + (down * down + right * right) / (noise * noise))


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

    The predicted light of the highlights that is left where an image has a say is taken off. Where one has no say, its
    shading is missing from a mean of gradients: they change from one set of images to another, and a former highlight
    stands out by what that adds up to. On the good part that is known from the prediction, and is put back. Noise helps
    gradients through a rule or keeps them out, which is no scatter but a bias; rules that choose one gradient follow it
    as much as shading. Of those it is taken off, as the prediction with noise drawn has it; where gradients are
    averaged it counts as uncertainty.

    Parameters
    ----------
    levels, deviations
        Shape (images, H, W) [grey level].
    weights
        From :func:`trust_weights`.
    mask
        Pixels to make an image of, shape (H, W).
    fusion
        As :func:`lightopt.inspection._fusion.fuse_gradients` takes it.
    predicted, specular
        Levels of the good part, and the highlights' share of them, shape of `levels`; nothing is taken off without.
    seed
        Of the noise that the uncertainty is found with.
    probes
        How many times noise is added to find it; 0 for an uncertainty of 0.
    threads
        Number of threads; the result does not depend on it.
    """
    rows, columns = (
        slice(max(0, side.start - MARGIN_PX), side.stop + MARGIN_PX) for side in mask_window(mask)
    )
    box = (slice(None), rows, columns)
    inner = _fuse(
        levels[box],
        deviations[box],
        weights[box],
        mask[rows, columns],
        fusion=fusion,
        good=None if predicted is None or specular is None else (predicted[box], specular[box]),
        seed=seed,
        probes=probes,
        threads=threads,
    )
    level, deviation = (np.zeros(mask.shape, np.float32) for _ in range(2))
    filled = np.zeros(mask.shape, np.bool_)
    level[rows, columns], deviation[rows, columns] = inner.level, inner.deviation
    filled[rows, columns] = inner.filled
    return SyntheticImage(level=level, deviation=deviation, filled=filled, mask=mask)


def _fuse(
    levels: Float32,
    deviations: Float32,
    weights: Float32,
    mask: Bool,
    *,
    fusion: Fusion,
    good: tuple[Float32, Float32] | None,
    seed: int,
    probes: int,
    threads: int | None,
) -> SyntheticImage:
    # as fuse_images; `good` is what is predicted, and the highlights' share of it
    own = _both_ways(weights, deviations)
    unknown = [edges.unknown for edges in own]
    averaging = fusion in AVERAGING

    def gradients(images: Float32, edges: Sequence[Edges] = own) -> list[Float64]:
        return [fuse_gradients(images, one, fusion=fusion, threads=1) for one in edges]

    def with_noise(images: Float32, rng: np.random.Generator) -> list[Float64]:
        drawn = rng.standard_normal(images.shape, dtype=np.float32)
        drawn *= deviations
        drawn += images
        return gradients(drawn)

    missing, bias = ([np.zeros(u.shape) for u in unknown] for _ in range(2))
    # what noise makes of a rule that chooses is taken off the image, whether or not its uncertainty is asked for
    draws = 0 if good is None else probes if averaging else PROBES
    if good is None:
        fused = gradients(levels)
    else:
        predicted, specular = good
        levels, diffuse = levels - specular, predicted - specular
        lit = (diffuse >= LIT * deviations).astype(np.float32)
        fused, here, everywhere, *drawn = _side_by_side(
            [
                partial(gradients, levels),
                partial(gradients, diffuse),
                lambda: gradients(diffuse, _both_ways(lit, deviations)),
                *(partial(with_noise, diffuse, np.random.default_rng((seed, 0, i))) for i in range(draws)),
            ],
            threads,
        )
        missing = [a - b for a, b in zip(everywhere, here, strict=True)]
        if draws:
            bias = [sum(many) / draws - h for *many, h in zip(*drawn, here, strict=True)]
    complete = [g + more for g, more in zip(fused, missing, strict=True)]
    grid = poisson_grid(mask, *(np.where(u, FILL_WEIGHT, 1.0) for u in unknown))
    typical = [_prior(g, u) for g, u in zip(complete, unknown, strict=True)] if probes else []
    nothing = np.zeros(mask.shape)

    def image() -> Float64:
        total = weights.sum(axis=0, dtype=np.float64)
        mean = (weights * levels).sum(axis=0, dtype=np.float64) / np.maximum(total, 1e-9)
        return grid.integrate(*complete, level=mean)

    def biased() -> Float64:
        return grid.integrate(*bias, level=nothing, tolerance=PROBE_TOLERANCE)

    def scatter(number: int) -> Float64:
        rng = np.random.default_rng((seed, 1, number))
        off = [
            np.where(u, size * rng.standard_normal(u.shape, dtype=np.float32), other - g)
            for u, size, other, g in zip(unknown, typical, with_noise(levels, rng), fused, strict=True)
        ]
        return grid.integrate(*off, level=nothing, tolerance=PROBE_TOLERANCE)

    works = [image, *([biased] if draws else []), *(partial(scatter, i) for i in range(probes))]
    level, *offs = _side_by_side(works, threads)
    by_noise = offs.pop(0) if draws else nothing
    square = sum((np.square(off) / probes for off in offs), nothing)
    if averaging:
        square = square + np.square(by_noise)
    elif draws:
        # smooth, lest its own noise shows; as a mean of so many it has that share of one's variance
        level = level - np.where(mask, _smoothed(by_noise, mask, threads), 0.0)
        square = square * (1.0 + 1.0 / draws)
    return SyntheticImage(
        level=level.astype(np.float32),
        deviation=np.where(mask, np.sqrt(_smoothed(square, mask, threads)), 0.0).astype(np.float32),
        filled=mask & _all_unknown(*unknown),
        mask=mask,
    )


def _side_by_side(works: Sequence[Callable[[], T]], threads: int | None) -> list[T]:
    # each has random numbers of its own, so that their order does not matter
    return in_threads(lambda number: works[number](), range(len(works)), threads)


def _both_ways(weights: Float32, deviations: Float32) -> tuple[Edges, Edges]:
    return Edges.of(weights, deviations, 1), Edges.of(weights, deviations, 0)


def _prior(gradient: Float64, unknown: Bool) -> Float32:
    # root mean square of the known gradients around, by blocks of pixels
    known = ~unknown
    square = np.where(known, np.square(gradient), 0.0)
    typical = math.sqrt(float(square.sum()) / max(float(known.sum()), 1.0))
    shares, squares = (
        ndimage.gaussian_filter(_in_blocks(values), PRIOR_PX / BLOCK_PX) for values in (known, square)
    )
    prior = np.where(shares > 1e-3, np.sqrt(squares / np.maximum(shares, 1e-3)), typical).astype(np.float32)
    rows, columns = gradient.shape
    return prior.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)[:rows, :columns]


def _in_blocks(values: Float64 | Bool) -> Float64:
    # means of blocks; beyond the last row and column is nothing
    rows, columns = (-(-side // BLOCK_PX) * BLOCK_PX for side in values.shape)
    whole = np.zeros((rows, columns))
    whole[: values.shape[0], : values.shape[1]] = values
    return whole.reshape(rows // BLOCK_PX, BLOCK_PX, columns // BLOCK_PX, BLOCK_PX).mean(axis=(1, 3))


def _smoothed(values: Float64, mask: Bool, threads: int | None) -> Float64:
    taps = gaussian_taps(SPREAD_PX)
    inside = np.where(mask, values, 0.0).astype(np.float32)
    share, total = np.empty_like(inside), np.empty_like(inside)

    def block(top: int) -> None:
        rows = slice(top, top + BLOCK_ROWS)
        filter_tile(mask, taps, top, 0, share[rows])
        filter_tile(inside, taps, top, 0, total[rows])

    in_threads(block, row_blocks(len(mask)), threads)
    return total.astype(np.float64) / np.maximum(share, 1e-3)


def _all_unknown(unknown_x: Bool, unknown_y: Bool) -> Bool:
    known = np.zeros((unknown_x.shape[0], unknown_y.shape[1]), np.bool_)
    known[:, 1:] |= ~unknown_x
    known[:, :-1] |= ~unknown_x
    known[1:] |= ~unknown_y
    known[:-1] |= ~unknown_y
    return ~known
