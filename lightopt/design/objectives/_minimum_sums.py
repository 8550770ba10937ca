"""Sums over patches of the least usable level under a set of lights, for all their candidates: tables of minima.

Levels are *capped*: 0 where they are shaded, else what is above black, at most the saturation level above black. The
usable level of a capped one is itself, or 0 where it is at the cap.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from lightopt.core.kernels import kernel
from lightopt.core.progress import Work, pieces
from lightopt.core.threads import Task
from lightopt.design.responses._luminance_matrix import Levels

Int64 = NDArray[np.int64]

CACHE_PATCHES = 8192
"""Patches that a kernel works on at once: the rows of one light stay in the second-level cache, and 32 bits hold the
sum of twice as many 16-bit levels."""

TASK_LEVELS = 2_000_000_000
"""Levels that a task looks at, at most: some 0.1 s of a thread, so that Ctrl-C is heard."""


@dataclass(frozen=True, kw_only=True)
class Capped:
    """A light's capped levels of a block of patches.

    Attributes
    ----------
    levels
        Shape (candidates, p).
    lit, capped
        Which patches it reaches at all, and which it can bring to the cap; shape (p,).
    """

    levels: Levels
    lit: NDArray[np.bool_]
    capped: NDArray[np.bool_]

    @staticmethod
    def of(levels: Levels, top: int) -> Capped:
        """Levels with `top` as the highest usable one."""
        greatest = levels.max(axis=0)
        return Capped(levels=levels, lit=greatest > 0, capped=greatest > top)


def minimum_tasks(lights: Sequence[Capped], top: int, table: Int64, lock: Lock, work: Work) -> Iterator[Task]:
    """Tasks that add Σ over patches of usable(min(levels under k lights)) to a table, for every combination.

    Parameters
    ----------
    lights
        k ≥ 2.
    top
        The highest usable capped level.
    table
        One axis per light.
    lock
        Held while the table is changed.
    work
        Counts combinations times patches.
    """
    # a patch that one of the lights never reaches adds nothing; at the cap the least level is only where all can be
    lit = np.logical_and.reduce([light.lit for light in lights])
    capped = np.logical_and.reduce([light.capped for light in lights])
    work.add(table.size * np.count_nonzero(~lit))
    for chosen, cut in ((lit & ~capped, False), (capped, True)):
        count = int(np.count_nonzero(chosen))
        if count:
            layers = [
                light.levels if count == len(chosen) else light.levels.compress(chosen, axis=1)
                for light in lights
            ]
            yield from _tasks(layers, top, cut, table, lock, work)


def _tasks(
    layers: Sequence[Levels], top: int, cut: bool, table: Int64, lock: Lock, work: Work
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
        for a in pieces(len(first), max(1, rows // len(second))):
            for b in pieces(len(second), rows):
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
