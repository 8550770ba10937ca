"""Cells of the grid of candidate positions: what lies between neighbouring candidates of a light."""

import bisect
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Int64
from lightopt.design.search._exact_search import CombinationSpace

Interval = tuple[float, float]  # from one step of an angle [°] or distance [mm] to the next; a single value twice
Cell = tuple[Interval, ...]  # of elevation, azimuth and, with a range of distances, distance

SAME_STEP = 0.1  # share of the mean step below which two values are one step of the grid


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of each light, in the rig's order; without those all of whose corners are excluded."""

    of_lights: tuple[tuple[Cell, ...], ...]
    corners: tuple[tuple[Int64, ...], ...]  # of each cell, indices of the candidates at its corners, ascending
    space: CombinationSpace  # of the cells, in which positions between the candidates can be combined

    @property
    def moves(self) -> tuple[bool, ...]:
        """Whether there is anything between the candidates of each light."""
        return tuple(any(low < high for cell in cells for low, high in cell) for cells in self.of_lights)


def intervals(values: Sequence[float], *, full_turn: bool = False) -> list[Interval]:
    """What lies between neighbouring values, ascending; a single value is one interval.

    Values nearer to each other than :data:`SAME_STEP` of the mean step are one: a measured place near the grid's, and
    the end of a range after a last short step.

    full_turn: Whether the last value is followed by the first, 360 degrees later.
    """
    ends = _steps_of(values)
    if len(ends) == 1:
        return [(ends[0][0], ends[0][-1])]
    between = [(low[0], high[-1]) for low, high in itertools.pairwise(ends)]
    return [*between, (ends[-1][0], ends[0][-1] + 360.0)] if full_turn else between


def _steps_of(values: Sequence[float]) -> list[list[float]]:
    # values that are one step each, ascending
    ascending = sorted(set(values))
    least = SAME_STEP * (ascending[-1] - ascending[0]) / max(1, len(ascending) - 1)
    found = [[ascending[0]]]
    for value in ascending[1:]:
        if value - found[-1][0] > least:
            found.append([value])
        else:
            found[-1].append(value)
    return found


def light_cells(
    grid: Sequence[tuple[float, ...]], left: Sequence[tuple[float, ...]], *, full_turn: bool
) -> tuple[tuple[Cell, ...], tuple[Int64, ...]]:
    """The cells of a light, ascending, and the candidates at their corners.

    grid: Its places before any was excluded.
    left: Those that are left, the candidates.
    full_turn: Whether its azimuths go all the way round.
    """
    axes = [list(values) for values in zip(*grid, strict=True)]
    wraps = [full_turn and axis == 1 for axis in range(len(axes))]
    starts = [[step[0] for step in _steps_of(values)] for values in axes]
    found: dict[tuple[int, ...], list[int]] = {}
    for number, place in enumerate(left):
        # a place is a corner of the cells that begin at its own steps and at those before
        ways: list[list[int]] = []
        for value, first, wrap in zip(place, starts, wraps, strict=True):
            own, count = bisect.bisect_right(first, value) - 1, len(first)
            if count == 1:
                ways.append([0])
            else:
                ways.append([k % count for k in (own - 1, own) if wrap or 0 <= k < count - 1])
        for cell in itertools.product(*ways):
            found.setdefault(cell, []).append(number)
    sides = [intervals(values, full_turn=wrap) for values, wrap in zip(axes, wraps, strict=True)]
    order = sorted(found)
    cells = tuple(tuple(side[k] for side, k in zip(sides, at, strict=True)) for at in order)
    return cells, tuple(np.array(found[at], np.int64) for at in order)


def cell_clashes(
    clashes: Mapping[tuple[int, int], Bool], corners: Sequence[Sequence[Int64]]
) -> dict[tuple[int, int], Bool]:
    """Pairs of cells all of whose corners collide, for the pairs of lights that have any."""
    found: dict[tuple[int, int], Bool] = {}
    for (i, j), clash in clashes.items():
        rows = np.array([clash[some].all(axis=0) for some in corners[i]])
        both = np.array([rows[:, some].all(axis=1) for some in corners[j]]).T
        if both.any():
            found[i, j] = both
    return found


def middle(cell: Cell) -> tuple[float, ...]:
    """The place midway between the corners of a cell."""
    return tuple(0.5 * (low + high) for low, high in cell)
