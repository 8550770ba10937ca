"""Scores that depend on classes of levels only, counted in packed bits: for patches whose classes change very often.

64 patches share a word. Usable and saturated images are counted by saturating bit counters, light after light; the
weights of covered patches are added up bit by bit, each bit of the weights being a plane of words of its own.
"""

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from lightopt.core.arrays import Int64
from lightopt.core.kernels import kernel
from lightopt.core.run_context import WorkCounter
from lightopt.core.threads import Task, blocks, run_all
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds
from lightopt.design.responses._packed_bits import Words, common_bits, count_flags, pack_flags

LEAST_USABLE = 2  # images that must show a patch usably
MOST_SATURATED = 1  # images that may show it saturated

# a patch goes to the packed bits when its classes make more than 1/512 of the table's number of cells: there the two
# ways take about the same time
BITS_SHARE = 512

BLOCK_LEVELS = 1 << 25  # levels that are packed at once
LEAST_PATCHES = 4096  # of a block, however many candidates there are
TASK_WORDS = 100_000_000  # words that a task reads, at most: some 0.1 s of a thread, so that Ctrl-C is heard
_Classes = tuple[Words, Words]  # of the usable and of the saturated images


def bit_scores(
    levels: Sequence[Levels], which: Int64, weights: Int64, thresholds: LevelThresholds, threads: int, work: WorkCounter
) -> Int64:
    """As :func:`lightopt.design.objectives._coverage.run_scores`; at least two lights."""
    sizes = [len(layer) for layer in levels]
    table = np.zeros(math.prod(sizes), np.int64)
    for start, end in blocks(len(which), max(LEAST_PATCHES, BLOCK_LEVELS // sum(sizes))):
        # heavy patches first, so that the planes of the high bits are short
        some = which[start:end][np.argsort(-weights[which[start:end]], kind="stable")]
        tasks = _tasks(levels, some, weights[some], thresholds, table, work)
        run_all(tasks, threads=threads, done=work.report)
    return table


def _tasks(
    levels: Sequence[Levels], some: Int64, heavy: Int64, thresholds: LevelThresholds, table: Int64, work: WorkCounter
) -> Iterator[Task]:
    """Tasks that add the scores of some patches, of descending weights `heavy`, to a table."""
    bits = max(1, int(heavy.max(initial=0)).bit_length())
    planes = pack_flags(np.stack([(heavy >> k) & 1 == 1 for k in range(bits)]))
    lengths = np.array([-(-int((heavy >= (1 << k)).sum()) // 64) for k in range(bits)], np.int64)
    words = planes.shape[1]
    # row k: usable, or saturated, in more than k images so far; first those under lights that stand still
    used, spoilt = np.zeros((LEAST_USABLE, words), np.uint64), np.zeros((MOST_SATURATED + 1, words), np.uint64)
    # the last two of those that move are counted together; where fewer do, of those that stand still
    moving = [i for i, layer in enumerate(levels) if len(layer) > 1]
    last = (moving or [0])[-2:]
    last = sorted({*last, *[i for i in range(len(levels)) if i not in last][: 2 - len(last)]})
    outer: list[_Classes] = []
    inner: list[_Classes] = []
    for i, layer in enumerate(levels):
        taken = layer.take(some, axis=1)
        usable = pack_flags((taken >= thresholds.shade) & (taken < thresholds.saturation))
        saturated = pack_flags(taken >= thresholds.saturation)
        if i in last:
            inner.append((usable, saturated))
        elif len(layer) > 1:
            outer.append((usable, saturated))
        else:
            count_flags(used, usable[0])
            count_flags(spoilt, saturated[0])
    (usable, saturated), final = inner
    columns = len(final[0])
    cells = table.reshape(-1, len(usable), columns)

    def fill(index: int, prefix: tuple[int, ...], start: int, end: int) -> None:
        use, spoil = used.copy(), spoilt.copy()
        for (more_used, more_spoilt), candidate in zip(outer, prefix, strict=True):
            count_flags(use, more_used[candidate])
            count_flags(spoil, more_spoilt[candidate])
        here = slice(start, end)
        _last_two((use, spoil), (usable[here], saturated[here]), final, planes, lengths, cells[index, here])
        work.add((end - start) * columns * len(some) / BITS_SHARE)

    rows = max(1, TASK_WORDS // (columns * (words + int(lengths.sum()))))
    prefixes = itertools.product(*(range(len(more)) for more, _ in outer))
    for index, prefix in enumerate(prefixes):
        for start, end in blocks(len(usable), rows):
            yield fill, (index, prefix, start, end)


@kernel
def _last_two(
    counters: _Classes, images: _Classes, last: _Classes, planes: Words, lengths: Int64, table: Int64
) -> None:
    (used, spoilt), (usable, saturated), (last_usable, last_saturated) = counters, images, last
    words = planes.shape[1]
    covered = np.empty(words, np.uint64)
    for c in range(len(usable)):
        use, spoil = used.copy(), spoilt.copy()
        count_flags(use, usable[c])
        count_flags(spoil, saturated[c])
        enough, too_many = use[-1], spoil[-1]
        almost, at_limit = use[-2], spoil[-2]  # one image more carries these over
        for d in range(len(last_usable)):
            for w in range(words):
                covered[w] = (enough[w] | (almost[w] & last_usable[d, w])) & ~(
                    too_many[w] | (at_limit[w] & last_saturated[d, w])
                )
            total = 0
            for k in range(len(lengths)):
                total += common_bits(covered[: lengths[k]], planes[k, : lengths[k]]) << k
            table[c, d] += total
