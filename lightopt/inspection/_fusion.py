"""From the gradients of several images of a posture to those of one without highlights.

A highlight is where it is in one image only, and so are its steep flanks; what belongs to the surface is seen in
others, too. Rules differ in how they tell. All look at the images that can be trusted at a place and at no others.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

__all__ = ["FUSIONS", "Fusion", "fuse_gradients", "trusted"]

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]

Fusion = Literal["paper", "median", "minimum", "second-largest"]
FUSIONS: Final = ("paper", "median", "minimum", "second-largest")

LEAST_TRUST = 0.25
"""An image with less than this share of the weight of the best one at a place has no say there."""

SUPPORT = 0.5
"""The paper's rule keeps a gradient where another image has one of at least this share of its size nearby."""

NOISE_SLACK = 2.0
"""Gradients count as equal within this many standard deviations of noise."""

NEIGHBOURHOOD_PX = 3


def trusted(weights: Float32, axis: int) -> Bool:
    """Which images have a say at each edge between neighbouring pixels, shape (images, H, W − 1) or (images, H − 1, W).

    Parameters
    ----------
    weights
        How far each pixel of each image tells of the surface, 0 to 1, shape (images, H, W).
    axis
        1 for edges to the pixel to the right, 0 for those to the pixel below.
    """
    edge = np.minimum(*_ends(weights, axis))
    return (edge > 0.0) & (edge >= LEAST_TRUST * edge.max(axis=0))


def fuse_gradients(
    levels: Float32, deviations: Float32, usable: Bool, *, axis: int, fusion: Fusion
) -> tuple[Float64, Bool]:
    """Differences between neighbouring pixels of the fused image, and where no image tells them (0 there).

    Parameters
    ----------
    levels
        The images of a posture, shape (images, H, W).
    deviations
        Standard deviation of their noise, same shape.
    usable
        From :func:`trusted`.
    axis
        As there.
    fusion
        ``paper``: a gradient is kept where another image has one at the same place, of whatever sign, and those kept
        are averaged; ``median`` (Weiss 2001, doi:10.1109/ICCV.2001.937606); ``minimum``: the one of least magnitude;
        ``second-largest``: the one of second largest magnitude.
    """
    first, second = _ends(levels, axis)
    gradients = np.where(usable, second - first, np.float32(0.0))
    noise = np.hypot(*_ends(deviations, axis))
    unknown: Bool = usable.sum(axis=0) == 0
    return _RULES[fusion](gradients, noise, usable), unknown


def _ends(images: Float32, axis: int) -> tuple[Float32, Float32]:
    # the two pixels of each edge
    if axis == 1:
        return images[:, :, :-1], images[:, :, 1:]
    return images[:, :-1], images[:, 1:]


def _paper(gradients: Float32, noise: Float32, usable: Bool) -> Float64:
    size = np.abs(gradients)
    near = ndimage.maximum_filter(size, size=(1, NEIGHBOURHOOD_PX, NEIGHBOURHOOD_PX))
    near = np.where(usable, near, np.float32(-1.0))
    largest = near.argmax(axis=0)
    ordered = np.sort(near, axis=0)
    images = np.arange(len(near))[:, None, None]
    # an image alone has nobody to ask
    runner_up = ordered[-2] if len(near) > 1 else ordered[-1]
    others = np.where(images == largest, runner_up, ordered[-1])
    alone = usable.sum(axis=0) == 1
    kept = usable & ((others >= SUPPORT * size - NOISE_SLACK * noise) | alone)
    count = np.maximum(kept.sum(axis=0), 1)
    return np.where(kept, gradients, 0.0).sum(axis=0, dtype=np.float64) / count


def _median(gradients: Float32, noise: Float32, usable: Bool) -> Float64:  # noqa: ARG001
    ordered = np.sort(np.where(usable, gradients, np.float32(np.inf)), axis=0)
    count = usable.sum(axis=0)
    low, high = np.maximum((count - 1) // 2, 0), count // 2
    high = np.minimum(high, np.maximum(count - 1, 0))
    middle = 0.5 * (_at(ordered, low).astype(np.float64) + _at(ordered, high))
    return np.where(count > 0, middle, 0.0)


def _minimum(gradients: Float32, noise: Float32, usable: Bool) -> Float64:  # noqa: ARG001
    size = np.where(usable, np.abs(gradients), np.float32(np.inf))
    return _at(gradients, size.argmin(axis=0)).astype(np.float64)


def _second_largest(gradients: Float32, noise: Float32, usable: Bool) -> Float64:  # noqa: ARG001
    size = np.where(usable, np.abs(gradients), np.float32(-1.0))
    order = np.argsort(size, axis=0)
    second = order[-2] if len(order) > 1 else order[-1]
    index = np.where(usable.sum(axis=0) > 1, second, order[-1])
    return _at(gradients, index).astype(np.float64)


_RULES: dict[str, Callable[[Float32, Float32, Bool], Float64]] = {
    "paper": _paper,
    "median": _median,
    "minimum": _minimum,
    "second-largest": _second_largest,
}


def _at(images: Float32, index: NDArray[np.intp]) -> Float32:
    return np.take_along_axis(images, index[None], axis=0)[0]
