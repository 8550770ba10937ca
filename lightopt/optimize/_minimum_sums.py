"""Sums over patches of the least level under a set of lights, for all their candidates: tables of sums of minima."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.optimize._matrix import Levels
from lightopt.rendering import run_all

__all__ = ["minimum_sums"]

Int64 = NDArray[np.int64]

BLOCK_PATCHES = 8192
"""Patches that the kernel works on at once: the rows of one light stay in the second-level cache, and 32 bits hold the
sum of as many 16-bit levels."""

CHUNK_PATCHES = 1 << 16
"""Most patches of one task of a thread."""


def minimum_sums(layers: Sequence[Levels], *, threads: int) -> Int64:
    """Σ over patches of min(levels under k lights), for every combination of their candidates.

    Parameters
    ----------
    layers
        k ≥ 2 arrays of shape (candidates, p), all of one type.
    threads
        Number of threads; the sums are of integers and do not depend on it.

    Returns
    -------
    NDArray
        One axis per light.
    """
    shape = tuple(len(layer) for layer in layers)
    # a patch that one of the lights never reaches adds nothing
    reached = np.flatnonzero(np.logical_and.reduce([layer.max(axis=0, initial=0) > 0 for layer in layers]))
    if len(reached) < layers[0].shape[1]:
        layers = [layer.take(reached, axis=1) for layer in layers]
    if len(layers) == 2:
        least = np.full((1, layers[0].shape[1]), np.iinfo(layers[0].dtype).max, layers[0].dtype)
        layers = [least, *layers]
    *outer, first, second, third = layers
    table = np.zeros(tuple(len(layer) for layer in layers), np.int64)
    lock = Lock()

    def add(prefix: tuple[int, ...], piece: slice) -> None:
        part = [layer[:, piece] for layer in (first, second, third)]
        if prefix:
            least = np.minimum.reduce([layer[i, piece] for layer, i in zip(outer, prefix, strict=True)])
            lit = least > 0
            if 2 * np.count_nonzero(lit) < len(lit):
                part, least = [np.ascontiguousarray(layer[:, lit]) for layer in part], least[lit]
            part[0] = np.minimum(part[0], least)
        sums = _three(*part)
        with lock:
            table[prefix] += sums

    patches = first.shape[1]
    pieces = threads * -(-patches // (threads * CHUNK_PATCHES))
    ends = [patches * i // pieces for i in range(pieces + 1)] if pieces else [0]
    prefixes = itertools.product(*(range(len(layer)) for layer in outer))
    run_all(
        (
            (add, (prefix, slice(start, end)))
            for prefix in prefixes
            for start, end in itertools.pairwise(ends)
        ),
        threads=threads,
    )
    return table.reshape(shape)


@kernel
def _three(first: Levels, second: Levels, third: Levels) -> Int64:
    sums = np.zeros((len(first), len(second), len(third)), np.int64)
    least = np.empty(BLOCK_PATCHES, first.dtype)
    patches = first.shape[1]
    for start in range(0, patches, BLOCK_PATCHES):
        end = min(start + BLOCK_PATCHES, patches)
        here = least[: end - start]
        for a in range(len(first)):
            for b in range(len(second)):
                _minima(first[a, start:end], second[b, start:end], here)
                for c in range(len(third)):
                    sums[a, b, c] += _sum_of_minima(here, third[c, start:end])
    return sums


# the two loops over patches are functions of whole arrays: an index that could be negative would keep the compiler from
# taking many levels at a time


@kernel
def _minima(left: Levels, right: Levels, least: Levels) -> None:
    for i in range(len(left)):
        least[i] = left[i] if left[i] < right[i] else right[i]


@kernel
def _sum_of_minima(left: Levels, right: Levels) -> np.int64:
    # 32 bits are enough for a block, and twice as fast as 64
    total = np.uint32(0)
    for i in range(len(left)):
        least = left[i] if left[i] < right[i] else right[i]
        total = np.uint32(total + np.uint32(least))
    return np.int64(total)
