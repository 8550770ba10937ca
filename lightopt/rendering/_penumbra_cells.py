"""Cells of a panel that the edge of a shadow crosses: where it cuts them, and the light of what is left.

Squares of the panel, several perhaps for one surface point, are divided into n × n cells. A cell is known by what
is seen at its corners, and by where the edge crosses its sides.

What the functions share
------------------------
state: What is seen at the corners of the cells, shape (q, n + 1, n + 1): BELOW, VISIBLE or BLOCKED
stake: Of crossed cells, the light of the whole cell in units of the error allowed; 0 of others; shape (q, n, n)
terms: Diffuse and specular light so far, per unit of R_d and R_s, of a panel of weight 1; shape (k, 2)
"""

import math
from typing import NamedTuple

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32, Int64, UInt8
from lightopt.core.kernels import kernel
from lightopt.lights import PanelNumbers
from lightopt.optics import DiffuseForm, Lobe, lobe_at
from lightopt.rendering._panel_quadrature import Rectangle, out_of_reach, rectangle_diffuse, rectangle_specular
from lightopt.rendering._surface import PointRows, point_at

# what a surface point sees at a place of the panel: its own horizon's far side, the panel, or an obstacle
BELOW, VISIBLE, BLOCKED = 1, 2, 3

# the edge is found to within a cell's side divided by this and by what is at stake in the cell, in tolerances
SIDE_SHARE = 8.0

MOST_BISECTIONS = 12  # the edge is not sought more finely than this many halvings of a side

# strips per square root of what is at stake in a cell: their error falls as the square of their number
STRIP_SHARE = 0.5

LEAST_STRIPS, MOST_STRIPS = 2, 16  # strips that the visible area of a crossed cell is integrated in


class ConvergedLight(NamedTuple):
    """A panel in the part's frame, and how bright its light is on a surface."""

    panel: PanelNumbers
    diffuse_level: float  # grey levels per unit of the two terms: R_d and R_s times the panel's total weight
    specular_level: float  # grey levels per unit of the two terms: R_d and R_s times the panel's total weight
    lobe: Lobe  # of the specular term
    form: DiffuseForm  # of the diffuse term
    # Gauss–Legendre nodes a side that the whole panel needs for its fall-off and emission; a cell needs fewer
    nodes: int


class Squares(NamedTuple):
    """Squares of the panel that are divided into a grid, q of them; several may belong to one surface point."""

    point: Int32  # surface point of each, shape (q,)
    s: Float64  # lower corner, in units of the panel's sides, from 0 to 1; shape (q,)
    t: Float64  # lower corner, in units of the panel's sides, from 0 to 1; shape (q,)
    cell: float  # side of the grid's cells, in the same units


class Edge(NamedTuple):
    """The edge of the shadow in the cells of some squares."""

    state: UInt8  # as in all functions
    # where it crosses the sides of cells that run along s and along t, as a share of the side; shape (q, n + 1, n) and
    # (q, n, n + 1)
    across: Float64
    along: Float64


@kernel
def places_beside_chords(edge: Edge, stake: Float64) -> tuple[Bool, Int64, Float64, Float64, Bool]:
    """Places that show whether the edge of the shadow is straight inside the crossed cells where that matters.

    They are on both sides of the chord between the edge's crossings, as far from it as the edge may be without harm.

    Returns bent: Cells that two stretches of edge cross, which need no test; shape (q, n, n)
        cell, x, y, expected: Index of each place's cell in the raveled (q, n, n); the place in its square, in cells;
        and whether a straight edge would hide it
    """
    q, n = stake.shape[0], stake.shape[1]
    bent = np.zeros(stake.shape, np.bool_)
    cell = np.empty(4 * np.count_nonzero(stake > 1.0), np.int64)
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
                    begins, ax, ay, bx, by, sign = _chord(edge, i, row, column, first)
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
def add_visible_cells(
    rows: PointRows, light: ConvergedLight, squares: Squares, state: UInt8, terms: Float64
) -> Float64:
    """Add the light of the visible cells to `terms`; return the levels of the whole of each crossed one, (q, n, n)."""
    point, s, t, cell = squares
    points, frames, views, _, _ = rows
    panel = light.panel
    q, n = len(point), state.shape[1] - 1
    stake = np.zeros((q, n, n))
    few = math.ceil(2.0 * light.nodes * cell)
    for i in range(q):
        k = point[i]
        at, lobe = point_at(points, frames, views, k), lobe_at(light.lobe, frames, k)
        glossy = at.n_dot_v > 0.0 and not out_of_reach(at, panel, lobe)
        for row in range(n):
            t0 = t[i] + row * cell - 0.5
            column = 0
            while column < n:
                kind = _cell_kind(state, i, row, column)
                end = column + 1
                if kind == BLOCKED:
                    column = end
                    continue
                # visible cells of one row in one go
                while kind == VISIBLE and end < n and _cell_kind(state, i, row, end) == kind:
                    end += 1
                area = Rectangle(s[i] + column * cell - 0.5, s[i] + end * cell - 0.5, t0, t0 + cell)
                order = max(2, math.ceil(light.nodes * (area.s1 - area.s0))) if kind == VISIBLE else few
                d = rectangle_diffuse(at, panel, area, light.form, order)
                g = rectangle_specular(at, panel, area, lobe, light.nodes) if glossy else 0.0
                if kind == VISIBLE:
                    terms[k, 0] += d
                    terms[k, 1] += g
                else:
                    stake[i, row, column] = light.diffuse_level * d + light.specular_level * g
                column = end
    return stake


@kernel
def add_crossed_cells(
    rows: PointRows, light: ConvergedLight, squares: Squares, edge: Edge, stake: Float64, left_out: Bool, terms: Float64
) -> None:
    """Add the light of the visible part of the crossed cells, except those `left_out`, to `terms`."""
    point, s, t, cell = squares
    points, frames, views, _, _ = rows
    panel = light.panel
    q, n = len(point), edge.state.shape[1] - 1
    runs = np.empty((4 * MOST_STRIPS, 4))
    few = math.ceil(2.0 * light.nodes * cell)
    for i in range(q):
        k = point[i]
        at, lobe = point_at(points, frames, views, k), lobe_at(light.lobe, frames, k)
        glossy = at.n_dot_v > 0.0 and not out_of_reach(at, panel, lobe)
        for row in range(n):
            for column in range(n):
                if _cell_kind(edge.state, i, row, column) != 0 or left_out[i, row, column]:
                    continue
                strips = math.ceil(math.sqrt(STRIP_SHARE * stake[i, row, column]))
                strips = min(max(strips, LEAST_STRIPS), MOST_STRIPS)
                count = _visible_strips(edge, i, row, column, strips, runs)
                for j in range(count):
                    s0, s1 = s[i] + runs[j, 0] * cell - 0.5, s[i] + runs[j, 1] * cell - 0.5
                    t0, t1 = t[i] + runs[j, 2] * cell - 0.5, t[i] + runs[j, 3] * cell - 0.5
                    area = Rectangle(s0, s1, t0, t1)
                    terms[k, 0] += rectangle_diffuse(at, panel, area, light.form, few)
                    if glossy:
                        terms[k, 1] += rectangle_specular(at, panel, area, lobe, light.nodes)


@kernel
def _cell_kind(state: UInt8, i: int, row: int, column: int) -> int:
    # VISIBLE, BLOCKED, or 0 where the edge of the shadow crosses the cell
    visible = blocked = 0
    for corner in range(4):
        value = state[i, row + corner // 2, column + corner % 2]
        visible += value == VISIBLE
        blocked += value == BLOCKED
    if visible == 0:
        return BLOCKED
    return VISIBLE if blocked == 0 else 0


@kernel
def _chord(edge: Edge, i: int, row: int, column: int, first: int) -> tuple[bool, float, float, float, float, float]:
    # the chord that cuts off the visible stretch of a cell's boundary that begins with corner `first`, if one does: its
    # ends (ax, ay), (bx, by) and the sign with which sign·((bx − ax)·(y − ay) − (by − ay)·(x − ax)) ≥ 0 is visible.
    # Corners and sides go round the cell: corner c is followed by side c; x and y in [0, 1] are the cell's own
    state, across, along = edge
    corner_x, corner_y = (0.0, 1.0, 1.0, 0.0), (0.0, 0.0, 1.0, 1.0)
    seen = (
        state[i, row, column] != BLOCKED,
        state[i, row, column + 1] != BLOCKED,
        state[i, row + 1, column + 1] != BLOCKED,
        state[i, row + 1, column] != BLOCKED,
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
def _visible_strips(edge: Edge, i: int, row: int, column: int, strips: int, runs: Float64) -> int:
    # strips [s0, s1] × [t0, t1], in cells, that cover the visible area of a cell; returns their number
    count = 0
    for first in range(4):
        begins, ax, ay, bx, by, sign = _chord(edge, i, row, column, first)
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
