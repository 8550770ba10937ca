"""Values of pairs of patch and defect by their units of evidence, for all combinations of light positions.

Along the candidates of a light the units of a pair change a few times. Let b_lj say that light l has more than j of
them, and v(n) be the value of n units. With the lights' units n_l,

    v(Σ n_l) = Σ over j_1, j_2, … of Δ(m, s) · Π_l [n_l ≥ j_l],
    Δ(m, s) = Σ_{i ≤ m} (−1)^i · binomial(m, i) · v(s − i),

m being how many of the j_l are above 0 and s their sum. With one unit per light and v(n) = [n ≥ 2] that is e₂ −
2·e₃ + 3·e₄ − … in elementary symmetric sums of the b_l. A product of m flags that rise or fall at places c_l is, in the
array of its mixed differences along the lights' candidates, ±1 at the place of those c_l, with 0 for the other lights
(:class:`Differences`). All defects of a patch are processed as one word: those that
rise at the same places cost no more than one. Lights with one candidate only shift v for the defects they show.

Pairs that all combinations cover, or none does, are decided beforehand: most of them. Patches where the units of the
others change nearly everywhere are added up combination by combination; the last light's positions share the sum of the
others.
"""

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from queue import Empty, SimpleQueue

import numpy as np

from lightopt.core.arrays import Bool, Int64, UInt64
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import available_processors, blocks, run_all
from lightopt.design.responses._pairs import Counts, PairWeights, Words, add_counts, add_units, word_weight

MOST_DIFFERENCES = 1 << 25  # most numbers in the arrays of all threads: 256 MiB


class Differences:
    """Arrays of mixed differences of `tables` tables over axes of `sizes`, one per thread on demand.

    Where a number c fills the box [a, b) × [a', b') × … of a table, the array of its mixed differences has ±c at the
    box's corners and 0 elsewhere. So a box costs a few numbers, however many cells it has; running sums complete the
    tables.

    workers: Threads that memory allows, at least 1.
    strides: Of the axes in a table as one row, shape (axes,).
    """

    def __init__(self, sizes: Sequence[int], threads: int, *, tables: int = 1) -> None:
        self._sizes = tuple(sizes)
        self._shape = tables, math.prod(sizes)
        self.workers = max(1, min(threads, MOST_DIFFERENCES // math.prod(self._shape)))
        self.strides: Int64 = np.array([math.prod(sizes[i + 1 :]) for i in range(len(sizes))], np.int64)
        self._free: SimpleQueue[Int64] = SimpleQueue()
        self._made: list[Int64] = []

    @contextmanager
    def borrowed(self) -> Generator[Int64, None, None]:
        """An array for differences that no other thread uses, shape (tables, cells)."""
        try:
            array = self._free.get_nowait()
        except Empty:
            array = np.zeros(self._shape, np.int64)
            self._made.append(array)
        yield array
        self._free.put(array)

    def summed(self) -> Int64:
        """The tables, shape (tables, cells), the last axis varying fastest; the arrays are consumed."""
        total = self._made[0] if self._made else np.zeros(self._shape, np.int64)
        for array in self._made[1:]:
            total += array
        for size, stride in zip(self._sizes, self.strides, strict=True):
            if size > 1:
                along = total.reshape(-1, size, int(stride))
                np.cumsum(along, axis=1, out=along)
        return total


CHUNK_PATCHES = 1 << 12  # patches of one task of a thread: some 0.01 s

# a word whose flags change at more places than this is left out; so is one with more than half as many as there are
# combinations, where trying them all takes about as long
MOST_NODES = 1 << 18

_TRIES_PER_NODE = 4  # of the last light's changes hardly more than a fourth goes with a product of the others
LEAST_NODES = 1 << 10  # however few combinations there are

# words that a task of plain additions reads, at most: some 0.1 s of a thread, so that Ctrl-C is heard
TASK_WORDS = 100_000_000

PositionCounts = UInt64  # units of every position of a light, shape (positions, k, p, words)

# of all lights in turn, level after level: places, hypotheses, signs (rise or fall); and where those of each level end
_Changes = tuple[Int64, Words, Int64, Int64]

# place in the table, hypotheses, sign, number of lights, sum of their levels
_Products = tuple[Int64, Words, Int64, Int64, Int64]


def combination_sums(
    lights: Sequence[PositionCounts],
    weights: PairWeights,
    needed: int,
    *,
    benefit: bool = True,
    threads: int | None = None,
    progress: Share | None = None,
) -> tuple[Int64, Int64]:
    """Covered weight and benefit of every combination of positions, the last light's varying fastest.

    needed: Units of a pair that is covered.
    benefit: Whether Σ weight · min(needed, units) is computed, too; else the covered weight stands for it.
    """
    count = threads or available_processors()
    units = np.arange(needed + 1, dtype=np.int64)
    values = np.stack([units // needed, units][: 2 if benefit and needed > 1 else 1])
    least, most = (
        weights.sum_counts((reduced(positions, axis=0) for positions in lights), needed)
        for reduced in (np.bitwise_and.reduce, np.bitwise_or.reduce)
    )
    always, undecided = weights.sum_of(least[-1]), most[0 if benefit else -1] & ~least[-1]
    tables, left = _count_run_sums(lights, undecided, weights, values, count, progress)
    covered, each = tables[0], tables[-1]  # where one unit is needed both are the same
    if left.any():
        some = [positions[:, :, left] & undecided[left] for positions in lights]
        plain = _added_up(some, weights.of(left), needed, count, progress)
        # not in place
        covered, each = covered + plain[0], each + plain[1 if benefit else 0]
    return covered + always, each + always * (needed if benefit else 1)


def _added_up(
    lights: Sequence[PositionCounts], weights: PairWeights, needed: int, threads: int, progress: Share | None
) -> tuple[Int64, Int64]:
    sizes = [len(positions) for positions in lights]
    inner = math.prod(sizes[1:])
    patches = lights[0].shape[2]
    covers, benefits = np.zeros((sizes[0], inner), np.int64), np.zeros((sizes[0], inner), np.int64)
    step = max(1, TASK_WORDS // (inner * lights[0][0, :, 0].size))

    def of_first(first: int, start: int, end: int) -> None:
        own = weights.of(slice(start, end))
        some = [positions[:, :, start:end] for positions in (lights[0][first : first + 1], *lights[1:])]

        def add(light: int, so_far: Counts, at: int) -> int:
            # sums of the combinations of the lights from `light` on, written from `at` on; where the next ones go
            if light < len(some) - 1:
                for positions in some[light]:
                    at = add(light + 1, add_counts(so_far, positions), at)
                return at
            here = slice(at, at + len(some[light]))
            planes, sums = (own.masks, own.factors), (covers[first, here], benefits[first, here])
            _last(so_far, some[light], own.areas, planes, sums)
            return here.stop

        add(0, own.zero_counts(needed), 0)

    for start in range(0, patches, step):
        # a row of the tables is written by one task at a time
        tasks = ((of_first, (first, start, min(start + step, patches))) for first in range(sizes[0]))
        run_all(tasks, threads=threads, done=None if progress is None else lambda: progress(1.0))
    return covers.ravel(), benefits.ravel()


@kernel
def _last(
    counts: Counts, positions: PositionCounts, areas: Int64, planes: tuple[Words, Int64], sums: tuple[Int64, Int64]
) -> None:
    (masks, factors), (covered, benefit) = planes, sums
    k, own = counts.shape[0], positions.shape[1]
    for c in range(len(positions)):
        for p in range(counts.shape[1]):
            most, each = np.int64(0), np.int64(0)
            for w in range(counts.shape[2]):
                for level in range(k):
                    flags = counts[level, p, w]
                    if level < own:
                        flags |= positions[c, level, p, w]
                    for low in range(max(0, level - own), level):
                        flags |= counts[low, p, w] & positions[c, level - 1 - low, p, w]
                    if flags:
                        value = word_weight(flags, w, masks, factors)
                        each += value
                        if level == k - 1:
                            most += value
            covered[c] += areas[p] * most
            benefit[c] += areas[p] * each


def _count_run_sums(
    counts: Sequence[PositionCounts],
    undecided: Words,
    weights: PairWeights,
    values: Int64,
    threads: int,
    progress: Share | None,
) -> tuple[Int64, Bool]:
    """Σ weight of the pair · value of its units of evidence over undecided pairs, for all combinations.

    undecided: Shape (p, words).
    values: Of 0, 1, … units; more than the last have its value. One row per table, shape (v, n + 1).
    Returns tables: Shape (v, combinations), the last light's candidates varying fastest.
    Returns left: Patches that the tables omit since their flags change at too many places, shape (p,).
    """
    sizes = [len(layer) for layer in counts]
    fixed = [layer for layer in counts if len(layer) == 1]
    moving = [layer for layer in counts if len(layer) > 1]
    patches, width = counts[0].shape[2:]
    most_images, levels = values.shape[1] - 1, max((layer.shape[1] for layer in moving), default=1)
    differences = Differences(sizes, threads, tables=len(values))
    strides = differences.strides[[size > 1 for size in sizes]]
    coefficients = _coefficients(values, len(moving), levels)
    matters = _matters(coefficients, len(moving), levels)
    most = min(MOST_NODES, max(LEAST_NODES, math.prod(sizes) // 2))
    left = np.zeros(patches, np.bool_)
    work = WorkCounter(patches, progress)

    def add(start: int, end: int) -> None:
        # row j: hypotheses that the lights without a choice show exactly j times, in the last row as often or more
        above = np.zeros((most_images, end - start, width), np.uint64)
        for flags in (layer[0] for layer in fixed):
            add_units(above, flags[:, start:end])
        own_pairs = undecided[start:end]
        shown = np.concatenate([~above[:1], above[:-1] & ~above[1:], above[-1:]]) & own_pairs
        # candidates of all moving lights one after the other, patches first: what a patch needs lies together
        rows = np.zeros((end - start, width, levels, sum(len(layer) for layer in moving)), np.uint64)
        first = np.cumsum([0, *(len(layer) for layer in moving)])
        for layer, at in zip(moving, first, strict=False):
            flags = layer[:, :, start:end] & own_pairs
            rows[:, :, : layer.shape[1], at : at + len(layer)] = flags.transpose(2, 3, 1, 0)
        planes, rules, areas = (weights.masks, weights.factors), (coefficients, matters), weights.areas[start:end]
        with differences.borrowed() as own:
            _scatter(own, strides, first, rows, shown, areas, planes, rules, most, left[start:end])
        work.add(end - start)

    tasks = ((add, pair) for pair in blocks(patches, CHUNK_PATCHES))
    run_all(tasks, threads=differences.workers, done=work.report)
    return differences.summed(), left


def _coefficients(values: Int64, lights: int, levels: int) -> Int64:
    # entry (v, j, m, s): Δ(m, s) of table v where the lights without a choice show a hypothesis j times
    tables, length = values.shape
    found = np.zeros((tables, length, lights + 1, lights * levels + 1), np.int64)
    for j in range(length):
        for m in range(lights + 1):
            for s in range(m, m * levels + 1):
                for i in range(m + 1):
                    factor = (-1) ** i * math.comb(m, i)
                    found[:, j, m, s] += factor * values[:, min(j + s - i, length - 1)]
    return found


def _matters(coefficients: Int64, lights: int, levels: int) -> Bool:
    # entry (j, r, m, s): whether a product may still come to a coefficient other than 0 with r more lights
    here = (coefficients != 0).any(axis=0)
    found = np.zeros((here.shape[0], lights + 1, *here.shape[1:]), np.bool_)
    found[:, 0] = here
    for r in range(1, lights + 1):
        found[:, r] = found[:, r - 1]
        for more in range(1, levels + 1):
            found[:, r, :-1, : here.shape[2] - more] |= found[:, r - 1, 1:, more:]
    return found


@kernel
def _scatter(
    differences: Int64,
    strides: Int64,
    first: Int64,
    rows: Words,
    shown: Words,
    areas: Int64,
    planes: tuple[Words, Int64],
    rules: tuple[Int64, Bool],
    most: int,
    left: Bool,
) -> None:
    (masks, factors), (coefficients, matters) = planes, rules
    zero = np.uint64(0)
    at, hypotheses = np.empty(most, np.int64), np.empty(most, np.uint64)
    sign, order, total = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most, np.int64)
    products = at, hypotheses, sign, order, total
    size = 2 * rows.shape[2] * rows.shape[3]
    places, changed = np.empty(size, np.int64), np.empty(size, np.uint64)
    signs, ends = np.empty(size, np.int64), np.zeros(len(strides) * rows.shape[2] + 1, np.int64)
    changes = places, changed, signs, ends
    common, which = np.empty(size + 1, np.uint64), np.empty(size + 1, np.uint64)
    levels = rows.shape[2] if len(strides) else 0
    last = max(0, len(strides) - 1) * levels
    for p in range(rows.shape[0]):
        starts = 0
        for w in range(rows.shape[1]):
            for j in range(len(shown)):
                starts += shown[j, p, w] != zero
        # a patch with too many products is left out whole: where there are several words, a first pass counts them
        passes = 1 if starts == 1 else 2
        for attempt in range(passes):
            for w in range(rows.shape[1]):
                _changes(rows[p, w], strides, first, changes)
                for j in range(len(shown)):
                    if shown[j, p, w] == zero:
                        continue
                    at[0], hypotheses[0], sign[0], order[0], total[0] = 0, shown[j, p, w], 1, 0, 0
                    number = _products(changes, matters[j], products, common, which)
                    if number < 0:
                        left[p] = True
                        break
                    if attempt < passes - 1:
                        continue
                    for node in range(number):
                        word, place, here = hypotheses[node], at[node], sign[node] * areas[p]
                        for v in range(len(differences)):
                            c = coefficients[v, j, order[node], total[node]]
                            if c != 0:
                                differences[v, place] += c * here * word_weight(word, w, masks, factors)
                        # products with the last light's changes are not held
                        for level in range(levels):
                            units = total[node] + level + 1
                            for v in range(len(differences)):
                                c = coefficients[v, j, order[node] + 1, units] * here
                                if c == 0:
                                    continue
                                count = np.uint64(0)
                                for k in range(np.uint64(ends[last + level]), np.uint64(ends[last + level + 1])):
                                    both = word & changed[k]
                                    common[count], which[count] = both, k
                                    count += np.uint64(both != zero)
                                for i in range(count):
                                    k = which[i]
                                    weight = signs[k] * word_weight(common[i], w, masks, factors)
                                    differences[v, place + places[k]] += c * weight
                if left[p]:
                    break
            if left[p]:
                break


@kernel
def _changes(row: Words, strides: Int64, first: Int64, changes: _Changes) -> None:
    # where the flags of each light rise and fall along its candidates, level after level
    zero = np.uint64(0)
    places, changed, signs, ends = changes
    number = 0
    for light in range(len(strides)):
        for level in range(len(row)):
            before = zero
            for c in range(first[light], first[light + 1]):
                word = row[level, c]
                if word != before:
                    place = strides[light] * (c - first[light])
                    rise, fall = word & ~before, before & ~word
                    if rise != zero:
                        places[number], changed[number], signs[number] = place, rise, 1
                        number += 1
                    if fall != zero:
                        places[number], changed[number], signs[number] = place, fall, -1
                        number += 1
                    before = word
            ends[light * len(row) + level + 1] = number


@kernel
def _products(changes: _Changes, matters: Bool, products: _Products, common: Words, which: UInt64) -> int:
    # products of changes of one light each, of all lights but the last, that may count, the first of them given; −1
    # where there are too many, with those of the last light. `common` and `which` are for what a product and a light's
    # changes have in common: without a branch for each, since hardly any is foreseen
    places, changed, signs, ends = changes
    at, hypotheses, sign, order, total = products
    lights, levels = matters.shape[0] - 1, (len(ends) - 1) // max(1, matters.shape[0] - 1)
    size = 1
    for light in range(lights - 1):
        more = size
        rest = matters[lights - light - 1]
        for node in range(size):
            word, place, own, others, so_far = hypotheses[node], at[node], sign[node], order[node] + 1, total[node]
            for level in range(levels):
                if not rest[others, so_far + level + 1]:
                    continue
                count, here = np.uint64(0), light * levels + level
                for k in range(np.uint64(ends[here]), np.uint64(ends[here + 1])):
                    both = word & changed[k]
                    common[count], which[count] = both, k
                    count += np.uint64(both != np.uint64(0))
                if more + count > len(at):
                    return -1
                for i in range(count):
                    k = which[i]
                    at[more], hypotheses[more] = place + places[k], common[i]
                    sign[more], order[more], total[more] = own * signs[k], others, so_far + level + 1
                    more += 1
        size = more
    if lights > 0 and size * (1 + ends[lights * levels] - ends[(lights - 1) * levels]) > _TRIES_PER_NODE * len(at):
        return -1
    return size
