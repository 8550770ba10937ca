"""Visibility bits: which defects the image of a light position shows at which patch.

Bit t % 64 of word t // 64 of a patch is trial t. Patches are addressed by their index in the refined mesh of the run
(:class:`lightopt.rendering.PatchTable`), which is refined once for all postures: the same index is the same patch in
every posture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.design.responses._defect_hypotheses import Trial
from lightopt.design.responses._packed_bits import Words, add_image, word_weight

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Visibility:
    """Which (patch, trial) the image of each light position shows, in one posture, at one exposure.

    Attributes
    ----------
    trials
        The defects, t of them.
    words
        One array per light, in the rig's order: bits of the trials that are visible, shape (candidates of the light,
        p, ⌈t / 64⌉).
    areas
        Of the inspectable patches [mm²], shape (p,).
    patch
        Their indices among the patches of the run, ascending, shape (p,).
    grazing
        Indices of the patches that the camera sees at a grazing angle, which are left out, ascending.
    exposure
        That the images are taken with.
    """

    trials: tuple[Trial, ...]
    words: tuple[Words, ...]
    areas: Float64
    patch: NDArray[np.int32]
    grazing: NDArray[np.int32]
    exposure: float = 1.0
    planes: tuple[Words, Int64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        shape = len(self.areas), -(-len(self.trials) // 64)
        for index, layer in enumerate(self.words):
            if layer.ndim != 3 or layer.shape[1:] != shape or layer.dtype != np.uint64:
                raise InputError(
                    f"visibility: light {index}: expected uint64 of shape (candidates, {shape[0]}, {shape[1]}), "
                    f"found {layer.dtype} {layer.shape}"
                )
        for name in ("areas", "patch"):
            array = getattr(self, name).view()
            if array.shape != shape[:1]:
                raise InputError(f"visibility: {name}: expected shape ({shape[0]},), found {array.shape}")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        frozen = tuple(layer.view() for layer in self.words)
        for layer in frozen:
            layer.flags.writeable = False
        object.__setattr__(self, "words", frozen)
        object.__setattr__(self, "planes", trial_planes(self.trials))

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of candidates of each light."""
        return tuple(len(layer) for layer in self.words)

    @property
    def total_weight(self) -> int:
        """Sum of the trials' weights."""
        return sum(trial.weight for trial in self.trials)

    def rows(self, rows: Sequence[Int64]) -> Visibility:
        """Some candidates of each light, ascending."""
        words = tuple(taken_rows(layer, some) for layer, some in zip(self.words, rows, strict=True))
        return replace(self, words=words)

    def patches(self, start: int, end: int) -> Visibility:
        """The patches from `start` to `end`."""
        return replace(
            self,
            words=tuple(layer[:, start:end] for layer in self.words),
            areas=self.areas[start:end],
            patch=self.patch[start:end],
        )

    def seen(self, candidates: Sequence[int], least: int) -> Words:
        """What at least `least` images show of one position of each light, shape (p, ⌈t / 64⌉)."""
        return self._at_least([layer[k] for layer, k in zip(self.words, candidates, strict=True)], least)

    def reachable(self, least: int) -> Words:
        """What at least `least` images show where each light takes the position that shows it, whatever the others."""
        return self._at_least([np.bitwise_or.reduce(layer, axis=0) for layer in self.words], least)

    def weights(self, seen: Words) -> Int64:
        """Sum of the weights of the trials whose bits are set, shape (p,)."""
        return weighted_bits(seen, *self.planes)

    def _at_least(self, images: Sequence[Words], least: int) -> Words:
        counters = np.zeros((max(1, least), len(self.areas), images[0].shape[1]), np.uint64)
        for image in images:
            add_image(counters, image)
        return counters[-1]


def taken_rows(layer: Any, some: Int64) -> Any:
    """Some rows of an array, ascending; neighbours without a copy."""
    if len(some) and some[-1] - some[0] == len(some) - 1:
        return layer[some[0] : some[-1] + 1]
    return layer[some]


def trial_planes(trials: Sequence[Trial]) -> tuple[Words, Int64]:
    """The trials' weights in binary: masks of the trials that have a bit of it, and what that bit is worth.

    Returns
    -------
    masks, factors
        Shapes (planes, ⌈t / 64⌉) and (planes,), powers of two; bits that no weight has are left out.
    """
    masks: list[Words] = []
    factors: list[int] = []
    for bit in range(max(trial.weight for trial in trials).bit_length()):
        mask = np.zeros(-(-len(trials) // 64), np.uint64)
        for index, trial in enumerate(trials):
            if trial.weight >> bit & 1:
                mask[index // 64] |= np.uint64(1 << index % 64)
        if mask.any():
            masks.append(mask)
            factors.append(1 << bit)
    return np.stack(masks), np.array(factors, np.int64)


@kernel
def weighted_bits(words: Words, masks: Words, factors: Int64) -> Int64:
    """Sum of the weights of the trials whose bits are set, of each row of words, shape (p,)."""
    sums = np.zeros(len(words), np.int64)
    for p in range(len(words)):
        for w in range(words.shape[1]):
            if words[p, w]:
                sums[p] += word_weight(words[p, w], w, masks, factors)
    return sums
