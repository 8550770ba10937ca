"""Objective ``paper``: the sum of the middle levels that are neither shaded nor specular (paper, section 5.2).

Of each patch's levels under the n lights the highest and the lowest are dropped (step 3); of the n − 2 that remain,
those below the shade threshold and those at saturation count as zero (step 4); the sum over all patches is the score
(step 5). What is summed is light: the part of a level above the sensor's black level (the paper's camera has none).

All combinations at once, by algebra. Let ``x_1 ≤ … ≤ x_n`` be a patch's levels above black, h(x) the usable level (x,
or 0 where it is not usable), and E_m the sum of h(min) over all sets of m lights. The least of a set of m is x_j in
C(n − j, m − 1) of the sets, so that

    E_m = Σ_j C(n − j, m − 1) · h(x_j),    and    h(x_2) + … + h(x_{n−1}) = Σ_m c_m · E_m,
    c_{m+1} = Σ_{k=0..m} (−1)^{m−k} · C(m, k) · t_k,    t_k = 1 for 1 ≤ k ≤ n − 2, else 0.

For four lights that is E_2 − E_3: six tables of pairs and four of triples instead of a table of quadruples. For every
even n the term of all n lights cancels likewise. There are 2ⁿ sets: with many lights, or few candidates,

    h(x_2) + … + h(x_{n−1}) = Σ_l h(level under light l) − h(x_1) − h(x_n)

is the cheaper way, in which lights with one candidate only are read once. The way that reads fewer levels is taken.

Kernels work on *capped* levels: 0 where they are shaded, else what is above black, at most the saturation level above
black. The usable part of a capped level is the level itself, or 0 where it is at the cap.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from lightopt.core.arrays import Float64, Int64
from lightopt.core.errors import counted
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import Task, blocks, run_all
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import (
    Levels,
    LevelThresholds,
    LuminanceMatrix,
    level_range,
    usable_sums,
)

BLOCK_LEVELS = 1 << 24  # levels that are capped at once: the only copies of levels that are made
LEAST_PATCHES = 512  # of a block, however many candidates there are

# looking at the least and the greatest level of a combination takes about as long as that many tables of minima
DIRECT_COST = 2.5

MOST_LIGHTS_IN_SETS = 16  # of more lights there are too many sets


@dataclass(frozen=True)
class PaperObjective(Objective):
    name: str = "paper"
    unit: str = "sensor level"
    share_of: str | None = None

    @property
    def meaning(self) -> str:
        return "sum over all patches of the usable levels, without the highest and the lowest level of each patch"

    def format_score(self, score: int, grain: float) -> str:
        """A plain number: sums of levels have no other unit."""
        del grain
        return f"{score:,}"

    def full_score(self, area: int) -> int | None:
        del area

    def refusal(self, lights: int) -> str | None:
        """Dropping the highest and the lowest of two leaves nothing."""
        if lights > 2:
            return None
        left = f"with {counted(lights, 'light')} nothing is left; expected at least 3 lights"
        return f"objective paper drops each patch's highest and lowest level, and {left}"

    def weights(self, areas: Float64) -> Int64:
        """Every patch counts the same, as every polygon does in the paper."""
        return np.ones(len(areas), np.int64)

    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """Sort, drop the ends, zero what is not usable, sum."""
        middle = np.sort(np.concatenate(matrix.levels), axis=0)[1:-1].astype(np.int64)
        usable = (middle >= thresholds.shade) & (middle < thresholds.saturation)
        return int(((middle - thresholds.black) * usable * weights).sum())

    def scores(
        self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds, threads: int, progress: Share | None
    ) -> Int64:
        """By tables of minima or combination by combination; `weights` are those of :meth:`weights`, all 1."""
        levels = matrix.levels
        sizes = [len(layer) for layer in levels]
        tables = _tables(sizes)
        cells, patches = math.prod(sizes), levels[0].shape[1]
        by_sets = sum(table.size for _, _, table in tables)
        work = WorkCounter((by_sets or cells) * patches, progress)
        lock = Lock()
        result = np.zeros(cells, np.int64)
        most, black = int(np.iinfo(levels[0].dtype).max), levels[0].dtype.type(thresholds.black)
        top, cap = min(thresholds.saturation - thresholds.black - 1, most), min(thresholds.saturation, most)

        def tasks() -> Iterator[Task]:
            for start, end in blocks(patches, max(LEAST_PATCHES, BLOCK_LEVELS // sum(sizes))):
                here = (layer[:, start:end] for layer in levels)
                capped = [(np.minimum(some, cap) - black) * (some >= thresholds.shade) for some in here]
                greatest = [layer.max(axis=0) for layer in capped] if tables else []
                for chosen, _, table in tables:
                    layers, reach = ([some[i] for i in chosen] for some in (capped, greatest))
                    yield from minimum_tasks(layers, reach, top, table, lock, work)
                if not tables:
                    yield from extreme_tasks(capped, top, result, lock, work)

        run_all(tasks(), threads=threads, done=work.report)
        if not tables:
            usable = np.zeros(1, np.int64)
            for layer in levels:
                usable = np.add.outer(usable, usable_sums(layer, weights, thresholds)).ravel()
            return usable - result
        grid = result.reshape(sizes)
        for chosen, coefficient, table in tables:
            grid += coefficient * table[tuple(slice(None) if i in chosen else None for i in range(len(sizes)))]
        return result

    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """The lesser of two limits of each patch: its n − 2 largest usable levels, and its middle greatest levels.

        The second holds since the j-th level of any combination is at most the j-th of the lights' greatest levels.
        """
        del weights  # all 1
        levels, total, black = matrix.levels, 0, thresholds.black
        for start, end in blocks(levels[0].shape[1], max(1, BLOCK_LEVELS // len(levels))):
            some = [level_range(layer, thresholds.shade, thresholds.saturation, start, end) for layer in levels]
            usable = np.sort([np.maximum(most_usable - black, 0) for most_usable, _, _ in some], axis=0)[2:]
            greatest = np.sort([most for _, most, _ in some], axis=0)[1:-1]
            lit = np.minimum(greatest, thresholds.saturation - 1) - black
            middle = np.where(greatest >= thresholds.shade, lit, 0)
            total += int(np.minimum(usable.sum(axis=0), middle.sum(axis=0)).sum())
        return total


def _tables(sizes: Sequence[int]) -> list[tuple[tuple[int, ...], int, Int64]]:
    # sets of lights, their coefficients and tables; none where the combinations themselves read fewer levels
    lights = len(sizes)
    if lights > MOST_LIGHTS_IN_SETS:
        return []
    counted = [(count, c) for count, c in enumerate(_coefficients(lights), start=1) if c]
    sets = [(chosen, c) for count, c in counted for chosen in itertools.combinations(range(lights), count)]
    if sum(math.prod(sizes[i] for i in chosen) for chosen, _ in sets) > DIRECT_COST * math.prod(sizes):
        return []
    return [(chosen, c, np.zeros(tuple(sizes[i] for i in chosen), np.int64)) for chosen, c in sets]


def _coefficients(lights: int) -> list[int]:
    # c_1 … c_n of the module's text
    counts = [int(1 <= k <= lights - 2) for k in range(lights)]
    return [sum((-1) ** (m - k) * math.comb(m, k) * counts[k] for k in range(m + 1)) for m in range(lights)]


PAPER = PaperObjective()


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
    layers = sorted(layers, key=lambda layer: len(layer) > 1)  # those that stand still first: they are compared once
    sizes = np.array([len(layer) for layer in layers], np.int64)
    offset = np.cumsum(sizes) - sizes
    rows = np.concatenate(layers)
    limit, most = dtype.type(top), np.iinfo(dtype).max

    def add(start: int, end: int) -> None:
        sums = np.zeros(end - start, np.int64)
        _walk(rows, offset, sizes, most, limit, start, sums)
        with lock:
            table[start:end] += sums
        work.add(len(sums) * patches)

    for piece in blocks(len(table), max(1, WALK_LEVELS // max(1, patches))):
        yield add, piece


@kernel
def _walk(rows: Levels, offset: Int64, sizes: Int64, most: int, top: int, begin: int, sums: Int64) -> None:
    lights, patches = len(sizes), rows.shape[1]
    # least and greatest level under the first k lights
    lows = np.empty((lights, CACHE_PATCHES), rows.dtype)
    highs = np.empty((lights, CACHE_PATCHES), rows.dtype)
    digits = np.empty(lights, np.int64)
    for start in range(0, patches, CACHE_PATCHES):
        end = min(start + CACHE_PATCHES, patches)
        n = end - start
        lows[0, :n], highs[0, :n] = most, 0
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
