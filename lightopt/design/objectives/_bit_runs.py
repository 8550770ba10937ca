"""Which combinations' images show a defect often enough: by runs of flags, or where those are many by packed bits."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.core.progress import Share, part_of, pieces
from lightopt.design.objectives._bit_sums import bit_scores
from lightopt.design.objectives._count_runs import at_least, count_run_sums
from lightopt.design.responses._luminance_matrix import Thresholds
from lightopt.design.responses._packed_bits import Words

Int64 = NDArray[np.int64]

FLAG_BYTES = 1 << 27
"""Of the flags that the packed bits are given at once."""


def bit_run_scores(
    words: Sequence[Words],
    weights: Int64,
    planes: tuple[Words, Int64],
    trial_weights: Int64,
    *,
    least: int,
    threads: int,
    progress: Share | None = None,
) -> Int64:
    """Σ weight of the patch · weight of the trial · [shown in at least `least` images], for all combinations.

    Parameters
    ----------
    words
        One array per light: bits of the trials, shape (candidates, p, ⌈t / 64⌉).
    weights
        Of the patches, shape (p,).
    planes
        The trials' weights in binary, from :func:`lightopt.design.responses._visibility.trial_planes`.
    trial_weights
        The same as numbers, shape (t,).
    least
        Images that must show a defect, 1 or more.
    threads
        Number of threads; the sums do not depend on it.
    progress
        Called with the share that is done.

    Returns
    -------
    NDArray
        One number per combination, the last light's candidates varying fastest.
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
            words, np.flatnonzero(left), weights, trial_weights, least, threads, part_of(progress, 0.9, 1.0)
        )
    return table


def flags_of(words: Words, count: int) -> NDArray[np.uint8]:
    """Bits as flags 0 and 1: words of shape (…, ⌈t / 64⌉) to shape (…, t)."""
    octets = np.ascontiguousarray(words).astype("<u8", copy=False).view(np.uint8)
    return np.unpackbits(octets, axis=-1, bitorder="little")[..., :count]


def _by_bits(
    words: Sequence[Words],
    some: Int64,
    weights: Int64,
    trial_weights: Int64,
    least: int,
    threads: int,
    progress: Share | None,
) -> Int64:
    # each (patch, trial) as a patch of its own, usable where it is visible and never saturated
    table = np.zeros(math.prod(len(layer) for layer in words), np.int64)
    positions, count = sum(len(layer) for layer in words), len(trial_weights)
    parts = list(pieces(len(some), max(1, FLAG_BYTES // (positions * count))))
    for number, (start, end) in enumerate(parts):
        chosen = some[start:end]
        table += bit_scores(
            [flags_of(layer[:, chosen], count).reshape(len(layer), -1) for layer in words],
            np.arange(len(chosen) * count),
            np.outer(weights[chosen], trial_weights).ravel(),
            Thresholds(shade=1, saturation=2),
            rule=(least, len(words)),
            threads=threads,
            progress=part_of(progress, number / len(parts), (number + 1) / len(parts)),
        )
    return table
