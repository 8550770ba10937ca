"""Cells of the grid of candidate positions: what lies between neighbouring candidates of a light."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Int64
from lightopt.design.search._exact_search import CombinationSpace
from lightopt.lights import PanelLight

Interval = tuple[float, float]  # from one step of an angle [°] or distance [mm] to the next; a single value twice
Cell = tuple[Interval, ...]  # of elevation, azimuth and, with a range of distances, distance


@dataclass(frozen=True, eq=False)
class LightCells:
    """The cells of a light that have a candidate at one of their corners or more, ascending."""

    cells: tuple[Cell, ...]
    corners: tuple[Int64, ...]  # of each cell: indices of candidates, then of what is beyond them
    beyond: tuple[PanelLight, ...]  # the light at the other corners, which are excluded as positions

    @property
    def moves(self) -> bool:
        """Whether there is anything between the candidates."""
        return any(low < high for cell in self.cells for low, high in cell)


@dataclass(frozen=True, eq=False)
class Cells:
    of_lights: tuple[LightCells, ...]  # in the rig's order
    space: CombinationSpace  # in which positions between the candidates can be combined

    @property
    def moves(self) -> bool:
        """Whether there is anything between the candidates of some light."""
        return any(own.moves for own in self.of_lights)


def intervals(values: Sequence[float], *, full_turn: bool = False) -> list[Interval]:
    """What lies between neighbouring values, ascending; a single value is one interval.

    full_turn: Whether the last value is followed by the first, 360 degrees later.
    """
    if len(values) == 1:
        return [(values[0], values[0])]
    return [*itertools.pairwise(values), *([(values[-1], values[0] + 360.0)] if full_turn else [])]


def light_cells(
    axes: Sequence[Sequence[float]],
    grid: Sequence[tuple[float, ...]],
    candidates: Sequence[tuple[float, ...]],
    panels: Mapping[tuple[float, ...], PanelLight],
    *,
    full_turn: bool,
) -> LightCells:
    """The cells of a light.

    axes: Steps of elevation, azimuth and perhaps distance, each ascending.
    grid: Its places, every combination of the steps in this order; some may be where the light was measured instead.
    candidates: Those of them that are allowed.
    panels: The light at each place.
    full_turn: Whether its azimuths go all the way round.
    """
    index = {place: k for k, place in enumerate(candidates)}
    numbers = np.arange(len(grid)).reshape([len(values) for values in axes])
    sides = [intervals(values, full_turn=full_turn and axis == 1) for axis, values in enumerate(axes)]
    beyond: dict[tuple[float, ...], int] = {}
    cells: list[Cell] = []
    corners: list[Int64] = []
    for at in itertools.product(*(range(len(side)) for side in sides)):
        ways = [sorted({k, (k + 1) % len(values)}) for k, values in zip(at, axes, strict=True)]
        around = dict.fromkeys(grid[k] for k in numbers[np.ix_(*ways)].ravel().tolist())
        if not any(place in index for place in around):
            continue
        cells.append(tuple(side[k] for side, k in zip(sides, at, strict=True)))
        own = [index[p] if p in index else len(index) + beyond.setdefault(p, len(beyond)) for p in around]
        corners.append(np.array(sorted(own), np.int64))
    return LightCells(tuple(cells), tuple(corners), tuple(panels[place] for place in beyond))


def cell_clashes(clashes: Mapping[tuple[int, int], Bool], lights: Sequence[LightCells]) -> dict[tuple[int, int], Bool]:
    """Pairs of cells all of whose allowed corners collide, for the pairs of lights that have any."""
    found: dict[tuple[int, int], Bool] = {}
    for (i, j), clash in clashes.items():
        first, second = ([own[own < n] for own in lights[k].corners] for k, n in zip((i, j), clash.shape, strict=True))
        rows = np.array([clash[some].all(axis=0) for some in first])
        both = np.array([rows[:, some].all(axis=1) for some in second]).T
        if both.any():
            found[i, j] = both
    return found


def places_inside(cell: Cell) -> list[tuple[float, ...]]:
    """The middle of a cell and a place to either side of it, at a quarter or three quarters of every interval."""
    shares = ((0.25, 0.75), (0.5, 0.5), (0.75, 0.25))
    return [tuple(low + share[k % 2] * (high - low) for k, (low, high) in enumerate(cell)) for share in shares]
