"""Scores that depend on classes of levels only, counted in packed bits: for patches whose classes change all the time.

64 patches share a word. Usable and saturated images are counted by saturating bit counters, light after light; the
weights of what is covered are added up bit by bit, each bit of the weights being a plane of words of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.optimize._matrix import Levels, Thresholds
from lightopt.optimize._packed import Words, common_bits, packed
from lightopt.rendering import run_all

__all__ = ["bit_scores"]

Int64 = NDArray[np.int64]


def bit_scores(
    levels: Sequence[Levels], weights: Int64, thresholds: Thresholds, *, rule: tuple[int, int], threads: int
) -> Int64:
    """As :func:`lightopt.optimize._runs.run_scores`, with the same parameters; at least two lights."""
    # heavy patches first, so that the planes of the high bits are short
    order = np.argsort(-weights, kind="stable")
    heavy = weights[order]
    usable = [
        packed((layer[:, order] >= thresholds.shade) & (layer[:, order] < thresholds.saturation))
        for layer in levels
    ]
    saturated = [packed(layer[:, order] >= thresholds.saturation) for layer in levels]
    bits = int(heavy.max(initial=0)).bit_length()
    planes = packed(np.stack([(heavy >> k) & 1 == 1 for k in range(max(1, bits))]))
    lengths = np.array([-(-int((heavy >= (1 << k)).sum()) // 64) for k in range(len(planes))], np.int64)
    shape = tuple(len(layer) for layer in levels)
    table = np.zeros(shape, np.int64)
    least, most = rule
    words = planes.shape[1]

    def fill(prefix: tuple[int, ...]) -> None:
        used = np.zeros((least, words), np.uint64)  # row k: usable in more than k images so far
        spoilt = np.zeros((most + 1, words), np.uint64)
        for light, candidate in enumerate(prefix):
            _count(used, usable[light][candidate])
            _count(spoilt, saturated[light][candidate])
        _last_two(
            used, spoilt, usable[-2], saturated[-2], usable[-1], saturated[-1], planes, lengths, table[prefix]
        )

    prefixes = itertools.product(*(range(n) for n in shape[:-2]))
    run_all(((fill, (prefix,)) for prefix in prefixes), threads=threads)
    return table


@kernel
def _count(counters: Words, more: Words) -> None:
    # row k says which patches were counted more than k times
    for w in range(counters.shape[1]):
        carry = more[w]
        for k in range(len(counters)):
            both = counters[k, w] & carry
            counters[k, w] |= carry
            carry = both


@kernel
def _last_two(
    used: Words,
    spoilt: Words,
    usable: Words,
    saturated: Words,
    last_usable: Words,
    last_saturated: Words,
    planes: Words,
    lengths: Int64,
    table: Int64,
) -> None:
    words = planes.shape[1]
    covered = np.empty(words, np.uint64)
    for c in range(len(usable)):
        use, spoil = used.copy(), spoilt.copy()
        _count(use, usable[c])
        _count(spoil, saturated[c])
        enough, too_many = use[-1], spoil[-1]
        almost, at_limit = _below(use, words), _below(spoil, words)
        for d in range(len(last_usable)):
            for w in range(words):
                covered[w] = (enough[w] | (almost[w] & last_usable[d, w])) & ~(
                    too_many[w] | (at_limit[w] & last_saturated[d, w])
                )
            total = 0
            for k in range(len(lengths)):
                total += common_bits(covered[: lengths[k]], planes[k, : lengths[k]]) << k
            table[c, d] = total


@kernel
def _below(counters: Words, words: int) -> Words:
    # patches that one more image carries over the counters' last row
    if len(counters) > 1:
        return counters[-2]
    return np.full(words, ~np.uint64(0), np.uint64)
