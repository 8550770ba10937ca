"""In which combinations enough images show a defect: by runs of flags, or where those are many by packed bits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.run_context import Share, part_of
from lightopt.core.threads import blocks
from lightopt.design.objectives._bit_sums import bit_scores
from lightopt.design.objectives._count_runs import at_least, count_run_sums
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.responses._packed_bits import Words, unpack_flags

FLAG_BYTES = 1 << 27
"""Of the flags that the packed bits are given at once."""


def bit_run_scores(
    words: Sequence[Words],
    weights: Int64,
    planes: tuple[Words, Int64],
    hypothesis_weights: Int64,
    *,
    least: int,
    threads: int,
    progress: Share | None = None,
) -> Int64:
    """Σ weight of the patch · weight of the hypothesis · [shown in at least `least` images], for all combinations.

    words: One array per light: bits of the hypotheses, shape (candidates, p, ⌈t / 64⌉).
    weights: Of the patches, shape (p,).
    planes: The hypotheses' weights in binary, from :func:`lightopt.design.responses._visibility.weight_planes`.
    hypothesis_weights: The same as numbers, shape (t,).
    Returns one number per combination, the last light's candidates varying fastest.
    """
    (table,), left = count_run_sums(
        [layer[:, None] for layer in words],
        weights,
        planes,
        at_least(least)[None],
        threads=threads,
        progress=part_of(progress, 0.0, 0.9),
    )
    if left.any():
        table += _by_bits(
            words,
            np.flatnonzero(left),
            weights,
            hypothesis_weights,
            least,
            threads,
            part_of(progress, 0.9, 1.0),
        )
    return table


def _by_bits(
    words: Sequence[Words],
    some: Int64,
    weights: Int64,
    hypothesis_weights: Int64,
    least: int,
    threads: int,
    progress: Share | None,
) -> Int64:
    # each (patch, hypothesis) as a patch of its own, usable where it is visible and never saturated
    table = np.zeros(math.prod(len(layer) for layer in words), np.int64)
    positions, count = sum(len(layer) for layer in words), len(hypothesis_weights)
    parts = list(blocks(len(some), max(1, FLAG_BYTES // (positions * count))))
    for number, (start, end) in enumerate(parts):
        chosen = some[start:end]
        table += bit_scores(
            [unpack_flags(layer[:, chosen], count).reshape(len(layer), -1) for layer in words],
            np.arange(len(chosen) * count),
            np.outer(weights[chosen], hypothesis_weights).ravel(),
            LevelThresholds(shade=1, saturation=2),
            rule=(least, len(words)),
            threads=threads,
            progress=part_of(progress, number / len(parts), (number + 1) / len(parts)),
        )
    return table
