"""The part of a panel that a surface point sees when the part's own shadow edge crosses it.

What is seen at the corners of a grid of cells distinguishes visible cells from hidden ones. Where the edge of the
shadow crosses the side of a cell is found by bisection, and between two such crossings the edge is taken as straight.
Places beside the middle of that chord test this; a cell where the edge is bent is divided into a finer grid. How far
all this goes depends on the light that is at stake in a cell: a cell of a tenth of a level is not refined.

What is seen at a place is known from the part's silhouettes, which a ray or two per point make absolute; a ray decides
where these disagree, or where there are too many silhouettes.

Squares of the panel, several perhaps for one surface point, are divided into n × n cells. A cell is known by what is
seen at its corners, and by where the edge crosses its sides.

What the functions share
------------------------
state: What is seen at the corners of the cells, shape (q, n + 1, n + 1): BELOW, VISIBLE or BLOCKED
stake: Of crossed cells, the light of the whole cell in units of the error allowed; 0 of others; shape (q, n, n)
terms: Diffuse and specular light so far, per unit of R_d and R_s, of a panel of weight 1; shape (k, 2)
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Index, Int32, Int64, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.vectors import dot, minus, vector_at
from lightopt.geometry import RayCaster, Silhouettes, triangles_before, triangles_in_row
from lightopt.lights import PanelNumbers, panel_point
from lightopt.optics import DiffuseForm, Lobe, lobe_at
from lightopt.rendering._panel_quadrature import (
    Plane,
    Rectangle,
    out_of_reach,
    plane_over,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._surface import PointRows, SurfacePoint, SurfacePoints, point_at
from lightopt.rendering._tail_polynomial import MOST_TERMS, polynomial_light, tail_polynomial

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
    diffuse_level: float  # grey levels per unit of the diffuse term: R_d times the panel's total weight
    specular_level: float  # grey levels per unit of the specular term: R_s times the panel's total weight
    lobe: Lobe  # of the specular term
    form: DiffuseForm  # of the diffuse term
    # Gauss–Legendre nodes a side that the whole panel needs for its fall-off and emission; a cell needs fewer
    nodes: int


class Squares(NamedTuple):
    """Squares of the panel that are divided into a grid, q of them; several may belong to one surface point."""

    point: Int32  # surface point of each, shape (q,)
    s: Float64  # lower corner along s, in units of the panel's sides, from 0 to 1; shape (q,)
    t: Float64  # lower corner along t, in units of the panel's sides, from 0 to 1; shape (q,)
    cell: float  # side of the grid's cells, in the same units


class Tails(NamedTuple):
    """The tails of GGX over some squares as polynomials, where they are smooth all over them."""

    terms: Int64  # a side of each square's polynomial; 0 where it has none; shape (q,)
    polynomials: Float64  # shape (q, MOST_TERMS, MOST_TERMS), of none if the lobe has no tails


class Shadow(NamedTuple):
    """What hides a panel from k surface points."""

    silhouettes: Silhouettes
    # a place is seen where the silhouettes count as many triangles before it as the first number, and hidden where they
    # count as many as the second one, or more; a ray decides where neither holds; shape (k, 2)
    counts: Int64


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
def tails_over(rows: PointRows, light: ConvergedLight, squares: Squares, n: int) -> Tails:
    """The tails over squares that are divided into n × n cells."""
    points, frames, views, _, _ = rows
    terms = np.zeros(len(squares.point), np.int64)
    polynomials = np.empty((len(terms) if light.lobe.ggx else 0, MOST_TERMS, MOST_TERMS))
    for i in range(len(polynomials)):
        at = point_at(points, frames, views, squares.point[i])
        terms[i] = tail_polynomial(at, light.panel, _area(squares, i, n), light.lobe, light.nodes, polynomials[i])
    return Tails(terms, polynomials)


@kernel
def add_visible_cells(
    rows: PointRows, light: ConvergedLight, squares: Squares, state: UInt8, tails: Tails, terms: Float64
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
                g = _specular(at, light, lobe, area, squares, tails, i, n) if glossy else 0.0
                if kind == VISIBLE:
                    terms[k, 0] += d
                    terms[k, 1] += g
                else:
                    stake[i, row, column] = light.diffuse_level * d + light.specular_level * g
                column = end
    return stake


@kernel
def add_crossed_cells(
    rows: PointRows,
    light: ConvergedLight,
    squares: Squares,
    edge: Edge,
    stake: Float64,
    left_out: Bool,
    tails: Tails,
    terms: Float64,
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
                        terms[k, 1] += _specular(at, light, lobe, area, squares, tails, i, n)


@kernel
def _specular(
    at: SurfacePoint, light: ConvergedLight, lobe: Lobe, area: Rectangle, squares: Squares, tails: Tails, i: int, n: int
) -> float:
    # of an area of square i
    if tails.terms[i] > 0:
        return polynomial_light(tails.polynomials[i], tails.terms[i], _area(squares, i, n), area)
    return rectangle_specular(at, light.panel, area, lobe, light.nodes)


@kernel
def _area(squares: Squares, i: int, n: int) -> Rectangle:
    # square i of n × n cells
    s0, t0, side = squares.s[i] - 0.5, squares.t[i] - 0.5, n * squares.cell
    return Rectangle(s0, s0 + side, t0, t0 + side)


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


# cells along each side of the panel; of a cell where the edge is bent; and of such a cell of that finer grid
GRIDS = (8, 4, 4)

SQUARES_AT_ONCE = 4096  # squares whose rays are cast at once, some 10 MiB of them
LEVEL_TOLERANCE, RELATIVE_TOLERANCE = 0.05, 0.0005  # error of a penumbra that is aimed at: 0.05 level + 0.05 %
LEAST_BISECTIONS = 2  # halvings, at least, of a cell's side in search of the shadow's edge

_REFERENCES = 5  # places a side, of which rays go to the ones with the fewest and with the most triangles before them
_AMID = 4  # such places, itself and neighbours of it, show that none passes by a hair's breadth
_FEWEST, _MOST = 0, 1
_NO_PLACE = np.iinfo(np.int64).max // 2  # triangles before a place that the horizon hides; no place has as many


class _Horizons(NamedTuple):
    """Height of the panel above a point's tangent plane and above the plane of its face."""

    tangent: Plane
    face: Plane


@dataclass(frozen=True)
class _Work:
    """What is shaded, and the sums so far: the two terms (k, 2) and the levels of error allowed (k,)."""

    surface: SurfacePoints
    light: ConvergedLight
    caster: RayCaster
    shadow: Shadow
    terms: Float64
    tolerance: Float64


def shade_penumbra(surface: SurfacePoints, light: ConvergedLight, caster: RayCaster) -> tuple[Float64, Float64, Bool]:
    """Diffuse and specular light of the visible area of a panel of weight 1, per unit of R_d and R_s.

    Returns diffuse, specular, crossed: Each of shape (k,); `crossed` is whether the edge of a shadow crosses the panel
    """
    k = len(surface)
    shadow = _shadow(surface, light.panel, caster)
    work = _Work(surface, light, caster, shadow, terms=np.zeros((k, 2)), tolerance=np.zeros(k))
    whole = Squares(np.arange(k, dtype=np.int32), np.zeros(k), np.zeros(k), 1.0 / GRIDS[0])
    crossed = _shade_squares(work, whole, depth=0)
    return work.terms[:, 0], work.terms[:, 1], crossed


def _shadow(surface: SurfacePoints, panel: PanelNumbers, caster: RayCaster) -> Shadow:
    sides = np.array([panel.across, panel.along])
    corner = np.array(panel.centre) - 0.5 * sides.sum(axis=0)
    silhouettes = caster.silhouettes(surface.points, surface.facets, corner, sides)
    point, targets, count, extreme = _reference_places(surface.rows, panel, silhouettes)
    index = np.arange(len(point), dtype=np.int32)
    hidden = caster.occluded(surface.points, surface.facets, targets, point_index=point, target_index=index)
    counts = np.tile(np.array([-_NO_PLACE, _NO_PLACE]), (len(surface), 1))
    fewest, most = extreme == _FEWEST, extreme == _MOST
    counts[point[fewest], 0] = np.where(hidden, -_NO_PLACE, count)[fewest]
    counts[point[fewest], 1] = np.where(hidden, count, count + 1)[fewest]
    # a place with more triangles before it than another one is hidden; else a ray met what is not there, or missed it
    counts[point[most & ~hidden]] = -_NO_PLACE, _NO_PLACE
    return Shadow(silhouettes, counts)


@kernel
def _reference_places(
    rows: PointRows, panel: PanelNumbers, silhouettes: Silhouettes
) -> tuple[Int32, Float64, Int64, UInt8]:
    # of places that the horizon does not hide, one of those with the fewest triangles before them, amid others of them
    # if there is such a one; if there is not, one of those with the most as well. Returns the points that see any
    # places, the places (j, 3), the triangles before them, and _FEWEST or _MOST
    points, n = rows[0], _REFERENCES
    found = np.empty((n, n), np.int64)
    point, count = np.empty(2 * len(points), np.int32), np.empty(2 * len(points), np.int64)
    targets, extreme = np.empty((2 * len(points), 3)), np.empty(2 * len(points), np.uint8)
    m = 0
    for i in range(len(points)):
        if not silhouettes.found[i]:
            continue
        fewest, most = _NO_PLACE, -_NO_PLACE
        horizons = _horizons(rows, panel, i)
        for row in range(n):
            triangles_in_row(silhouettes, i, 0.0, 1.0 / (n - 1), row / (n - 1), found[row])
            for column in range(n):
                if _state_by_horizons(horizons, column / (n - 1), row / (n - 1)) == 0:
                    fewest, most = min(fewest, found[row, column]), max(most, found[row, column])
                else:
                    found[row, column] = _NO_PLACE
        if fewest == _NO_PLACE:
            continue
        alike = 0
        for which in (_FEWEST, _MOST):
            if alike >= _AMID or (which == _MOST and most == fewest):
                continue
            count[m] = fewest if which == _FEWEST else most
            alike, row, column = _amid(found, count[m])
            s, t = column / (n - 1) - 0.5, row / (n - 1) - 0.5
            targets[m, 0], targets[m, 1], targets[m, 2] = panel_point(panel, s, t)
            point[m], extreme[m] = i, which
            m += 1
    return point[:m].copy(), targets[:m].copy(), count[:m].copy(), extreme[:m].copy()


@kernel
def _amid(found: Int64, count: int) -> tuple[int, int, int]:
    # of the places with this count, the one that most others surround: how many, with itself, its row and its column
    n, best, best_row, best_column = len(found), 0, 0, 0
    for row in range(n):
        for column in range(n):
            alike = 0
            for y in range(max(0, row - 1), min(n, row + 2)):
                for x in range(max(0, column - 1), min(n, column + 2)):
                    alike += found[y, x] == count
            if found[row, column] == count and alike > best:
                best, best_row, best_column = alike, row, column
    return best, best_row, best_column


def _shade_squares(work: _Work, squares: Squares, *, depth: int) -> Bool:
    # adds the light of the visible area of squares; returns which of them the edge of a shadow crosses
    given = work.surface.rows, work.light, squares
    state = _states_at_corners(work, squares, GRIDS[depth])
    tails = tails_over(*given, GRIDS[depth])
    stake = add_visible_cells(*given, state, tails, work.terms)
    if depth == 0:
        level = work.terms @ (work.light.diffuse_level, work.light.specular_level) + 0.5 * stake.sum(axis=(1, 2))
        work.tolerance[:] = LEVEL_TOLERANCE + RELATIVE_TOLERANCE * level
    stake /= work.tolerance[squares.point][:, None, None]
    across, along = (_edge_crossings(work, squares, state, stake, vertical=vertical) for vertical in (False, True))
    edge = Edge(state, across, along)
    last = depth + 1 == len(GRIDS)
    bent = np.zeros(stake.shape, np.bool_) if last else _bent_edges(work, squares, edge, stake)
    add_crossed_cells(*given, edge, stake, bent, tails, work.terms)
    if bent.any():
        for finer in _finer_squares(squares, bent, divisions=GRIDS[depth + 1]):
            _shade_squares(work, finer, depth=depth + 1)
    return _crossed_by_bodies(work.surface.rows, work.light.panel, squares, state)


@kernel
def _crossed_by_bodies(rows: PointRows, panel: PanelNumbers, squares: Squares, state: UInt8) -> Bool:
    # squares that the edge of a shadow crosses, not the plane of the surface point's own face alone
    points, facets, n = rows[0], rows[3], state.shape[1] - 1
    crossed = np.zeros(len(squares.point), np.bool_)
    for j in range(len(squares.point)):
        p, facet = vector_at(points, squares.point[j]), vector_at(facets, squares.point[j])
        visible = hidden = False
        for row in range(n + 1):
            for column in range(n + 1):
                visible |= state[j, row, column] == VISIBLE
                if state[j, row, column] == BLOCKED and not hidden:
                    s, t = _place(squares, j, float(column), float(row))
                    hidden = dot(facet, minus(panel_point(panel, s - 0.5, t - 0.5), p)) > 0.0
        crossed[j] = visible and hidden
    return crossed


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
    state = _known_corners(work.surface.rows, work.light.panel, work.shadow, squares, n)
    square, row, column = np.nonzero(state == 0)
    state[square, row, column] = _states(work, squares, square, column, row)
    return state


@kernel
def _known_corners(rows: PointRows, panel: PanelNumbers, shadow: Shadow, squares: Squares, n: int) -> UInt8:
    # 0 where neither the horizon nor the silhouettes tell
    state = np.zeros((len(squares.point), n + 1, n + 1), np.uint8)
    counts = np.empty(n + 1, np.int64)
    for j in range(len(squares.point)):
        i = squares.point[j]
        horizons, seen, hidden = _horizons(rows, panel, i), shadow.counts[i, 0], shadow.counts[i, 1]
        for row in range(n + 1):
            s, t = _place(squares, j, 0.0, float(row))
            if hidden < _NO_PLACE:
                triangles_in_row(shadow.silhouettes, i, s, squares.cell, t, counts)
            for column in range(n + 1):
                state[j, row, column] = _state_by_horizons(horizons, *_place(squares, j, float(column), float(row)))
                if state[j, row, column] == 0 and hidden < _NO_PLACE:
                    state[j, row, column] = _by_count(counts[column], seen, hidden)
    return state


def _states(work: _Work, squares: Squares, square: Index, x: NDArray[Any], y: NDArray[Any]) -> UInt8:
    # what is seen at places (x, y) of squares, counted in cells of their grid
    surface = work.surface
    state, undecided, point, targets = _known_states(surface.rows, work.light.panel, work.shadow, squares, square, x, y)
    # each ray has a target of its own
    index = np.arange(len(undecided), dtype=np.int32)
    blocked = work.caster.occluded(surface.points, surface.facets, targets, point_index=point, target_index=index)
    state[undecided] = np.where(blocked, BLOCKED, VISIBLE)
    return state


@kernel
def _known_states(
    rows: PointRows, panel: PanelNumbers, shadow: Shadow, squares: Squares, square: Index, x: Any, y: Any
) -> tuple[UInt8, Int32, Int32, Float64]:
    # what the horizon and the silhouettes decide; the rest needs a ray
    state = np.empty(len(square), np.uint8)
    undecided, origin = np.empty(len(square), np.int32), np.empty(len(square), np.int32)
    targets = np.empty((len(square), 3))
    m = 0
    for j in range(len(square)):
        i = squares.point[square[j]]
        s, t = _place(squares, square[j], float(x[j]), float(y[j]))
        state[j] = _known_state(_horizons(rows, panel, i), shadow, i, s, t)
        if state[j] == 0:
            undecided[m], origin[m] = j, i
            targets[m, 0], targets[m, 1], targets[m, 2] = panel_point(panel, s - 0.5, t - 0.5)
            m += 1
    return state, undecided[:m].copy(), origin[:m].copy(), targets[:m].copy()


@kernel
def _place(squares: Squares, square: int, x: float, y: float) -> tuple[float, float]:
    # in units of the panel's sides
    return squares.s[square] + x * squares.cell, squares.t[square] + y * squares.cell


@kernel
def _known_state(horizons: _Horizons, shadow: Shadow, i: int, s: float, t: float) -> int:
    # 0 where neither the horizon nor the silhouettes tell
    state = _state_by_horizons(horizons, s, t)
    seen, hidden = shadow.counts[i, 0], shadow.counts[i, 1]
    if state != 0 or hidden >= _NO_PLACE:
        return state
    return _by_count(triangles_before(shadow.silhouettes, i, s, t), seen, hidden)


@kernel
def _by_count(count: int, seen: int, hidden: int) -> int:
    # by the triangles before a place, and `counts` of the shadow
    return VISIBLE if count <= seen else BLOCKED if count >= hidden else 0


@kernel
def _horizons(rows: PointRows, panel: PanelNumbers, i: int) -> _Horizons:
    points, frames, _, facets, _ = rows
    p = vector_at(points, i)
    return _Horizons(plane_over(vector_at(frames, i), p, panel), plane_over(vector_at(facets, i), p, panel))


@kernel
def _state_by_horizons(horizons: _Horizons, s: float, t: float) -> int:
    # below the interpolated horizon there is no light, below the face's own plane the face is in the way; 0 above both
    tangent, face = horizons
    if tangent.level + tangent.rise_s * (s - 0.5) + tangent.rise_t * (t - 0.5) <= 0.0:
        return BELOW
    return BLOCKED if face.level + face.rise_s * (s - 0.5) + face.rise_t * (t - 0.5) <= 0.0 else 0


def _edge_crossings(work: _Work, squares: Squares, state: UInt8, stake: Float64, *, vertical: bool) -> Float64:
    # where the shadow's edge crosses the sides of the cells that run along t (vertical) or along s: the share of the
    # side from its first corner; ½ where it does not cross
    sides = _crossed_sides(state, stake, vertical)
    square, row, column = sides[:3]
    low, high, answer = np.zeros(len(square)), np.ones(len(square)), np.zeros(len(square), np.uint8)
    given = work.surface.rows, work.light.panel, work.shadow, squares
    while True:
        rest, x, y = _halve(*given, *sides, vertical, low, high, answer)
        if not len(rest):
            break
        answer[rest] = _states(work, squares, square[rest], x, y)
    n = stake.shape[1]
    crossing = np.full((len(stake), n, n + 1) if vertical else (len(stake), n + 1, n), 0.5)
    crossing[square, row, column] = 0.5 * (low + high)
    return crossing


@kernel
def _halve(
    rows: PointRows,
    panel: PanelNumbers,
    shadow: Shadow,
    squares: Squares,
    square: Int64,
    row: Int64,
    column: Int64,
    steps: Int64,
    from_blocked: Bool,
    vertical: bool,
    low: Float64,
    high: Float64,
    answer: UInt8,
) -> tuple[Int64, Float64, Float64]:
    # halves the stretches [low, high] of sides that the edge crosses, and counts `steps` down, as far as it is known
    # what their middles see, or was answered; returns the sides that wait for a ray, and the places that these go to
    index, x, y = np.empty(len(square), np.int64), np.empty(len(square)), np.empty(len(square))
    m = 0
    for j in range(len(square)):
        i, begin, end, state = squares.point[square[j]], low[j], high[j], int(answer[j])
        horizons = _horizons(rows, panel, i)
        while steps[j] > 0:
            middle = 0.5 * (begin + end)
            x[m] = column[j] + (0.0 if vertical else middle)
            y[m] = row[j] + (middle if vertical else 0.0)
            if state == 0:
                state = _known_state(horizons, shadow, i, *_place(squares, square[j], x[m], y[m]))
            if state == 0:
                index[m] = j
                m += 1
                break
            if (state == BLOCKED) == from_blocked[j]:
                begin = middle
            else:
                end = middle
            state = 0
            steps[j] -= 1
        low[j], high[j], answer[j] = begin, end, 0
    return index[:m].copy(), x[:m].copy(), y[:m].copy()


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
