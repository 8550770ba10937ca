"""Where the lights go that stand the same in all postures: of all combinations of their places the one that shows most.

Every combination is tried, a table of so many after the other; where there are too many, lights are moved one at a
time until that gains nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import InputError
from lightopt.design._plan_progress import Share
from lightopt.design.candidates._combination_space import Space, allowed_mask
from lightopt.design.postures._combinations import PlaceCounts, combination_sums
from lightopt.design.postures._counts import PairWeights
from lightopt.design.responses._visibility import taken_rows
from lightopt.design.search._search import DEFAULT_LIMIT, TABLE_CELLS

Rows = Sequence[NDArray[np.int64]]


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
