"""The gradients of a posture's images fused, and what the prediction tells of those that the rule gets wrong."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lightopt.core.threads import in_threads
from lightopt.inspection._fusion import Edges, Fusion, fuse_gradients
from lightopt.inspection._pixel_weights import LIT

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
Gradients = list[Float64]
"""Differences to the pixel to the right, shape (H, W − 1), and to the one below, shape (H − 1, W)."""


@dataclass(frozen=True)
class Rule:
    """A rule of fusion for the images of a posture.

    Attributes
    ----------
    fusion
        As :func:`lightopt.inspection._fusion.fuse_gradients` takes it.
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
