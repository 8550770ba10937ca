"""All combinations of the lights' places at once: how many pairs they show in k images or more, over several postures.

The postures' images of a place are counted before (see :mod:`lightopt.plan._counts`), so that a combination adds up one
count per light, whatever the number of postures. Combinations are gone through light by light; the last light's places
share the sum of the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.kernels import kernel
from lightopt.optimize import Space, word_weight
from lightopt.plan._counts import Counts, PairWeights, Words, added, no_counts
from lightopt.rendering import in_threads

__all__ = ["MOST_WORDS", "Places", "combination_sums", "place_lights"]

Int64 = NDArray[np.int64]

PlaceCounts = NDArray[np.uint64]
"""Counts of every place of a light, shape (places, k, p, words)."""

MOST_WORDS = 20_000_000_000
"""Words that all combinations may take to look at: some 20 s of a thread. Beyond, lights are moved one at a time."""


@dataclass(frozen=True, kw_only=True)
class Places:
    """One place of each light.

    Attributes
    ----------
    candidates
        Index of each light's place.
    reached
        Weight of the pairs that are seen in k images or more.
    worth
        Σ weight · min(k, count); decides between places that reach the same.
    exact
        Whether all combinations were tried; else lights were moved one at a time until that gained nothing.
    """

    candidates: tuple[int, ...]
    reached: int
    worth: int
    exact: bool


def combination_sums(
    lights: Sequence[PlaceCounts], weights: PairWeights, *, threads: int | None = None
) -> tuple[Int64, Int64]:
    """Weight reached and worth of every combination of places, the last light's varying fastest.

    Parameters
    ----------
    lights
        Of each light, counts of each place over all postures.
    weights
        Of the pairs.
    threads
        All the machine's by default; the sums do not depend on it.
    """
    sizes = [len(places) for places in lights]
    inner = math.prod(sizes[1:])
    k = lights[0].shape[1]

    def of_first(first: int) -> tuple[Int64, Int64]:
        top, whole = np.zeros(inner, np.int64), np.zeros(inner, np.int64)
        if len(lights) == 1:
            _last(no_counts(weights, k), lights[0][first : first + 1], *_numbers(weights), top, whole)
        else:
            _through(lights, 1, lights[0][first], 0, weights, top, whole)
        return top, whole

    found = in_threads(of_first, range(sizes[0]), threads)
    return np.concatenate([top for top, _ in found]), np.concatenate([whole for _, whole in found])


def place_lights(
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    space: Space,
    *,
    most_words: int = MOST_WORDS,
    threads: int | None = None,
) -> Places:
    """The places of lights that stand the same in all postures: most reached, then most worth, then first in order.

    Parameters
    ----------
    lights
        Of each light, counts of each place over all postures.
    weights
        Of the pairs.
    space
        Which combinations are allowed.
    most_words
        Beyond so many words of work, lights are moved one at a time.
    threads
        All the machine's by default; the answer does not depend on it.

    Raises
    ------
    InputError
        No combination is allowed.
    """
    words = sum(math.prod(len(rows) for rows in group) for group in space.groups) * lights[0][0].size
    exact = words <= most_words
    best: Places | None = None
    for group in space.groups:
        found = (
            _best_of(lights, weights, space, group, threads)
            if exact
            else _one_at_a_time(lights, weights, space, group, threads)
        )
        if found is not None and (best is None or (found.reached, found.worth) > (best.reached, best.worth)):
            best = found
    if best is None:
        raise InputError(
            "no combination of the lights' positions is left: in each, panels collide; widen their ranges or take "
            "smaller panels"
        )
    return best


def _best_of(
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    space: Space,
    rows: Sequence[Int64],
    threads: int | None,
) -> Places | None:
    top, whole = combination_sums(
        [places[some] for places, some in zip(lights, rows, strict=True)], weights, threads=threads
    )
    allowed = _allowed(space, rows)
    if not allowed.any():
        return None
    top, whole = np.where(allowed, top, -1), np.where(allowed, whole, -1)
    most = int(top.max())
    at = int(np.argmax(np.where(top == most, whole, -1)))
    chosen = np.unravel_index(at, [len(some) for some in rows])
    return Places(
        candidates=tuple(int(some[i]) for some, i in zip(rows, chosen, strict=True)),
        reached=most,
        worth=int(whole[at]),
        exact=True,
    )


def _one_at_a_time(
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    space: Space,
    rows: Sequence[Int64],
    threads: int | None,
) -> Places | None:
    now = _first_allowed(space, rows)
    if now is None:
        return None
    best: Places | None = None
    moved = True
    while moved:
        moved = False
        for i in range(len(lights)):
            some = [rows[j] if j == i else np.array([now[j]]) for j in range(len(lights))]
            found = _best_of(lights, weights, space, some, threads)
            assert found is not None
            if best is None or (found.reached, found.worth) > (best.reached, best.worth):
                best = Places(
                    candidates=found.candidates, reached=found.reached, worth=found.worth, exact=False
                )
                now, moved = list(found.candidates), True
    return best


def _first_allowed(space: Space, rows: Sequence[Int64]) -> list[int] | None:
    # depth first: with so many combinations, a mask of them all is too large
    chosen: list[int] = []

    def fits(light: int, place: int) -> bool:
        return not any(
            (j == light and space.clashes[i, j][chosen[i], place]) for i, j in space.clashes if i < light
        )

    def go(light: int) -> bool:
        if light == len(rows):
            return True
        for place in map(int, rows[light]):
            if fits(light, place):
                chosen.append(place)
                if go(light + 1):
                    return True
                chosen.pop()
        return False

    return chosen if go(0) else None


def _allowed(space: Space, rows: Sequence[Int64]) -> NDArray[np.bool_]:
    sizes = [len(some) for some in rows]
    allowed = np.ones(sizes, np.bool_)
    for (i, j), clash in space.clashes.items():
        shape = [size if at in (i, j) else 1 for at, size in enumerate(sizes)]
        allowed &= ~clash[np.ix_(rows[i], rows[j])].reshape(shape)
    return allowed.ravel()


def _numbers(weights: PairWeights) -> tuple[Int64, Words, Int64]:
    return weights.areas, weights.masks, weights.factors


def _through(
    lights: Sequence[PlaceCounts],
    light: int,
    so_far: Counts,
    start: int,
    weights: PairWeights,
    top: Int64,
    whole: Int64,
) -> int:
    # sums of the combinations of the lights from `light` on, written from `start` on; where the next ones go
    if light == len(lights) - 1:
        end = start + len(lights[light])
        _last(so_far, lights[light], *_numbers(weights), top[start:end], whole[start:end])
        return end
    for places in lights[light]:
        start = _through(lights, light + 1, added(so_far, places), start, weights, top, whole)
    return start


@kernel
def _last(
    counts: Counts,
    places: PlaceCounts,
    areas: Int64,
    masks: Words,
    factors: Int64,
    top: Int64,
    whole: Int64,
) -> None:
    k = counts.shape[0]
    for c in range(len(places)):
        for p in range(counts.shape[1]):
            most, each = np.int64(0), np.int64(0)
            for w in range(counts.shape[2]):
                for level in range(k):
                    flags = counts[level, p, w] | places[c, level, p, w]
                    for low in range(level):
                        flags |= counts[low, p, w] & places[c, level - 1 - low, p, w]
                    if flags:
                        value = word_weight(flags, w, masks, factors)
                        each += value
                        if level == k - 1:
                            most += value
            top[c] += areas[p] * most
            whole[c] += areas[p] * each
