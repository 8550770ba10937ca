"""The part of a panel that a surface point sees when the part's own shadow edge crosses it.

Rays to the corners of a grid of cells distinguish visible cells from hidden ones. Where the edge of the shadow crosses
the side of a cell is found by bisection, and between two such crossings the edge is taken as straight. Rays beside the
middle of that chord test this; a cell where the edge is bent is divided into a finer grid. How far all this goes
depends on the light that is at stake in a cell: a cell of a tenth of a level is not refined.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Index, Int32, Int64, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.vectors import dot, minus, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelNumbers, panel_point
from lightopt.rendering._penumbra_cells import (
    BELOW,
    BLOCKED,
    MOST_BISECTIONS,
    SIDE_SHARE,
    VISIBLE,
    ConvergedLight,
    Edge,
    Squares,
    add_crossed_cells,
    add_visible_cells,
    places_beside_chords,
)
from lightopt.rendering._surface import PointRows, SurfacePoints

# cells along each side of the panel; of a cell where the edge is bent; and of such a cell of that finer grid
GRIDS = (8, 4, 4)

SQUARES_AT_ONCE = 4096  # squares whose rays are cast at once, some 10 MiB of them
LEVEL_TOLERANCE, RELATIVE_TOLERANCE = 0.05, 0.0005  # error of a penumbra that is aimed at: 0.05 level + 0.05 %
LEAST_BISECTIONS = 2  # rays that at least halve the side of a cell in search of the shadow's edge


@dataclass(frozen=True)
class _Work:
    """What is shaded, and the sums so far: the two terms (k, 2) and the levels of error allowed (k,)."""

    surface: SurfacePoints
    light: ConvergedLight
    caster: RayCaster
    terms: Float64
    tolerance: Float64


def shade_penumbra(surface: SurfacePoints, light: ConvergedLight, caster: RayCaster) -> tuple[Float64, Float64, Bool]:
    """Diffuse and specular light of the visible area of a panel of weight 1, per unit of R_d and R_s.

    Returns diffuse, specular, crossed: Each of shape (k,); `crossed` is whether the edge of a shadow crosses the panel
    """
    k = len(surface)
    work = _Work(surface, light, caster, terms=np.zeros((k, 2)), tolerance=np.zeros(k))
    whole = Squares(np.arange(k, dtype=np.int32), np.zeros(k), np.zeros(k), 1.0 / GRIDS[0])
    crossed = _shade_squares(work, whole, depth=0)
    return work.terms[:, 0], work.terms[:, 1], crossed


def _shade_squares(work: _Work, squares: Squares, *, depth: int) -> Bool:
    # adds the light of the visible area of squares; returns which of them the edge of a shadow crosses
    given = work.surface.rows, work.light, squares
    state = _states_at_corners(work, squares, GRIDS[depth])
    stake = add_visible_cells(*given, state, work.terms)
    if depth == 0:
        level = work.terms @ (work.light.diffuse_level, work.light.specular_level) + 0.5 * stake.sum(axis=(1, 2))
        work.tolerance[:] = LEVEL_TOLERANCE + RELATIVE_TOLERANCE * level
    stake /= work.tolerance[squares.point][:, None, None]
    across, along = (_edge_crossings(work, squares, state, stake, vertical=vertical) for vertical in (False, True))
    edge = Edge(state, across, along)
    last = depth + 1 == len(GRIDS)
    bent = np.zeros(stake.shape, np.bool_) if last else _bent_edges(work, squares, edge, stake)
    add_crossed_cells(*given, edge, stake, bent, work.terms)
    if bent.any():
        for finer in _finer_squares(squares, bent, divisions=GRIDS[depth + 1]):
            _shade_squares(work, finer, depth=depth + 1)
    return (state == VISIBLE).any(axis=(1, 2)) & (state == BLOCKED).any(axis=(1, 2))


def _finer_squares(squares: Squares, chosen: Bool, *, divisions: int) -> Iterator[Squares]:
    # the chosen cells, (q, n, n), each as a square of its own; as many at once as memory allows
    square, row, column = np.nonzero(chosen)
    point, cell = squares.point[square], squares.cell
    s, t = squares.s[square] + column * cell, squares.t[square] + row * cell
    for start in range(0, len(point), SQUARES_AT_ONCE):
        some = slice(start, start + SQUARES_AT_ONCE)
        yield Squares(point[some], s[some], t[some], cell / divisions)


def _states_at_corners(work: _Work, squares: Squares, n: int) -> UInt8:
    # what is seen at the corners of the cells, (q, n + 1, n + 1)
    square, row, column = (
        a.ravel() for a in np.meshgrid(np.arange(len(squares.point)), np.arange(n + 1), np.arange(n + 1), indexing="ij")
    )
    state = _states(work, squares, square, column, row)
    return state.reshape(len(squares.point), n + 1, n + 1)


def _states(work: _Work, squares: Squares, square: Index, x: NDArray[Any], y: NDArray[Any]) -> UInt8:
    # what is seen at places (x, y) of squares, counted in cells of their grid
    surface = work.surface
    state, undecided, point, targets = _horizon_state(surface.rows, work.light.panel, squares, square, x, y)
    # each ray has a target of its own
    index = np.arange(len(undecided), dtype=np.int32)
    blocked = work.caster.occluded(surface.points, surface.facets, targets, point_index=point, target_index=index)
    state[undecided] = np.where(blocked, BLOCKED, VISIBLE)
    return state


@kernel
def _horizon_state(
    rows: PointRows, panel: PanelNumbers, squares: Squares, square: Index, x: Any, y: Any
) -> tuple[UInt8, Int32, Int32, Float64]:
    # what the horizon decides: below the interpolated one there is no light, below the face's own plane the face is in
    # the way; the rest needs a ray
    points, frames, _, facets, _ = rows
    state = np.empty(len(square), np.uint8)
    undecided, origin = np.empty(len(square), np.int32), np.empty(len(square), np.int32)
    targets = np.empty((len(square), 3))
    m = 0
    for j in range(len(square)):
        i = squares.point[square[j]]
        s, t = squares.s[square[j]] + x[j] * squares.cell, squares.t[square[j]] + y[j] * squares.cell
        target = panel_point(panel, s - 0.5, t - 0.5)
        towards = minus(target, vector_at(points, i))
        if dot(vector_at(frames, i), towards) <= 0.0:
            state[j] = BELOW
        elif dot(vector_at(facets, i), towards) <= 0.0:
            state[j] = BLOCKED
        else:
            undecided[m], origin[m] = j, i
            targets[m, 0], targets[m, 1], targets[m, 2] = target
            m += 1
    return state, undecided[:m].copy(), origin[:m].copy(), targets[:m].copy()


def _edge_crossings(work: _Work, squares: Squares, state: UInt8, stake: Float64, *, vertical: bool) -> Float64:
    # where the shadow's edge crosses the sides of the cells that run along t (vertical) or along s: the share of the
    # side from its first corner; ½ where it does not cross
    square, row, column, steps, from_blocked = _crossed_sides(state, stake, vertical)
    low, high = np.zeros(len(square)), np.ones(len(square))
    for step in range(int(steps.max(initial=0))):
        j = np.flatnonzero(steps > step)
        middle = 0.5 * (low[j] + high[j])
        x, y = (column[j], row[j] + middle) if vertical else (column[j] + middle, row[j])
        seen = _states(work, squares, square[j], x, y)
        as_first = (seen == BLOCKED) == from_blocked[j]
        low[j] = np.where(as_first, middle, low[j])
        high[j] = np.where(as_first, high[j], middle)
    n = stake.shape[1]
    crossing = np.full((len(stake), n, n + 1) if vertical else (len(stake), n + 1, n), 0.5)
    crossing[square, row, column] = 0.5 * (low + high)
    return crossing


@kernel
def _crossed_sides(state: UInt8, stake: Float64, vertical: bool) -> tuple[Int64, Int64, Int64, Int64, Bool]:
    # sides of cells that the edge crosses, (square, row, column) of their first corners; how often they are halved in
    # search of it; and whether the first corner is hidden
    q, n = stake.shape[0], stake.shape[1]
    index = np.empty((4, q * n * (n + 1)), np.int64)
    from_blocked = np.empty(q * n * (n + 1), np.bool_)
    m = 0
    for i in range(q):
        for row in range(n if vertical else n + 1):
            for column in range(n + 1 if vertical else n):
                first = state[i, row, column] == BLOCKED
                second = (state[i, row + 1, column] if vertical else state[i, row, column + 1]) == BLOCKED
                if first == second:
                    continue
                # what is at stake in the cells on both sides; nothing at the horizon, where the light ends anyway
                at_stake = 0.0
                if row < n and column < n:
                    at_stake = stake[i, row, column]
                if vertical and column > 0:
                    at_stake = max(at_stake, stake[i, row, column - 1])
                if not vertical and row > 0:
                    at_stake = max(at_stake, stake[i, row - 1, column])
                if at_stake > 0.0:
                    steps = math.ceil(math.log2(SIDE_SHARE * at_stake))
                    index[0, m], index[1, m], index[2, m] = i, row, column
                    index[3, m] = min(max(steps, LEAST_BISECTIONS), MOST_BISECTIONS)
                    from_blocked[m] = first
                    m += 1
    return index[0, :m].copy(), index[1, :m].copy(), index[2, :m].copy(), index[3, :m].copy(), from_blocked[:m].copy()


def _bent_edges(work: _Work, squares: Squares, edge: Edge, stake: Float64) -> Bool:
    # cells where the edge of the shadow is not the chord between its crossings, as far as that matters
    bent, cell, x, y, expected = places_beside_chords(edge, stake)
    n = stake.shape[1]
    seen = _states(work, squares, cell // (n * n), x, y)
    bent.ravel()[cell[(seen == BLOCKED) != expected]] = True
    return bent
