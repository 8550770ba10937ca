"""Visibility bits: which defects the image of a light position shows at which patch.

Bit t % 64 of word t // 64 of a patch is hypothesis t. Patches are addressed by their index in the refined mesh of the
run (:class:`lightopt.rendering.PatchTable`), which is refined once for all postures: the same index is the same patch
in every posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64, Int32, Int64, read_only
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.design.responses._defect_hypotheses import DefectHypothesis
from lightopt.design.responses._packed_bits import Words, add_image, word_weight


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """Which (patch, hypothesis) the image of each light position shows, in one posture, at one exposure.

    words: One array per light, in the rig's order: bits of the visible hypotheses, shape (candidates of the light, p,
        ⌈t / 64⌉).
    areas: Of the inspectable patches [mm²], shape (p,).
    patch: Their indices among the patches of the run, ascending, shape (p,).
    grazing: Indices of the patches seen at a grazing angle, which are excluded, ascending.
    """

    hypotheses: tuple[DefectHypothesis, ...]
    words: tuple[Words, ...]
    areas: Float64
    patch: Int32
    grazing: Int32
    exposure: float = 1.0

    def __post_init__(self) -> None:
        shape = len(self.areas), -(-len(self.hypotheses) // 64)
        for index, layer in enumerate(self.words):
            if layer.ndim != 3 or layer.shape[1:] != shape or layer.dtype != np.uint64:
                raise InputError(
                    f"visibility: light {index}: expected uint64 of shape (candidates, {shape[0]}, {shape[1]}), "
                    f"found {layer.dtype} {layer.shape}"
                )
        for name in ("areas", "patch"):
            array = getattr(self, name)
            if array.shape != shape[:1]:
                raise InputError(f"visibility: {name}: expected shape ({shape[0]},), found {array.shape}")
            object.__setattr__(self, name, read_only(array))
        object.__setattr__(self, "words", tuple(map(read_only, self.words)))

    @cached_property
    def planes(self) -> tuple[Words, Int64]:
        """The hypotheses' weights in binary: see :func:`weight_planes`."""
        return weight_planes(self.hypotheses)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of candidates of each light."""
        return tuple(len(layer) for layer in self.words)

    @property
    def total_weight(self) -> int:
        return sum(hypothesis.weight for hypothesis in self.hypotheses)

    def rows(self, rows: Sequence[Int64]) -> Visibility:
        """Some candidates of each light, given by ascending indices."""
        words = tuple(select_rows(layer, some) for layer, some in zip(self.words, rows, strict=True))
        return replace(self, words=words)

    def patches(self, start: int, end: int) -> Visibility:
        return replace(
            self,
            words=tuple(layer[:, start:end] for layer in self.words),
            areas=self.areas[start:end],
            patch=self.patch[start:end],
        )

    def seen(self, candidates: Sequence[int], least: int) -> Words:
        """What at least `least` images show with one position of each light, shape (p, ⌈t / 64⌉)."""
        return self._at_least([layer[k] for layer, k in zip(self.words, candidates, strict=True)], least)

    def reachable(self, least: int) -> Words:
        """What at least `least` images show if each light takes, for each hypothesis, the position that shows it."""
        return self._at_least([np.bitwise_or.reduce(layer, axis=0) for layer in self.words], least)

    def weights(self, seen: Words) -> Int64:
        """Sum of the weights of the hypotheses whose bits are set, shape (p,)."""
        return weighted_bits(seen, *self.planes)

    def _at_least(self, images: Sequence[Words], least: int) -> Words:
        counters = np.zeros((max(1, least), len(self.areas), images[0].shape[1]), np.uint64)
        for image in images:
            add_image(counters, image)
        return counters[-1]


def select_rows(layer: Any, some: Int64) -> Any:
    """Some rows of an array, ascending; a contiguous range without a copy."""
    if len(some) and some[-1] - some[0] == len(some) - 1:
        return layer[some[0] : some[-1] + 1]
    return layer[some]


def weight_planes(hypotheses: Sequence[DefectHypothesis]) -> tuple[Words, Int64]:
    """The hypotheses' weights in binary: masks of the hypotheses that have a bit, and the value of that bit.

    Returns masks, shape (planes, ⌈t / 64⌉), and factors, shape (planes,), powers of two; bits that no weight has are
    omitted.
    """
    masks: list[Words] = []
    factors: list[int] = []
    for bit in range(max(hypothesis.weight for hypothesis in hypotheses).bit_length()):
        mask = np.zeros(-(-len(hypotheses) // 64), np.uint64)
        for index, hypothesis in enumerate(hypotheses):
            if hypothesis.weight >> bit & 1:
                mask[index // 64] |= np.uint64(1 << index % 64)
        if mask.any():
            masks.append(mask)
            factors.append(1 << bit)
    return np.stack(masks), np.array(factors, np.int64)


@kernel
def weighted_bits(words: Words, masks: Words, factors: Int64) -> Int64:
    """Sum of the weights of the hypotheses whose bits are set, of each row of words, shape (p,)."""
    sums = np.zeros(len(words), np.int64)
    for p in range(len(words)):
        for w in range(words.shape[1]):
            if words[p, w]:
                sums[p] += word_weight(words[p, w], w, masks, factors)
    return sums
