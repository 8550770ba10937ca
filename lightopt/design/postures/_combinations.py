"""For all combinations of light positions: the pairs that k images or more show, over several postures.

The postures' images of a position are counted before (see :mod:`lightopt.design.postures._counts`), so that a
combination adds up one count per light, whatever the number of postures. Along the positions of a light these counts
change a few times, and the sums come from the changes (:mod:`lightopt.design.objectives._scores_by_image_counts`).
Patches whose counts change nearly everywhere are added up combination by combination, light after light; the last
light's positions share the sum of the others.
"""

import math
from collections.abc import Sequence

import numpy as np

from lightopt.core.arrays import Int64, UInt64
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share
from lightopt.core.threads import available_processors, run_all
from lightopt.design.objectives._scores_by_image_counts import at_least, count_run_sums, up_to
from lightopt.design.postures._counts import Counts, PairWeights, add_counts, zero_counts
from lightopt.design.responses._packed_bits import Words, word_weight

PositionCounts = UInt64  # counts of every place of a light, shape (places, k, p, words)

# words that a task of plain additions reads, at most: some 0.1 s of a thread, so that Ctrl-C is heard
TASK_WORDS = 100_000_000


def combination_sums(
    lights: Sequence[PositionCounts], weights: PairWeights, *, threads: int | None = None, progress: Share | None = None
) -> tuple[Int64, Int64]:
    """Covered weight and benefit of every combination of positions, the last light's varying fastest."""
    k = lights[0].shape[1]
    count = threads or available_processors()
    # where one image is enough, the covered weight is the benefit
    values = np.stack([at_least(k), up_to(k)][: min(k, 2)])
    tables, left = count_run_sums(
        lights, weights.areas, (weights.masks, weights.factors), values, threads=count, progress=progress
    )
    covered, benefit = tables[0], tables[-1]
    if left.any():
        rest = PairWeights(areas=weights.areas[left], masks=weights.masks, factors=weights.factors)
        plain = _added_up([positions[:, :, left] for positions in lights], rest, count, progress)
        # not in place: with k = 1 both are the same table
        covered, benefit = covered + plain[0], benefit + plain[1]
    return covered, benefit


def _added_up(
    lights: Sequence[PositionCounts], weights: PairWeights, threads: int, progress: Share | None
) -> tuple[Int64, Int64]:
    sizes = [len(positions) for positions in lights]
    inner = math.prod(sizes[1:])
    k, patches = lights[0].shape[1:3]
    covers, benefits = np.zeros((sizes[0], inner), np.int64), np.zeros((sizes[0], inner), np.int64)
    step = max(1, TASK_WORDS // (inner * lights[0][0, :, 0].size))

    def of_first(first: int, start: int, end: int) -> None:
        some = [positions[:, :, start:end] for positions in lights]
        own = PairWeights(areas=weights.areas[start:end], masks=weights.masks, factors=weights.factors)
        if len(some) == 1:
            _last(zero_counts(own, k), some[0][first : first + 1], *_numbers(own), covers[first], benefits[first])
        else:
            _through(some, 1, some[0][first], 0, own, covers[first], benefits[first])

    for start in range(0, patches, step):
        # a row of the tables is written by one task at a time
        tasks = ((of_first, (first, start, min(start + step, patches))) for first in range(sizes[0]))
        run_all(tasks, threads=threads, done=None if progress is None else lambda: progress(1.0))
    return covers.ravel(), benefits.ravel()


def _numbers(weights: PairWeights) -> tuple[Int64, Words, Int64]:
    return weights.areas, weights.masks, weights.factors


def _through(
    lights: Sequence[PositionCounts],
    light: int,
    so_far: Counts,
    start: int,
    weights: PairWeights,
    covered: Int64,
    benefit: Int64,
) -> int:
    # sums of the combinations of the lights from `light` on, written from `start` on; where the next ones go
    if light == len(lights) - 1:
        end = start + len(lights[light])
        _last(so_far, lights[light], *_numbers(weights), covered[start:end], benefit[start:end])
        return end
    for positions in lights[light]:
        start = _through(lights, light + 1, add_counts(so_far, positions), start, weights, covered, benefit)
    return start


@kernel
def _last(
    counts: Counts,
    positions: PositionCounts,
    areas: Int64,
    masks: Words,
    factors: Int64,
    covered: Int64,
    benefit: Int64,
) -> None:
    k = counts.shape[0]
    for c in range(len(positions)):
        for p in range(counts.shape[1]):
            most, each = np.int64(0), np.int64(0)
            for w in range(counts.shape[2]):
                for level in range(k):
                    flags = counts[level, p, w] | positions[c, level, p, w]
                    for low in range(level):
                        flags |= counts[low, p, w] & positions[c, level - 1 - low, p, w]
                    if flags:
                        value = word_weight(flags, w, masks, factors)
                        each += value
                        if level == k - 1:
                            most += value
            covered[c] += areas[p] * most
            benefit[c] += areas[p] * each
