"""From the gradients of several images of a posture to those of one without highlights.

A highlight is where it is in one image only, and so are its steep flanks; what belongs to the surface is seen in
others, too. Rules differ in how they tell. All look at the images that can be trusted at a place and at no others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.inspection._row_blocks import BLOCK_ROWS, row_blocks
from lightopt.inspection.fusion._pixel_weights import LIT

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

REACH_PX = 1
"""How far off the other image's gradient may be."""


@dataclass(frozen=True)
class Edges:
    """The differences between neighbouring pixels of several images, and which of them tell of the surface.

    Attributes
    ----------
    axis
        1 for edges to the pixel to the right, 0 for those to the pixel below.
    usable
        Which images have a say at each edge, shape (images, H, W − 1) or (images, H − 1, W).
    noise
        Standard deviation of each difference, same shape.
    """

    axis: int
    usable: Bool
    noise: Float32

    @staticmethod
    def of(weights: Float32, deviations: Float32, axis: int) -> Edges:
        """Edges of images.

        Parameters
        ----------
        weights
            How far each pixel of each image tells of the surface, 0 to 1, shape (images, H, W).
        deviations
            Standard deviation of the images' noise, same shape.
        axis
            As above.
        """
        edge = np.minimum(*_ends(weights, axis))
        usable = (edge > 0.0) & (edge >= LEAST_TRUST * edge.max(axis=0))
        return Edges(axis, usable, np.hypot(*_ends(deviations, axis)))

    @property
    def unknown(self) -> Bool:
        """Edges at which no image has a say, shape (H, W − 1) or (H − 1, W)."""
        return np.asarray(~self.usable.any(axis=0), np.bool_)


def fuse_gradients(levels: Float32, edges: Edges, *, fusion: Fusion, threads: int | None = None) -> Float64:
    """Differences between neighbouring pixels of the fused image; 0 where no image tells them.

    Parameters
    ----------
    levels
        The images of a posture, shape (images, H, W).
    edges
        Of these images.
    fusion
        ``paper``: a gradient is kept where another image has one at the same place, of whatever sign, and those kept
        are averaged; ``median`` (Weiss 2001, doi:10.1109/ICCV.2001.937606); ``minimum``: the one of least magnitude;
        ``second-largest``: the one of second largest magnitude.
    threads
        Number of threads; the result does not depend on it.
    """
    fused = np.empty(edges.usable.shape[1:])
    number = FUSIONS.index(fusion)

    def block(top: int) -> None:
        bottom = min(top + BLOCK_ROWS, len(fused))
        _fuse_rows(levels, edges.axis, edges.noise, edges.usable, number, top, fused[top:bottom])

    in_threads(block, row_blocks(len(fused)), threads)
    return fused


def _ends(images: Float32, axis: int) -> tuple[Float32, Float32]:
    # the two pixels of each edge
    if axis == 1:
        return images[:, :, :-1], images[:, :, 1:]
    return images[:, :-1], images[:, 1:]


@kernel
def _fuse_rows(
    levels: Float32, axis: int, noise: Float32, usable: Bool, rule: int, top: int, fused: Float64
) -> None:
    # rows of the edges from `top` on, by the rule of that number among FUSIONS
    images, height, width = usable.shape
    rows = len(fused)
    first, last = max(0, top - REACH_PX), min(height, top + rows + REACH_PX)
    gradients = np.zeros((images, last - first, width), np.float32)
    down, right = 1 - axis, axis
    for i in range(images):
        for y in range(first, last):
            for x in range(width):
                if usable[i, y, x]:
                    gradients[i, y - first, x] = levels[i, y + down, x + right] - levels[i, y, x]
    if rule == 0:
        _average_supported(gradients, noise, usable, first, top, fused)
    else:
        _choose(gradients, usable, rule, first, top, fused)


@kernel
def _average_supported(
    gradients: Float32, noise: Float32, usable: Bool, first: int, top: int, fused: Float64
) -> None:
    # gradients of rows from `first` on, fused of rows from `top` on
    images, height, width = gradients.shape
    across = np.empty((height, width), np.float32)
    nearby = np.empty((images, len(fused), width), np.float32)
    for i in range(images):
        for y in range(height):
            own, most = np.abs(gradients[i, y]), across[y]
            most[:] = own
            for u in range(1, min(REACH_PX, width - 1) + 1):
                # slices, so that the compiler sees that no index is negative
                left, right, before, after = most[: width - u], most[u:], own[: width - u], own[u:]
                for x in range(width - u):
                    left[x] = max(left[x], after[x])
                for x in range(width - u):
                    right[x] = max(right[x], before[x])
        for y in range(len(fused)):
            here = y + top - first
            for x in range(width):
                nearby[i, y, x] = across[here, x]
            for v in range(max(here - REACH_PX, 0), min(here + REACH_PX + 1, height)):
                for x in range(width):
                    nearby[i, y, x] = max(nearby[i, y, x], across[v, x])
    for y in range(len(fused)):
        here = y + top - first
        for x in range(width):
            largest, runner_up, who, voices = np.float32(-1.0), np.float32(-1.0), -1, 0
            for i in range(images):
                if not usable[i, top + y, x]:
                    continue
                voices += 1
                size = nearby[i, y, x]
                if size > largest:
                    largest, runner_up, who = size, largest, i
                else:
                    runner_up = max(runner_up, size)
            total, kept = 0.0, 0
            for i in range(images):
                if not usable[i, top + y, x]:
                    continue
                others = runner_up if i == who else largest
                own = abs(gradients[i, here, x])
                # an image alone has nobody to ask
                if voices == 1 or others >= SUPPORT * own - NOISE_SLACK * noise[i, top + y, x]:
                    total += gradients[i, here, x]
                    kept += 1
            fused[y, x] = total / max(kept, 1)


@kernel
def _choose(gradients: Float32, usable: Bool, rule: int, first: int, top: int, fused: Float64) -> None:
    # gradients of rows from `first` on, fused of rows from `top` on: by value for the median, else by magnitude
    images, _, width = gradients.shape
    ordered = np.empty(images, np.float32)
    for y in range(len(fused)):
        for x in range(width):
            count = 0
            for i in range(images):
                if not usable[i, top + y, x]:
                    continue
                own = gradients[i, y + top - first, x]
                k = count
                while k > 0 and (ordered[k - 1] > own if rule == 1 else abs(ordered[k - 1]) > abs(own)):
                    ordered[k] = ordered[k - 1]
                    k -= 1
                ordered[k] = own
                count += 1
            if count == 0:
                fused[y, x] = 0.0
            elif rule == 1:
                fused[y, x] = 0.5 * (float(ordered[(count - 1) // 2]) + float(ordered[count // 2]))
            elif rule == 2:
                fused[y, x] = ordered[0]
            else:
                fused[y, x] = ordered[max(count - 2, 0)]


Gradients = list[Float64]
"""Differences to the pixel to the right, shape (H, W − 1), and to the one below, shape (H − 1, W)."""


@dataclass(frozen=True)
class Rule:
    """A rule of fusion for the images of a posture.

    Attributes
    ----------
    fusion
        As :func:`fuse_gradients` takes it.
    edges
        To the right, and to the pixel below.
    deviations
        Standard deviation of the images' noise, shape (images, H, W).
    """

    fusion: Fusion
    edges: tuple[Edges, Edges]
    deviations: Float32

    @staticmethod
    def of(weights: Float32, deviations: Float32, fusion: Fusion) -> Rule:
        """The rule for images of such weights and such noise, as :class:`Edges` has them."""
        return Rule(fusion, (Edges.of(weights, deviations, 1), Edges.of(weights, deviations, 0)), deviations)

    @property
    def unknown(self) -> list[Bool]:
        """Edges at which no image has a say."""
        return [edges.unknown for edges in self.edges]

    def fuse(self, images: Float32) -> Gradients:
        """Gradients of the fused image, of images of shape (images, H, W)."""
        return [fuse_gradients(images, edges, fusion=self.fusion, threads=1) for edges in self.edges]

    def fuse_with_noise(self, images: Float32, rng: np.random.Generator) -> Gradients:
        """The same of images to which noise is added."""
        drawn = rng.standard_normal(images.shape, dtype=np.float32)
        drawn *= self.deviations
        drawn += images
        return self.fuse(drawn)


@dataclass(frozen=True)
class FusedGradients:
    """Gradients of a fused image, and what the prediction tells of them.

    Attributes
    ----------
    fused
        As the rule has them.
    missing
        Shading of the good part that they lack where an image has no say.
    bias
        What noise makes of them beside scatter.
    """

    fused: Gradients
    missing: Gradients
    bias: Gradients

    @staticmethod
    def alone(fused: Gradients) -> FusedGradients:
        """Gradients of which nothing is known from a prediction."""
        return FusedGradients(fused, *([np.zeros(g.shape) for g in fused] for _ in range(2)))


def fuse_beside(
    rule: Rule, levels: Float32, diffuse: Float32, *, draws: int, seed: int, threads: int | None = None
) -> FusedGradients:
    """Fuse the gradients of images beside those of the good part.

    Parameters
    ----------
    rule
        For these images.
    levels, diffuse
        Of the images and of the good part, predicted highlights taken off [grey level], shape (images, H, W).
    draws
        How many times noise is added to the good part's to find the bias; 0 for a bias of 0.
    seed
        Of that noise.
    threads
        Number of threads; the result does not depend on it.
    """
    lit = (diffuse >= LIT * rule.deviations).astype(np.float32)
    works = [
        partial(rule.fuse, levels),
        partial(rule.fuse, diffuse),
        lambda: Rule.of(lit, rule.deviations, rule.fusion).fuse(diffuse),
        # each draw has random numbers of its own, so that their order does not matter
        *(partial(rule.fuse_with_noise, diffuse, np.random.default_rng((seed, 0, i))) for i in range(draws)),
    ]
    fused, here, everywhere, *drawn = in_threads(lambda number: works[number](), range(len(works)), threads)
    missing = [a - b for a, b in zip(everywhere, here, strict=True)]
    if not draws:
        return FusedGradients(fused, missing, [np.zeros(h.shape) for h in here])
    bias = [sum(many) / draws - h for *many, h in zip(*drawn, here, strict=True)]
    return FusedGradients(fused, missing, bias)
