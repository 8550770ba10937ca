"""Sums over patches of the usable part of the least, or of least and greatest, levels under lights, for all candidates.

Levels are *capped*: 0 where they are shaded, else what is above black, at most the saturation level above black. The
usable part of a capped level is the level itself, or 0 where it is at the cap.
"""

import itertools
from collections.abc import Iterator, Sequence
from threading import Lock

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.kernels import kernel
from lightopt.core.run_context import WorkCounter
from lightopt.core.threads import Task, blocks
from lightopt.design.responses._luminance_matrix import Levels

# patches that a kernel works on at once: the rows of one light stay in the second-level cache, and 32 bits hold the sum
# of twice as many 16-bit levels
CACHE_PATCHES = 8192

# levels that a task of minima reads, at most: some 0.1 s of a thread, so that Ctrl-C is heard
TASK_LEVELS = 2_000_000_000

# levels that a task of least and greatest levels reads, at most: less than 0.1 s, so that Ctrl-C is heard
WALK_LEVELS = 500_000_000


def minimum_tasks(
    layers: Sequence[Levels], greatest: Sequence[Levels], top: int, table: Int64, lock: Lock, work: WorkCounter
) -> Iterator[Task]:
    """Tasks that add Σ over patches of usable(min(levels under k ≥ 2 lights)) to a table with one axis per light.

    layers, greatest: Capped levels of each light, shape (candidates, p), and the greatest over its candidates, shape
        (p,).
    top: The highest usable capped level.
    lock: Held while the table changes.
    work: Counts combinations times patches.
    """
    # a patch that one of the lights never reaches adds nothing; at the cap the least level is only where all can be
    reach = np.minimum.reduce(greatest)
    work.add(table.size * np.count_nonzero(reach == 0))
    for chosen, cut in (((reach > 0) & (reach <= top), False), (reach > top, True)):
        count = int(np.count_nonzero(chosen))
        if count:
            some = [layer if count == len(chosen) else layer.compress(chosen, axis=1) for layer in layers]
            yield from _tasks(some, top, cut, table, lock, work)


def _tasks(
    layers: Sequence[Levels], top: int, cut: bool, table: Int64, lock: Lock, work: WorkCounter
) -> Iterator[Task]:
    patches = layers[0].shape[1]
    if len(layers) == 2:
        least = np.full((1, patches), np.iinfo(layers[0].dtype).max, layers[0].dtype)
        layers = [least, *layers]
        table = table[None]
    *outer, first, second, third = layers
    limit = first.dtype.type(top)

    def add(prefix: tuple[int, ...], a: tuple[int, int], b: tuple[int, int]) -> None:
        part = [first[slice(*a)], second[slice(*b)], third]
        if prefix:
            least = np.minimum.reduce([layer[i] for layer, i in zip(outer, prefix, strict=True)])
            lit = least > 0
            if 2 * np.count_nonzero(lit) < len(lit):
                part, least = [layer.compress(lit, axis=1) for layer in part], least[lit]
            part[0] = np.minimum(part[0], least)
        sums = _three(*part, limit, cut)
        with lock:
            table[(*prefix, slice(*a), slice(*b))] += sums
        work.add(sums.size * patches)

    rows = max(1, TASK_LEVELS // (len(third) * patches))
    for prefix in itertools.product(*(range(len(layer)) for layer in outer)):
        for a in blocks(len(first), max(1, rows // len(second))):
            for b in blocks(len(second), rows):
                yield add, (prefix, a, b)


@kernel
def _three(first: Levels, second: Levels, third: Levels, top: int, cut: bool) -> Int64:
    sums = np.zeros((len(first), len(second), len(third)), np.int64)
    least = np.empty(CACHE_PATCHES, first.dtype)
    patches = first.shape[1]
    for start in range(0, patches, CACHE_PATCHES):
        end = min(start + CACHE_PATCHES, patches)
        here = least[: end - start]
        for a in range(len(first)):
            for b in range(len(second)):
                _minima(first[a, start:end], second[b, start:end], here)
                for c in range(len(third)):
                    there = third[c, start:end]
                    sums[a, b, c] += _usable_minima(here, there, top) if cut else _sum_of_minima(here, there)
    return sums


# the loops over patches are functions of whole arrays: an index that could be negative would keep the compiler from
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


@kernel
def _usable_minima(left: Levels, right: Levels, top: int) -> np.int64:
    total = np.uint32(0)
    for i in range(len(left)):
        least = left[i] if left[i] < right[i] else right[i]
        total = np.uint32(total + np.uint32(least if least <= top else 0))
    return np.int64(total)


def extreme_tasks(layers: Sequence[Levels], top: int, table: Int64, lock: Lock, work: WorkCounter) -> Iterator[Task]:
    """Tasks that add Σ over patches of usable(min) + usable(max) of the levels under all lights, for each combination.

    The lights before the one that changes are not compared again. `layers` are capped levels, shape (candidates, p),
    all of one type; `table` has one number per combination, the last light's candidates varying fastest. The others are
    as for :func:`minimum_tasks`.
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

    for piece in blocks(len(table), max(1, WALK_LEVELS // max(1, patches))):
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
            sums[cell] += _usable_extremes(lows[lights - 1, :n], highs[lights - 1, :n], row, top)
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
def _usable_extremes(low: Levels, high: Levels, row: Levels, top: int) -> np.int64:
    total = np.uint32(0)
    for i in range(len(row)):
        least = low[i] if low[i] < row[i] else row[i]
        greatest = high[i] if high[i] > row[i] else row[i]
        total = np.uint32(total + np.uint32(least if least <= top else 0))
        total = np.uint32(total + np.uint32(greatest if greatest <= top else 0))
    return np.int64(total)
