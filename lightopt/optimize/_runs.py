"""Scores that depend on classes of levels only, added up as differences.

Along the candidates of a light a patch is shaded, usable or saturated in runs. Over all lights its part in the score is
constant on boxes, the products of runs. Where a constant c fills the box [a, b) × [a', b') × …, the array of its mixed
differences has ±c at the box's corners and 0 elsewhere; so a patch adds a few numbers to an array of differences,
however many combinations there are, and running sums along every axis turn the array into the scores.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.optimize._matrix import Levels, Thresholds
from lightopt.rendering import run_all

__all__ = ["run_products", "run_scores"]

Int64 = NDArray[np.int64]

SATURATED = 1 << 16
"""Added to a cell's count of usable images for each image in which it is saturated."""

CHUNK_PATCHES = 1 << 15
"""Most patches of one task of a thread."""


def run_products(levels: Sequence[Levels], thresholds: Thresholds) -> NDArray[np.float64]:
    """Number of boxes of each patch: the product over the lights of its numbers of runs, shape (p,)."""
    product = np.ones(levels[0].shape[1])
    for layer in levels:
        product *= _run_counts(layer, thresholds.shade, thresholds.saturation)
    return product


def run_scores(
    levels: Sequence[Levels], weights: Int64, thresholds: Thresholds, *, rule: tuple[int, int], threads: int
) -> Int64:
    """Σ weight · [usable in at least `rule[0]` images, saturated in at most `rule[1]`], for all combinations.

    Parameters
    ----------
    levels
        One array per light, shape (candidates, p).
    weights
        Of the patches, shape (p,).
    thresholds
        Between the classes.
    rule
        Least number of usable images, most saturated ones.
    threads
        Number of threads; the sums do not depend on it.
    """
    shape = tuple(len(layer) for layer in levels)
    total = np.zeros(shape, np.int64)
    patches = levels[0].shape[1]
    largest = int(run_products(levels, thresholds).max(initial=1.0))
    lock = Lock()

    def add(start: int, end: int) -> None:
        runs = [
            _runs(np.ascontiguousarray(layer[:, start:end]), thresholds.shade, thresholds.saturation)
            for layer in levels
        ]
        first = np.stack([first for first, _, _ in runs])
        place = np.concatenate([place for _, place, _ in runs])
        kind = np.concatenate([kind for _, _, kind in runs])
        offset = np.cumsum([0, *(len(place) for _, place, _ in runs)])[:-1]
        differences = np.zeros(total.size, np.int64)
        strides = np.array([int(np.prod(shape[i + 1 :])) for i in range(len(shape))], np.int64)
        _scatter(
            differences, strides, first, offset, place, kind, weights[start:end], rule[0], rule[1], largest
        )
        with lock:
            total.reshape(-1)[:] += differences

    # few pieces: each has an array of differences of its own
    pieces = threads * max(1, -(-patches // (threads * max(CHUNK_PATCHES, total.size // 8))))
    bounds = [patches * i // pieces for i in range(pieces + 1)]
    run_all(((add, pair) for pair in itertools.pairwise(bounds)), threads=threads)
    for axis in range(len(shape)):
        np.cumsum(total, axis=axis, out=total)
    return total


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
def _runs(layer: Levels, shade: int, saturation: int) -> tuple[Int64, NDArray[np.int32], NDArray[np.int32]]:
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
    place: NDArray[np.int32],
    kind: NDArray[np.int32],
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
