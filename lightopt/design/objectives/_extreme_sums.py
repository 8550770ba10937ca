"""Sums over patches of the usable level of the least and of the greatest level, combination by combination.

For many lights with few candidates: combinations are walked in order, and what the lights before the one that changes
have in common is kept. Levels are capped as in :mod:`lightopt.design.objectives._minimum_sums`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from lightopt.core.kernels import kernel
from lightopt.core.progress import Work, pieces
from lightopt.core.threads import Task
from lightopt.design.objectives._minimum_sums import CACHE_PATCHES
from lightopt.design.responses._luminance_matrix import Levels

Int64 = NDArray[np.int64]

TASK_LEVELS = 500_000_000
"""Levels that a task looks at, at most: less than 0.1 s of a thread, so that Ctrl-C is heard."""


def extreme_tasks(layers: Sequence[Levels], top: int, table: Int64, lock: Lock, work: Work) -> Iterator[Task]:
    """Tasks that add Σ over patches of usable(min) + usable(max) of the levels under all lights, for each combination.

    Parameters
    ----------
    layers
        Capped levels, shape (candidates, p), all of one type.
    top
        The highest usable capped level.
    table
        One number per combination, the last light's candidates varying fastest.
    lock
        Held while the table is changed.
    work
        Counts combinations times patches.
    """
    patches, dtype = layers[0].shape[1], layers[0].dtype
    low = np.full(patches, np.iinfo(dtype).max, dtype)
    high = np.zeros(patches, dtype)
    moving = [layer for layer in layers if len(layer) > 1] or [layers[0]]
    for layer in layers:
        if len(layer) == 1:
            np.minimum(low, layer[0], out=low)
            np.maximum(high, layer[0], out=high)
    sizes = np.array([len(layer) for layer in moving], np.int64)
    offset = np.cumsum(sizes) - sizes
    rows = np.concatenate(moving)
    limit = dtype.type(top)

    def add(start: int, end: int) -> None:
        sums = np.zeros(end - start, np.int64)
        _walk(rows, offset, sizes, low, high, limit, start, sums)
        with lock:
            table[start:end] += sums
        work.add(len(sums) * patches)

    for piece in pieces(len(table), max(1, TASK_LEVELS // max(1, patches))):
        yield add, piece


@kernel
def _walk(
    rows: Levels, offset: Int64, sizes: Int64, low: Levels, high: Levels, top: int, begin: int, sums: Int64
) -> None:
    lights, patches = len(sizes), rows.shape[1]
    # least and greatest level under the lights that stand still and the first k of those that move
    lows = np.empty((lights, CACHE_PATCHES), rows.dtype)
    highs = np.empty((lights, CACHE_PATCHES), rows.dtype)
    digits = np.empty(lights, np.int64)
    for start in range(0, patches, CACHE_PATCHES):
        end = min(start + CACHE_PATCHES, patches)
        n = end - start
        lows[0, :n] = low[start:end]
        highs[0, :n] = high[start:end]
        rest = begin
        for k in range(lights - 1, -1, -1):
            digits[k] = rest % sizes[k]
            rest //= sizes[k]
        changed = 0
        for cell in range(len(sums)):
            for k in range(changed, lights - 1):
                row = rows[offset[k] + digits[k], start:end]
                _extremes(lows[k, :n], highs[k, :n], row, lows[k + 1, :n], highs[k + 1, :n])
            row = rows[offset[lights - 1] + digits[lights - 1], start:end]
            sums[cell] += _ends(lows[lights - 1, :n], highs[lights - 1, :n], row, top)
            changed = lights - 1
            digits[changed] += 1
            while changed > 0 and digits[changed] == sizes[changed]:
                digits[changed] = 0
                changed -= 1
                digits[changed] += 1


@kernel
def _extremes(low: Levels, high: Levels, row: Levels, lower: Levels, higher: Levels) -> None:
    for i in range(len(row)):
        lower[i] = low[i] if low[i] < row[i] else row[i]
        higher[i] = high[i] if high[i] > row[i] else row[i]


@kernel
def _ends(low: Levels, high: Levels, row: Levels, top: int) -> np.int64:
    total = np.uint32(0)
    for i in range(len(row)):
        least = low[i] if low[i] < row[i] else row[i]
        greatest = high[i] if high[i] > row[i] else row[i]
        total = np.uint32(total + np.uint32(least if least <= top else 0))
        total = np.uint32(total + np.uint32(greatest if greatest <= top else 0))
    return np.int64(total)
