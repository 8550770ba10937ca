"""The synthetic image of a posture: its images fused into one without highlights, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lightopt.core.threads import in_threads
from lightopt.inspection._fusion import Fusion
from lightopt.inspection._gradients import FusedGradients, Rule, fuse_beside
from lightopt.inspection._neighbourhood import smoothed, typical_size
from lightopt.inspection._poisson import mask_window, poisson_grid

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

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
    rule = Rule.of(weights, deviations, fusion)
    averaging = fusion in AVERAGING
    if good is None:
        draws, gradients = 0, FusedGradients.alone(rule.fuse(levels))
    else:
        predicted, specular = good
        levels, diffuse = levels - specular, predicted - specular
        # what noise makes of a rule that chooses is taken off the image, whether or not its uncertainty is asked for
        draws = probes if averaging else PROBES
        gradients = fuse_beside(rule, levels, diffuse, draws=draws, seed=seed, threads=threads)
    complete = [g + more for g, more in zip(gradients.fused, gradients.missing, strict=True)]
    unknown = rule.unknown
    grid = poisson_grid(mask, *(np.where(u, FILL_WEIGHT, 1.0) for u in unknown))
    typical = [typical_size(g, u) for g, u in zip(complete, unknown, strict=True)] if probes else []
    nothing = np.zeros(mask.shape)

    def image() -> Float64:
        total = weights.sum(axis=0, dtype=np.float64)
        mean = (weights * levels).sum(axis=0, dtype=np.float64) / np.maximum(total, 1e-9)
        return grid.integrate(*complete, level=mean)

    def biased() -> Float64:
        return grid.integrate(*gradients.bias, level=nothing, tolerance=PROBE_TOLERANCE)

    def scatter(number: int) -> Float64:
        rng = np.random.default_rng((seed, 1, number))
        drawn = rule.fuse_with_noise(levels, rng)
        off = [
            np.where(u, size * rng.standard_normal(u.shape, dtype=np.float32), other - g)
            for u, size, other, g in zip(unknown, typical, drawn, gradients.fused, strict=True)
        ]
        return grid.integrate(*off, level=nothing, tolerance=PROBE_TOLERANCE)

    works = [image, *([biased] if draws else []), *(partial(scatter, i) for i in range(probes))]
    level, *offs = in_threads(lambda number: works[number](), range(len(works)), threads)
    by_noise = offs.pop(0) if draws else nothing
    square = sum((np.square(off) / probes for off in offs), nothing)
    if averaging:
        square = square + np.square(by_noise)
    elif draws:
        # smooth, lest its own noise shows; as a mean of so many it has that share of one's variance
        level = level - np.where(mask, smoothed(by_noise, mask, SPREAD_PX, threads), 0.0)
        square = square * (1.0 + 1.0 / draws)
    deviation = np.where(mask, np.sqrt(smoothed(square, mask, SPREAD_PX, threads)), 0.0)
    return SyntheticImage(
        level=level.astype(np.float32),
        deviation=deviation.astype(np.float32),
        filled=mask & _all_unknown(*unknown),
        mask=mask,
    )


def _all_unknown(unknown_x: Bool, unknown_y: Bool) -> Bool:
    known = np.zeros((unknown_x.shape[0], unknown_y.shape[1]), np.bool_)
    known[:, 1:] |= ~unknown_x
    known[:, :-1] |= ~unknown_x
    known[1:] |= ~unknown_y
    known[:-1] |= ~unknown_y
    return ~known
