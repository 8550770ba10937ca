"""All combinations of the lights' places at once: how many pairs they show in k images or more, over several postures.

The postures' images of a place are counted before (see :mod:`lightopt.plan._counts`), so that a combination adds up one
count per light, whatever the number of postures. Along the places of a light these counts change a few times, and the
sums come from where they do: :func:`lightopt.optimize.count_run_sums`. Patches whose counts change nearly everywhere
are added up combination by combination, light after light; the last light's places share the sum of the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.errors import InputError
from lightopt.kernels import kernel
from lightopt.optimize import (
    DEFAULT_LIMIT,
    TABLE_CELLS,
    Space,
    allowed_mask,
    at_least,
    count_run_sums,
    taken_rows,
    up_to,
    word_weight,
)
from lightopt.plan._counts import Counts, PairWeights, Words, added, no_counts
from lightopt.rendering import available_processors, run_all

__all__ = ["PlaceCounts", "Places", "combination_sums", "first_allowed", "place_lights"]

Int64 = NDArray[np.int64]

PlaceCounts = NDArray[np.uint64]
"""Counts of every place of a light, shape (places, k, p, words)."""

TASK_WORDS = 100_000_000
"""Words that a task of plain additions looks at, at most: some 0.1 s of a thread, so that Ctrl-C is heard."""

Rows = Sequence[Int64]
Share = Callable[[float], None]


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
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    *,
    threads: int | None = None,
    progress: Share | None = None,
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
    progress
        Called with the share that is done.
    """
    k = lights[0].shape[1]
    count = threads or available_processors()
    # where one image is enough, what is reached is what it is worth
    values = np.stack([at_least(k), up_to(k)][: min(k, 2)])
    tables, left = count_run_sums(
        lights,
        weights.areas,
        (weights.masks, weights.factors),
        values,
        threads=count,
        progress=progress,
    )
    top, whole = tables[0], tables[-1]
    if left.any():
        rest = PairWeights(areas=weights.areas[left], masks=weights.masks, factors=weights.factors)
        plain = _added_up([places[:, :, left] for places in lights], rest, count, progress)
        # not in place: with k = 1 both are the same table
        top, whole = top + plain[0], whole + plain[1]
    return top, whole


def _added_up(
    lights: Sequence[PlaceCounts], weights: PairWeights, threads: int, progress: Share | None
) -> tuple[Int64, Int64]:
    sizes = [len(places) for places in lights]
    inner = math.prod(sizes[1:])
    k, patches = lights[0].shape[1:3]
    tops, wholes = np.zeros((sizes[0], inner), np.int64), np.zeros((sizes[0], inner), np.int64)
    step = max(1, TASK_WORDS // (inner * lights[0][0, :, 0].size))

    def of_first(first: int, start: int, end: int) -> None:
        some = [places[:, :, start:end] for places in lights]
        own = PairWeights(areas=weights.areas[start:end], masks=weights.masks, factors=weights.factors)
        if len(some) == 1:
            _last(no_counts(own, k), some[0][first : first + 1], *_numbers(own), tops[first], wholes[first])
        else:
            _through(some, 1, some[0][first], 0, own, tops[first], wholes[first])

    for start in range(0, patches, step):
        # a row of the tables is written by one task at a time
        tasks = ((of_first, (first, start, min(start + step, patches))) for first in range(sizes[0]))
        run_all(tasks, threads=threads, done=None if progress is None else lambda: progress(1.0))
    return tops.ravel(), wholes.ravel()


def place_lights(
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    space: Space,
    *,
    limit: int = DEFAULT_LIMIT,
    table_cells: int = TABLE_CELLS,
    threads: int | None = None,
    progress: Share | None = None,
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
    limit
        With more combinations than that, lights are moved one at a time.
    table_cells
        Most combinations to try at once.
    threads
        All the machine's by default; the answer does not depend on it.
    progress
        Called with the share that is done.

    Raises
    ------
    InputError
        No combination is allowed.
    """
    exact = sum(math.prod(len(rows) for rows in group) for group in space.groups) <= limit
    boxes = [box for group in space.groups for box in (_boxes(group, table_cells) if exact else [group])]
    best: Places | None = None
    for done, box in enumerate(boxes):

        def tell(share: float, before: int = done) -> None:
            if progress is not None:
                progress((before + share) / len(boxes))

        found = (
            _best_of(lights, weights, space, box, threads, tell)
            if exact
            else _one_at_a_time(lights, weights, space, box, threads)
        )
        if found is not None and (best is None or (found.reached, found.worth) > (best.reached, best.worth)):
            best = found
    if best is None:
        raise InputError(
            "no combination of the lights' positions is left: in each, panels collide; widen their ranges or take "
            "smaller panels"
        )
    return best


def _boxes(rows: Rows, most: int) -> Iterator[Rows]:
    # pieces of at most so many combinations, those that come first in order first
    inner = math.prod(len(some) for some in rows[1:])
    step = max(1, most // inner)
    for start in range(0, len(rows[0]), step):
        first = rows[0][start : start + step]
        if inner <= most or len(rows) == 1:
            yield first, *rows[1:]
        else:
            for rest in _boxes(rows[1:], most):
                yield first, *rest


def _best_of(
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    space: Space,
    rows: Rows,
    threads: int | None,
    progress: Share | None,
) -> Places | None:
    allowed = allowed_mask(space, tuple(rows))
    if allowed is not None and not allowed.any():
        return None
    top, whole = combination_sums(
        [taken_rows(places, some) for places, some in zip(lights, rows, strict=True)],
        weights,
        threads=threads,
        progress=progress,
    )
    if allowed is not None:
        top, whole = np.where(allowed, top, -1), np.where(allowed, whole, -1)
    most = int(top.max())
    at = int(np.argmax(np.where(top == most, whole, -1)))
    value = int(whole[at])
    chosen: list[int] = []
    for some in reversed(rows):
        at, place = divmod(at, len(some))
        chosen.append(int(some[place]))
    return Places(candidates=tuple(reversed(chosen)), reached=most, worth=value, exact=True)


def _one_at_a_time(
    lights: Sequence[PlaceCounts],
    weights: PairWeights,
    space: Space,
    rows: Rows,
    threads: int | None,
) -> Places | None:
    now = first_allowed(space, rows)
    if now is None:
        return None
    best: Places | None = None
    moved = True
    while moved:
        moved = False
        for i in range(len(lights)):
            some = [rows[j] if j == i else np.array([now[j]]) for j in range(len(lights))]
            found = _best_of(lights, weights, space, some, threads, None)
            assert found is not None
            if best is None or (found.reached, found.worth) > (best.reached, best.worth):
                best = Places(
                    candidates=found.candidates, reached=found.reached, worth=found.worth, exact=False
                )
                now, moved = list(found.candidates), True
    return best


def first_allowed(space: Space, rows: Rows) -> list[int] | None:
    """The first combination whose panels do not collide, in the order of the rows; None where there is none."""
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
