"""The synthetic image of a posture: its images fused into one without highlights, and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lightopt.inspection._fusion import Fusion, fuse_gradients, trusted
from lightopt.inspection._poisson import PoissonGrid, poisson_grid

__all__ = ["PROBES", "SyntheticImage", "fuse_images", "trust_weights"]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
_Fused = tuple[Float64, Bool]

BLOOMING_PX = 2
"""Pixels this near to a saturated one are not trusted: charge, glare and lens spread there."""

LIT = 3.0
"""A pixel that is predicted to be less than this many standard deviations of noise above black is in shadow."""

AVERAGING: Final = ("paper",)
"""Rules that average the gradients of images, and so miss the shading of those that have no say."""

FILL_WEIGHT = 1e-3
"""Weight of an edge of which no image tells: its difference is that of the good part for a rule that averages, else 0,
unless the others want otherwise."""

PROBES = 4
PROBE_TOLERANCE = 1e-4
SPREAD_PX = 4.0
"""The uncertainty is the spread of so many images made from levels with noise added, smoothed over so many pixels."""

PRIOR_PX = 15.0
"""Where no image tells a gradient, it is taken to be about as large as those around."""


@dataclass(frozen=True)
class SyntheticImage:
    """An image without highlights.

    Attributes
    ----------
    level
        [grey level at exposure 1], shape (H, W); 0 outside of the mask.
    deviation
        Its standard deviation: the noise of the images, propagated, what was filled in where no image tells, and the
        shading that a rule misses by choosing among the images that have a say.
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
    saturated: Bool, predicted: Float32, specular: Float32, deviations: Float32, limit: Float32
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
    """
    side = 2 * BLOOMING_PX + 1
    full = np.zeros(saturated.shape, np.bool_)
    ndimage.maximum_filter(saturated | (predicted >= limit), size=(1, side, side), output=full)
    down, right = np.gradient(specular, axis=(1, 2))
    flank = (down * down + right * right) / np.square(deviations)
    weights = np.where(
        np.logical_or(full, predicted < LIT * deviations), np.float32(0.0), 1.0 / (1.0 + flank)
    )
    return weights.astype(np.float32)


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
) -> SyntheticImage:
    """Fuse the images of a posture by their gradients and integrate those.

    The predicted light of the highlights that is left where an image has a say is taken off. Where one has no say, its
    shading is missing from a mean of gradients: they change from one set of images to another, and a former highlight
    stands out by what that adds up to. On the good part that is known from the prediction, and is put back. Rules that
    choose one gradient follow noise as much as shading: nothing is put back, and it counts as uncertainty.

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
    """

    def usable_edges(weights: Float32) -> tuple[Bool, Bool]:
        return trusted(weights, 1), trusted(weights, 0)

    usable = usable_edges(weights)

    def gradients(images: Float32, usable: tuple[Bool, Bool] = usable) -> tuple[_Fused, _Fused]:
        return (
            fuse_gradients(images, deviations, usable[0], axis=1, fusion=fusion),
            fuse_gradients(images, deviations, usable[1], axis=0, fusion=fusion),
        )

    missing: tuple[Float64 | float, Float64 | float] = 0.0, 0.0
    if predicted is not None and specular is not None:
        levels, diffuse = levels - specular, predicted - specular
        lit = (diffuse >= LIT * deviations).astype(np.float32)
        (all_x, _), (all_y, _) = gradients(diffuse, usable_edges(lit))
        (some_x, _), (some_y, _) = gradients(diffuse)
        missing = all_x - some_x, all_y - some_y
    averaging = fusion in AVERAGING
    put_back = missing if averaging else (0.0, 0.0)
    (gx, unknown_x), (gy, unknown_y) = gradients(levels)
    gx, gy = gx + put_back[0], gy + put_back[1]
    grid = poisson_grid(mask, np.where(unknown_x, FILL_WEIGHT, 1.0), np.where(unknown_y, FILL_WEIGHT, 1.0))
    total = weights.sum(axis=0, dtype=np.float64)
    mean = (weights * levels).sum(axis=0, dtype=np.float64) / np.maximum(total, 1e-9)
    image = grid.integrate(gx, gy, level=mean)
    prior_x, prior_y = _prior(gx, unknown_x), _prior(gy, unknown_y)
    rng = np.random.default_rng(seed)
    square = np.zeros(mask.shape)
    if probes and not averaging:
        square += np.square(
            grid.integrate(
                np.zeros_like(gx) + missing[0],
                np.zeros_like(gy) + missing[1],
                level=np.zeros(mask.shape),
                tolerance=PROBE_TOLERANCE,
            )
        )
    for _ in range(probes):
        noisy = levels + deviations * rng.standard_normal(levels.shape, dtype=np.float32)
        (nx, _), (ny, _) = gradients(noisy.astype(np.float32))
        nx, ny = nx + put_back[0], ny + put_back[1]
        nx = np.where(unknown_x, gx + prior_x * rng.standard_normal(nx.shape), nx)
        ny = np.where(unknown_y, gy + prior_y * rng.standard_normal(ny.shape), ny)
        off = grid.integrate(nx - gx, ny - gy, level=np.zeros(mask.shape), tolerance=PROBE_TOLERANCE)
        square += off * off / probes
    return SyntheticImage(
        level=image.astype(np.float32),
        deviation=np.where(mask, np.sqrt(_smoothed(square, grid)), 0.0).astype(np.float32),
        filled=mask & _all_unknown(unknown_x, unknown_y),
        mask=mask,
    )


def _prior(gradient: Float64, unknown: Bool) -> Float64:
    # root mean square of the known gradients around
    known = (~unknown).astype(np.float64)
    share = ndimage.gaussian_filter(known, PRIOR_PX)
    square = ndimage.gaussian_filter(known * np.square(gradient), PRIOR_PX)
    typical = float(np.sqrt(np.sum(known * np.square(gradient)) / max(float(known.sum()), 1.0)))
    return np.where(share > 1e-3, np.sqrt(square / np.maximum(share, 1e-3)), typical)


def _smoothed(values: Float64, grid: PoissonGrid) -> Float64:
    share = ndimage.gaussian_filter(grid.mask.astype(np.float64), SPREAD_PX)
    return ndimage.gaussian_filter(np.where(grid.mask, values, 0.0), SPREAD_PX) / np.maximum(share, 1e-3)


def _all_unknown(unknown_x: Bool, unknown_y: Bool) -> Bool:
    known = np.zeros((unknown_x.shape[0], unknown_y.shape[1]), np.bool_)
    known[:, 1:] |= ~unknown_x
    known[:, :-1] |= ~unknown_x
    known[1:] |= ~unknown_y
    known[:-1] |= ~unknown_y
    return ~known
