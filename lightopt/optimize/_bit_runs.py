"""How many combinations' images show a defect often enough, added up as differences.

Along the candidates of a light the bit of a (patch, trial) rises and falls a few times. With b_l that of light l and n
their sum over the lights, in elementary symmetric sums e_j of the b_l,

    [n ≥ k] = Σ_{j ≥ k} (−1)^{j−k} · binomial(j − 1, k − 1) · e_j,

for any number of lights: with k = 2, e₂ − 2·e₃ + 3·e₄ − … . A product of j bits that rise or fall at places c_l is, in
the array of its mixed differences along the lights' candidates, ±1 at the place of those c_l, with 0 for the other
lights; running sums along every axis make the scores of it. All trials of a patch are looked at as one word: those that
rise at the same places cost no more than one. Lights with one candidate only lower k for the trials that they show.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from queue import Empty, SimpleQueue

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.optimize._bits import bit_scores
from lightopt.optimize._matrix import Thresholds
from lightopt.optimize._packed import Words, word_weight
from lightopt.optimize._runs import MOST_DIFFERENCES
from lightopt.optimize._work import Share, Work, part_of, pieces
from lightopt.rendering import run_all

__all__ = ["bit_run_scores", "flags_of"]

Int64 = NDArray[np.int64]

CHUNK_PATCHES = 1 << 12
"""Patches of one task of a thread: some 0.01 s."""

MOST_NODES = 1 << 18
"""A word whose bits change at more places than this is left to the packed bits; so is one with more than half as many
as there are combinations, where the two ways take about the same time."""

LEAST_NODES = 1 << 10
"""However few combinations there are."""

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
        The trials' weights in binary, from :func:`lightopt.optimize._visibility.trial_planes`.
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
    sizes = [len(layer) for layer in words]
    cells = math.prod(sizes)
    fixed = [layer for layer in words if len(layer) == 1]
    moving = tuple(layer for layer in words if len(layer) > 1)
    strides = np.array(
        [math.prod(sizes[i + 1 :]) for i, layer in enumerate(words) if len(layer) > 1], np.int64
    )
    patches, width = words[0].shape[1:]
    most = min(MOST_NODES, max(LEAST_NODES, cells // 2))
    coefficients = _coefficients(len(moving), least)
    # each thread has an array of differences of its own, made when it is needed
    workers = max(1, min(threads, MOST_DIFFERENCES // cells))
    free: SimpleQueue[Int64] = SimpleQueue()
    made: list[Int64] = []
    left = np.zeros(patches, np.bool_)
    work = Work(patches, part_of(progress, 0.0, 0.9))

    def add(start: int, end: int) -> None:
        try:
            differences = free.get_nowait()
        except Empty:
            differences = np.zeros(cells, np.int64)
            made.append(differences)
        shown = _shown_by_fixed([layer[0, start:end] for layer in fixed], end - start, width, least)
        # candidates of all moving lights one after the other, patches first: what a patch needs lies together
        rows = np.concatenate(
            [layer[:, start:end] for layer in moving] or [np.zeros((0, end - start, width), np.uint64)]
        )
        _scatter(
            differences,
            strides,
            np.cumsum([0, *(len(layer) for layer in moving)]),
            np.ascontiguousarray(rows.transpose(1, 2, 0)),
            shown,
            weights[start:end],
            *planes,
            least,
            coefficients,
            most,
            left[start:end],
        )
        free.put(differences)
        work.add(end - start)

    run_all(((add, pair) for pair in pieces(patches, CHUNK_PATCHES)), threads=workers, done=work.tell)
    total = made[0] if made else np.zeros(cells, np.int64)
    for differences in made[1:]:
        total += differences
    for size, stride in zip(sizes, (math.prod(sizes[i + 1 :]) for i in range(len(sizes))), strict=True):
        if size > 1:
            along = total.reshape(-1, size, stride)
            np.cumsum(along, axis=1, out=along)
    if left.any():
        total += _by_bits(
            words, np.flatnonzero(left), weights, trial_weights, least, threads, part_of(progress, 0.9, 1.0)
        )
    return total


def flags_of(words: Words, count: int) -> NDArray[np.uint8]:
    """Bits as flags 0 and 1: words of shape (…, ⌈t / 64⌉) to shape (…, t)."""
    octets = np.ascontiguousarray(words).astype("<u8", copy=False).view(np.uint8)
    return np.unpackbits(octets, axis=-1, bitorder="little")[..., :count]


def _coefficients(lights: int, least: int) -> Int64:
    # row k, column j: of the e_j in [n ≥ k]
    table = np.zeros((least + 1, lights + 1), np.int64)
    for k in range(1, least + 1):
        for j in range(k, lights + 1):
            table[k, j] = (-1) ** (j - k) * math.comb(j - 1, k - 1)
    return table


def _shown_by_fixed(images: Sequence[Words], patches: int, width: int, least: int) -> Words:
    # row j: trials that exactly j lights without a choice show; the last row has those of `least` and more
    exactly = np.zeros((least + 1, patches, width), np.uint64)
    exactly[0] = ~np.uint64(0)
    for image in images:
        for j in range(least - 1, -1, -1):
            rise = exactly[j] & image
            exactly[j + 1] |= rise
            exactly[j] &= ~rise
    return exactly


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


@kernel
def _scatter(
    differences: Int64,
    strides: Int64,
    first: Int64,
    rows: Words,
    shown: Words,
    weights: Int64,
    masks: Words,
    factors: Int64,
    least: int,
    coefficients: Int64,
    most: int,
    left: NDArray[np.bool_],
) -> None:
    zero = np.uint64(0)
    # products of changes: place in the table, trials, sign, number of lights
    at, trials = np.empty(most, np.int64), np.empty(most, np.uint64)
    sign, order = np.empty(most, np.int64), np.empty(most, np.int64)
    # the changes of each light: where, which trials, rising or falling
    places, signs = np.empty(2 * rows.shape[2], np.int64), np.empty(2 * rows.shape[2], np.int64)
    changed, ends = np.empty(2 * rows.shape[2], np.uint64), np.empty(len(strides) + 1, np.int64)
    for p in range(rows.shape[0]):
        starts = 0
        for w in range(rows.shape[1]):
            for j in range(least + 1):
                starts += shown[j, p, w] != zero
        # a patch with too many products is left out whole: where there are several words, they are looked at before
        passes = 1 if starts == 1 else 2
        for turn in range(passes):
            for w in range(rows.shape[1]):
                _changes(rows[p, w], strides, first, places, changed, signs, ends)
                for j in range(least + 1):
                    start = shown[j, p, w]
                    if start == zero:
                        continue
                    if j == least:
                        if turn == passes - 1:
                            differences[0] += weights[p] * word_weight(start, w, masks, factors)
                        continue
                    size = _products(start, least - j, places, changed, signs, ends, at, trials, sign, order)
                    if size < 0:
                        left[p] = True
                        break
                    if turn == passes - 1:
                        for node in range(size):
                            c = coefficients[least - j, order[node]]
                            if c != 0:
                                value = weights[p] * word_weight(trials[node], w, masks, factors)
                                differences[at[node]] += sign[node] * c * value
                if left[p]:
                    break
            if left[p]:
                break


@kernel
def _changes(
    row: Words, strides: Int64, first: Int64, places: Int64, changed: Words, signs: Int64, ends: Int64
) -> None:
    # where the bits of each light rise and fall along its candidates
    zero = np.uint64(0)
    ends[0] = number = 0
    for light in range(len(strides)):
        before = zero
        for c in range(first[light], first[light + 1]):
            word = row[c]
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
        ends[light + 1] = number


@kernel
def _products(
    start: np.uint64,
    wanted: int,
    places: Int64,
    changed: Words,
    signs: Int64,
    ends: Int64,
    at: Int64,
    trials: Words,
    sign: Int64,
    order: Int64,
) -> int:
    # products of changes of one light each that can still become of `wanted` lights; −1 where there are too many
    lights = len(ends) - 1
    at[0], trials[0], sign[0], order[0] = 0, start, 1, 0
    size = 1
    for light in range(lights):
        more = size
        for node in range(size):
            if order[node] + lights - light < wanted:
                continue
            for k in range(ends[light], ends[light + 1]):
                both = trials[node] & changed[k]
                if both == np.uint64(0):
                    continue
                if more == len(at):
                    return -1
                at[more], trials[more] = at[node] + places[k], both
                sign[more], order[more] = sign[node] * signs[k], order[node] + 1
                more += 1
        size = more
    return size
