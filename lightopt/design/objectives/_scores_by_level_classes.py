"""Scores that depend on classes of levels only, added up as differences.

Along the candidates of a light a patch is shaded, usable or saturated in runs. Over all lights its part in the score is
constant on boxes, the products of runs: see :mod:`lightopt.design.objectives._difference_tables`.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from lightopt.core.arrays import Float64, Int32, Int64
from lightopt.core.kernels import kernel
from lightopt.core.run_context import Share, WorkCounter
from lightopt.core.threads import run_all
from lightopt.design.objectives._difference_tables import Differences
from lightopt.design.responses._luminance_matrix import Levels, LevelThresholds

SATURATED = 1 << 16  # added to a cell's count of usable images for each image in which it is saturated
CHUNK_PATCHES = 1 << 14  # most patches of one task of a thread
CHUNK_LEVELS = 1 << 24  # most of their levels, which are copied
CHUNK_BOXES = 1e6  # most of their boxes: less than 0.1 s, so that Ctrl-C is heard


def run_products(levels: Sequence[Levels], thresholds: LevelThresholds) -> Float64:
    """Number of boxes of each patch: the product over the lights of its numbers of runs, shape (p,)."""
    product = np.ones(levels[0].shape[1])
    for layer in levels:
        product *= _run_counts(layer, thresholds.shade, thresholds.saturation)
    return product


def run_scores(
    levels: Sequence[Levels],
    chosen: Int64,
    weights: Int64,
    thresholds: LevelThresholds,
    *,
    rule: tuple[int, int],
    threads: int,
    progress: Share | None = None,
) -> Int64:
    """Σ weight · [usable in at least `rule[0]` images, saturated in at most `rule[1]`], for all combinations.

    levels: One array per light, shape (candidates, p).
    chosen: Indices of the patches that count.
    weights: Of all patches, shape (p,).
    Returns one number per combination, the last light's candidates varying fastest.
    """
    sizes = [len(layer) for layer in levels]
    products = run_products(levels, thresholds)[chosen]
    largest = int(products.max(initial=1.0))
    differences = Differences(sizes, threads)
    ends = _chunks(products, max(1, min(CHUNK_PATCHES, CHUNK_LEVELS // sum(sizes))))
    work = WorkCounter(float(products.sum()), progress)

    def add(start: int, end: int) -> None:
        some = chosen[start:end]
        runs = [_runs(layer.take(some, axis=1), thresholds.shade, thresholds.saturation) for layer in levels]
        first = np.stack([first for first, _, _ in runs])
        place = np.concatenate([place for _, place, _ in runs])
        kind = np.concatenate([kind for _, _, kind in runs])
        offset = np.cumsum([0, *(len(place) for _, place, _ in runs)])[:-1]
        with differences.borrowed() as (own,):
            _scatter(own, differences.strides, first, offset, place, kind, weights[some], rule[0], rule[1], largest)
        work.add(float(products[start:end].sum()))

    pairs = itertools.pairwise(ends)
    run_all(((add, pair) for pair in pairs), threads=differences.workers, done=work.report)
    return differences.summed()[0]


def _chunks(products: Float64, most: int) -> list[int]:
    # where pieces of patches begin and end: at most so many patches, and boxes as far as a patch has fewer itself
    ends = [0]
    boxes = np.cumsum(products)
    while ends[-1] < len(products):
        before = boxes[ends[-1] - 1] if ends[-1] else 0.0
        reached = int(np.searchsorted(boxes, before + CHUNK_BOXES, side="right"))
        ends.append(min(max(reached, ends[-1] + 1), ends[-1] + most, len(products)))
    return ends


@kernel
def _kind(level: int, shade: int, saturation: int) -> int:
    # 0 shaded, 1 usable, SATURATED saturated
    return 0 if level < shade else 1 if level < saturation else SATURATED


@kernel
def _run_counts(layer: Levels, shade: int, saturation: int) -> Int64:
    counts = np.ones(layer.shape[1], np.int64)
    for a in range(1, len(layer)):
        for p in range(layer.shape[1]):
            before, here = layer[a - 1, p], layer[a, p]
            counts[p] += (before < shade) != (here < shade) or (before < saturation) != (here < saturation)
    return counts


@kernel
def _runs(layer: Levels, shade: int, saturation: int) -> tuple[Int64, Int32, Int32]:
    # where each patch's runs begin and their classes: patch p has those from first[p] to first[p + 1]
    counts = _run_counts(layer, shade, saturation)
    first = np.zeros(layer.shape[1] + 1, np.int64)
    for p in range(layer.shape[1]):
        first[p + 1] = first[p] + counts[p]
    place = np.empty(first[-1], np.int32)
    kind = np.empty(first[-1], np.int32)
    for p in range(layer.shape[1]):
        k = first[p]
        last = -1
        for a in range(len(layer)):
            here = _kind(layer[a, p], shade, saturation)
            if here != last:
                place[k], kind[k] = a, here
                last = here
                k += 1
    return first, place, kind


@kernel
def _scatter(
    differences: Int64,
    strides: Int64,
    first: Int64,
    offset: Int64,
    place: Int32,
    kind: Int32,
    weights: Int64,
    least_usable: int,
    most_saturated: int,
    largest: int,
) -> None:
    lights = len(strides)
    at = np.empty(largest, np.int64)  # where in the table each box begins
    count = np.empty(largest, np.int64)  # its usable images + SATURATED · its saturated ones
    for p in range(len(weights)):
        size = 1
        at[0], count[0] = 0, 0
        for light in range(lights):
            start, end = offset[light] + first[light, p], offset[light] + first[light, p + 1]
            runs = end - start
            # the boxes so far, times the runs of this light; backwards, so that none is overwritten too early
            for box in range(size - 1, -1, -1):
                for r in range(runs - 1, -1, -1):
                    at[box * runs + r] = at[box] + strides[light] * place[start + r]
                    count[box * runs + r] = count[box] + kind[start + r]
            size *= runs
        for box in range(size):
            usable, saturated = count[box] % SATURATED, count[box] // SATURATED
            count[box] = 1 if usable >= least_usable and saturated <= most_saturated else 0
        step = 1
        for light in range(lights - 1, -1, -1):
            runs = first[light, p + 1] - first[light, p]
            for box in range(size - 1, step - 1, -1):
                if (box // step) % runs:
                    count[box] -= count[box - step]
            step *= runs
        for box in range(size):
            if count[box]:
                differences[at[box]] += weights[p] * count[box]
