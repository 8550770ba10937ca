"""The part of a panel that a surface point sees when the part's own shadow edge crosses it.

Rays to the corners of a grid of cells tell visible cells from hidden ones; where the edge of the shadow crosses the
side of a cell is found by bisection, and between two such crossings the edge is taken as straight. Rays beside the
middle of that chord tell whether it is; a cell where it is not is divided into a finer grid. How far all this goes
depends on the light that is at stake in a cell: a cell worth a tenth of a level is not looked at twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.raycast import RayCaster
from lightopt.rendering._lobe import out_of_reach, rectangle_diffuse, rectangle_specular
from lightopt.rendering._panel import PanelNumbers
from lightopt.rendering._surface import SurfacePoints

__all__ = ["HORIZON_NODES", "PenumbraLight", "shade_penumbra"]

Float64 = NDArray[np.float64]
Bool = NDArray[np.bool_]
State = NDArray[np.uint8]

GRIDS = (8, 4, 4)
"""Cells along each side of the panel; of a cell whose piece of edge is bent; and of such a cell of that finer grid."""

SQUARES_AT_ONCE = 4096
"""Squares whose rays are cast at once, some 10 MiB of them."""

LEVEL_TOLERANCE, RELATIVE_TOLERANCE = 0.05, 0.0005
"""Error of a penumbra that is aimed at: 0.05 level + 0.05 %."""

SIDE_SHARE = 4.0
"""The edge is found to within a cell's side divided by this and by what is at stake in the cell, in tolerances."""

LEAST_BISECTIONS, MOST_BISECTIONS = 2, 12
"""Rays that halve the side of a cell in search of the shadow's edge."""

STRIP_SHARE = 0.5
LEAST_STRIPS, MOST_STRIPS = 2, 16
"""Strips that the visible area of a crossed cell is integrated in; their error falls as the square of their number."""

HORIZON_NODES = 6
"""Gauss–Legendre nodes a side where the panel is partly below the surface's horizon."""

_BELOW, _VISIBLE, _BLOCKED = 1, 2, 3


@dataclass(frozen=True)
class PenumbraLight:
    """A panel, and what its light is worth.

    Attributes
    ----------
    panel
        Part frame.
    diffuse_level, specular_level
        Grey levels per unit of the two terms: R_d and R_s times the panel's total weight.
    inverse_two_sigma_squared
        1/(2σ²) [rad⁻²].
    rules
        Gauss–Legendre nodes and weights.
    """

    panel: PanelNumbers
    diffuse_level: float
    specular_level: float
    inverse_two_sigma_squared: float
    rules: tuple[Float64, Float64]


@dataclass(frozen=True)
class _Squares:
    """Pieces of the panel that a grid is laid over; several of them may belong to one surface point.

    Lower corners `s`, `t` and `cell`, the side of a cell of the grid, in units of the panel's sides, from 0 to 1.
    """

    point: NDArray[np.int32]
    s: Float64
    t: Float64
    cell: float

    def cells(self, which: Bool, *, divisions: int) -> _Squares:
        """The chosen cells, (q, n, n), each as a square of its own."""
        square, row, column = np.nonzero(which)
        return _Squares(
            self.point[square],
            self.s[square] + column * self.cell,
            self.t[square] + row * self.cell,
            self.cell / divisions,
        )

    def split(self) -> list[_Squares]:
        """Lots that are worked on at once."""
        starts = range(0, len(self.point), SQUARES_AT_ONCE)
        return [
            _Squares(self.point[part], self.s[part], self.t[part], self.cell)
            for part in (slice(start, start + SQUARES_AT_ONCE) for start in starts)
        ]


@dataclass(frozen=True)
class _Work:
    """What is shaded, and the sums so far: the two terms (k, 2) and the levels of error allowed (k,)."""

    surface: SurfacePoints
    light: PenumbraLight
    caster: RayCaster
    terms: Float64
    tolerance: Float64


def shade_penumbra(
    surface: SurfacePoints, light: PenumbraLight, caster: RayCaster
) -> tuple[Float64, Float64, Bool]:
    """Diffuse and specular light of the visible area of a panel of weight 1, per unit of R_d and R_s.

    Parameters
    ----------
    surface
        k surface points, part frame.
    light
        The panel.
    caster
        Of the part.

    Returns
    -------
    diffuse, specular, crossed
        Each of shape (k,); `crossed` is whether the edge of a shadow crosses the panel.
    """
    k = len(surface)
    work = _Work(surface, light, caster, terms=np.zeros((k, 2)), tolerance=np.zeros(k))
    whole = _Squares(np.arange(k, dtype=np.int32), np.zeros(k), np.zeros(k), 1.0 / GRIDS[0])
    crossed = _shade_squares(work, whole, depth=0)
    return work.terms[:, 0], work.terms[:, 1], crossed


def _shade_squares(work: _Work, squares: _Squares, *, depth: int) -> Bool:
    # adds the light of the visible area of squares; returns which of them the edge of a shadow crosses
    surface, light = work.surface, work.light
    geometry = surface.points, surface.normals, surface.views, light.panel
    place = squares.point, squares.s, squares.t, squares.cell
    lobe = light.inverse_two_sigma_squared, *light.rules
    state = _look_at_corners(work, squares, GRIDS[depth])
    stake = _whole_cells(
        *geometry, *place, state, light.diffuse_level, light.specular_level, *lobe, work.terms
    )
    if depth == 0:
        level = work.terms @ (light.diffuse_level, light.specular_level) + 0.5 * stake.sum(axis=(1, 2))
        work.tolerance[:] = LEVEL_TOLERANCE + RELATIVE_TOLERANCE * level
    stake /= work.tolerance[squares.point][:, None, None]
    across = _edge_crossings(work, squares, state, stake, vertical=False)
    along = _edge_crossings(work, squares, state, stake, vertical=True)
    last = depth + 1 == len(GRIDS)
    bent = (
        np.zeros(stake.shape, np.bool_) if last else _bent_edges(work, squares, state, stake, across, along)
    )
    _crossed_cells(*geometry, *place, state, across, along, stake, bent, *lobe, work.terms)
    if bent.any():
        for finer in squares.cells(bent, divisions=GRIDS[depth + 1]).split():
            _shade_squares(work, finer, depth=depth + 1)
    return (state == _VISIBLE).any(axis=(1, 2)) & (state == _BLOCKED).any(axis=(1, 2))


def _look_at_corners(work: _Work, squares: _Squares, n: int) -> State:
    # what is seen at the corners of the cells, (q, n + 1, n + 1)
    square, row, column = (
        a.ravel()
        for a in np.meshgrid(np.arange(len(squares.point)), np.arange(n + 1), np.arange(n + 1), indexing="ij")
    )
    state = _look(work, squares, square, column, row)
    return state.reshape(len(squares.point), n + 1, n + 1)


def _look(
    work: _Work, squares: _Squares, square: NDArray[np.intp], x: NDArray[Any], y: NDArray[Any]
) -> State:
    # what is seen at places (x, y) of squares, counted in cells of their grid
    surface, point = work.surface, squares.point[square]
    s, t = squares.s[square] + x * squares.cell, squares.t[square] + y * squares.cell
    state, asked, targets = _horizon_state(
        surface.points, surface.normals, surface.facets, work.light.panel, point, s, t
    )
    blocked = work.caster.occluded_from(surface.points, surface.facets, targets, point_index=point[asked])
    state[asked] = np.where(blocked, _BLOCKED, _VISIBLE)
    return state


@kernel
def _horizon_state(
    points: Float64,
    normals: Float64,
    facets: Float64,
    panel: PanelNumbers,
    point: NDArray[np.int32],
    s: Float64,
    t: Float64,
) -> tuple[State, NDArray[np.int32], Float64]:
    # what the horizon decides: below the interpolated one there is no light, below the face's own plane the face is in
    # the way; the rest needs a ray
    state = np.empty(len(point), np.uint8)
    asked = np.empty(len(point), np.int32)
    targets = np.empty((len(point), 3))
    m = 0
    for j in range(len(point)):
        i = point[j]
        a, b = s[j] - 0.5, t[j] - 0.5
        targets[m, 0] = panel.centre_x + a * panel.across_x + b * panel.along_x
        targets[m, 1] = panel.centre_y + a * panel.across_y + b * panel.along_y
        targets[m, 2] = panel.centre_z + a * panel.across_z + b * panel.along_z
        height = plane = 0.0
        for axis in range(3):
            height += normals[i, axis] * (targets[m, axis] - points[i, axis])
            plane += facets[i, axis] * (targets[m, axis] - points[i, axis])
        if height <= 0.0:
            state[j] = _BELOW
        elif plane <= 0.0:
            state[j] = _BLOCKED
        else:
            asked[m] = j
            m += 1
    return state, asked[:m].copy(), targets[:m].copy()


def _edge_crossings(
    work: _Work, squares: _Squares, state: State, stake: Float64, *, vertical: bool
) -> Float64:
    # where the shadow's edge crosses the sides of the cells that run along t (vertical) or along s: the share of the
    # side from its first corner; ½ where it does not cross
    axis = 2 if vertical else 1
    blocked = state == _BLOCKED
    first, second = (blocked[:, :-1], blocked[:, 1:]) if vertical else (blocked[:, :, :-1], blocked[:, :, 1:])
    # what is at stake in the cells on both sides; nothing at the horizon, where the light ends anyway
    widths = [(0, 0), (0, 0), (0, 0)]
    widths[axis] = (1, 1)
    padded = np.pad(stake, widths)
    n = stake.shape[axis]
    beside = np.maximum(padded.take(range(n + 1), axis), padded.take(range(1, n + 2), axis))
    crossing = np.full(first.shape, 0.5)
    where = np.nonzero((first != second) & (beside > 0.0))
    square, row, column = where
    steps = np.clip(np.ceil(np.log2(SIDE_SHARE * beside[where])), LEAST_BISECTIONS, MOST_BISECTIONS).astype(
        np.intp
    )
    from_blocked = first[where]
    low, high = np.zeros(len(square)), np.ones(len(square))
    for step in range(int(steps.max(initial=0))):
        j = np.flatnonzero(steps > step)
        middle = 0.5 * (low[j] + high[j])
        x, y = (column[j], row[j] + middle) if vertical else (column[j] + middle, row[j])
        seen = _look(work, squares, square[j], x, y)
        as_first = (seen == _BLOCKED) == from_blocked[j]
        low[j] = np.where(as_first, middle, low[j])
        high[j] = np.where(as_first, high[j], middle)
    crossing[where] = 0.5 * (low + high)
    return crossing


def _bent_edges(
    work: _Work, squares: _Squares, state: State, stake: Float64, across: Float64, along: Float64
) -> Bool:
    # cells where the edge of the shadow is not the chord between its crossings, as far as that matters
    bent, cell, x, y, expected = _places_beside_chords(state, stake, across, along)
    n = stake.shape[1]
    seen = _look(work, squares, cell // (n * n), x, y)
    bent.ravel()[cell[(seen == _BLOCKED) != expected]] = True
    return bent


@kernel
def _places_beside_chords(
    state: State, stake: Float64, across: Float64, along: Float64
) -> tuple[Bool, NDArray[np.int64], Float64, Float64, Bool]:
    # places (x, y), in cells, to look at: near a chord on both sides, and whether they should be blocked. They are as
    # far from it as the edge may be without doing harm. Cells with two chords are bent at once
    q, n = stake.shape[0], stake.shape[1]
    bent = np.zeros(stake.shape, np.bool_)
    candidates = 0
    for i in range(q):
        for row in range(n):
            for column in range(n):
                candidates += stake[i, row, column] > 1.0
    cell = np.empty(4 * candidates, np.int64)
    x, y = np.empty(len(cell)), np.empty(len(cell))
    expected = np.empty(len(cell), np.bool_)
    m = 0
    for i in range(q):
        for row in range(n):
            for column in range(n):
                if stake[i, row, column] <= 1.0:
                    continue
                chords = 0
                for first in range(4):
                    begins, ax, ay, bx, by, sign = _chord(state, across, along, i, row, column, first)
                    if not begins:
                        continue
                    chords += 1
                    if chords == 2:
                        bent[i, row, column] = True
                        break
                    length = math.hypot(bx - ax, by - ay)
                    if length < 1e-6:
                        continue
                    away = max(1.0 / (SIDE_SHARE * stake[i, row, column]), 0.5**MOST_BISECTIONS)
                    nx, ny = -sign * (by - ay) / length * away, sign * (bx - ax) / length * away
                    for k in range(2):
                        share = (k + 1) / 3.0
                        cx, cy = ax + share * (bx - ax), ay + share * (by - ay)
                        for side in (-1.0, 1.0):
                            px, py = cx + side * nx, cy + side * ny
                            if 0.0 <= px <= 1.0 and 0.0 <= py <= 1.0:
                                cell[m] = (i * n + row) * n + column
                                x[m], y[m] = column + px, row + py
                                expected[m] = side < 0.0
                                m += 1
    return bent, cell[:m].copy(), x[:m].copy(), y[:m].copy(), expected[:m].copy()


@kernel
def _whole_cells(
    points: Float64,
    normals: Float64,
    views: Float64,
    panel: PanelNumbers,
    point: NDArray[np.int32],
    s: Float64,
    t: Float64,
    cell: float,
    state: State,
    diffuse_level: float,
    specular_level: float,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
    terms: Float64,
) -> Float64:
    # adds the light of the visible cells to `terms` (k, 2), and returns the levels at stake in the crossed ones
    q, n = len(point), state.shape[1] - 1
    stake = np.zeros((q, n, n))
    for i in range(q):
        k = point[i]
        p, normal, v = points[k], normals[k], views[k]
        n_dot_v = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2]
        glossy = n_dot_v > 0.0 and not out_of_reach(p, normal, v, panel, inverse_two_sigma_squared)
        for row in range(n):
            t0 = t[i] + row * cell - 0.5
            column = 0
            while column < n:
                kind, order = _cell_kind(state, i, row, column)
                end = column + 1
                if kind == _BLOCKED:
                    column = end
                    continue
                # visible cells of one row in one go
                while kind == _VISIBLE and end < n and _cell_kind(state, i, row, end) == (kind, order):
                    end += 1
                s0, s1 = s[i] + column * cell - 0.5, s[i] + end * cell - 0.5
                d = rectangle_diffuse(p, normal, v, panel, s0, s1, t0, t0 + cell, order, nodes, weights)
                g = 0.0
                if glossy:
                    g = rectangle_specular(
                        p,
                        normal,
                        v,
                        n_dot_v,
                        panel,
                        s0,
                        s1,
                        t0,
                        t0 + cell,
                        inverse_two_sigma_squared,
                        nodes,
                        weights,
                    )
                if kind == _VISIBLE:
                    terms[k, 0] += d
                    terms[k, 1] += g
                else:
                    stake[i, row, column] = diffuse_level * d + specular_level * g
                column = end
    return stake


@kernel
def _crossed_cells(
    points: Float64,
    normals: Float64,
    views: Float64,
    panel: PanelNumbers,
    point: NDArray[np.int32],
    s: Float64,
    t: Float64,
    cell: float,
    state: State,
    across: Float64,
    along: Float64,
    stake: Float64,
    left_out: Bool,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
    terms: Float64,
) -> None:
    # adds the light of the visible part of the crossed cells to `terms` (k, 2)
    q, n = len(point), state.shape[1] - 1
    runs = np.empty((4 * MOST_STRIPS, 4))
    for i in range(q):
        k = point[i]
        p, normal, v = points[k], normals[k], views[k]
        n_dot_v = normal[0] * v[0] + normal[1] * v[1] + normal[2] * v[2]
        glossy = n_dot_v > 0.0 and not out_of_reach(p, normal, v, panel, inverse_two_sigma_squared)
        for row in range(n):
            for column in range(n):
                kind, order = _cell_kind(state, i, row, column)
                if kind != 0 or left_out[i, row, column]:
                    continue
                strips = math.ceil(math.sqrt(STRIP_SHARE * stake[i, row, column]))
                strips = min(max(strips, LEAST_STRIPS), MOST_STRIPS)
                count = _visible_strips(state, across, along, i, row, column, strips, runs)
                for j in range(count):
                    s0, s1 = s[i] + runs[j, 0] * cell - 0.5, s[i] + runs[j, 1] * cell - 0.5
                    t0, t1 = t[i] + runs[j, 2] * cell - 0.5, t[i] + runs[j, 3] * cell - 0.5
                    terms[k, 0] += rectangle_diffuse(
                        p, normal, v, panel, s0, s1, t0, t1, order, nodes, weights
                    )
                    if glossy:
                        terms[k, 1] += rectangle_specular(
                            p,
                            normal,
                            v,
                            n_dot_v,
                            panel,
                            s0,
                            s1,
                            t0,
                            t1,
                            inverse_two_sigma_squared,
                            nodes,
                            weights,
                        )


@kernel
def _cell_kind(state: State, i: int, row: int, column: int) -> tuple[int, int]:
    # _VISIBLE, _BLOCKED, or 0 where the edge of the shadow crosses the cell; and the nodes that its light needs
    visible = blocked = below = 0
    for corner in range(4):
        value = state[i, row + corner // 2, column + corner % 2]
        visible += value == _VISIBLE
        blocked += value == _BLOCKED
        below += value == _BELOW
    order = HORIZON_NODES if below > 0 else 2
    if visible == 0:
        return _BLOCKED, order
    if blocked == 0:
        return _VISIBLE, order
    return 0, HORIZON_NODES if below > 0 else 1


@kernel
def _chord(
    state: State, across: Float64, along: Float64, i: int, row: int, column: int, first: int
) -> tuple[bool, float, float, float, float, float]:
    # the chord that cuts off the visible stretch of a cell's boundary that begins with corner `first`, if one does: its
    # ends (ax, ay), (bx, by) and the sign with which sign·((bx − ax)·(y − ay) − (by − ay)·(x − ax)) ≥ 0 is visible.
    # Corners and sides go round the cell: corner c is followed by side c; x and y in [0, 1] are the cell's own
    corner_x = (0.0, 1.0, 1.0, 0.0)
    corner_y = (0.0, 0.0, 1.0, 1.0)
    seen = (
        state[i, row, column] != _BLOCKED,
        state[i, row, column + 1] != _BLOCKED,
        state[i, row + 1, column + 1] != _BLOCKED,
        state[i, row + 1, column] != _BLOCKED,
    )
    if not seen[first] or seen[(first + 3) % 4]:
        return False, 0.0, 0.0, 0.0, 0.0, 0.0
    side_x = (across[i, row, column], 1.0, across[i, row + 1, column], 0.0)
    side_y = (0.0, along[i, row, column + 1], 1.0, along[i, row, column])
    last = first
    while seen[(last + 1) % 4]:
        last = (last + 1) % 4
    # the stretch begins on the side before its first corner and ends on that after its last
    ax, ay = side_x[(first + 3) % 4], side_y[(first + 3) % 4]
    bx, by = side_x[last], side_y[last]
    inside = (bx - ax) * (corner_y[first] - ay) - (by - ay) * (corner_x[first] - ax)
    return True, ax, ay, bx, by, 1.0 if inside >= 0.0 else -1.0


@kernel
def _visible_strips(
    state: State,
    across: Float64,
    along: Float64,
    i: int,
    row: int,
    column: int,
    strips: int,
    runs: Float64,
) -> int:
    # strips [s0, s1] × [t0, t1], in cells, that cover the visible area of a cell; returns their number
    count = 0
    for first in range(4):
        begins, ax, ay, bx, by, sign = _chord(state, across, along, i, row, column, first)
        if not begins:
            continue
        # strips run across the edge, so that each is cut where the edge is and not counted whole or not at all
        upright = abs(bx - ax) > abs(by - ay)
        for strip in range(strips):
            middle = (strip + 0.5) / strips
            if upright:
                slope = sign * (bx - ax)
                value = -sign * ((bx - ax) * ay + (by - ay) * (middle - ax))
            else:
                slope = -sign * (by - ay)
                value = sign * ((bx - ax) * (middle - ay) + (by - ay) * ax)
            low, high = 0.0, 1.0
            if slope > 1e-12:
                low = max(low, -value / slope)
            elif slope < -1e-12:
                high = min(high, -value / slope)
            elif value < 0.0:
                continue
            if low < high:
                first_end, second_end = strip / strips, (strip + 1) / strips
                if upright:
                    runs[count, 0], runs[count, 1] = column + first_end, column + second_end
                    runs[count, 2], runs[count, 3] = row + low, row + high
                else:
                    runs[count, 0], runs[count, 1] = column + low, column + high
                    runs[count, 2], runs[count, 3] = row + first_end, row + second_end
                count += 1
    return count
