"""The part of a panel that a surface point sees when the part's own shadow edge crosses it.

Rays to the corners of a grid of cells tell visible cells from hidden ones; where the edge of the shadow crosses the
side of a cell is found by bisection, and between two such crossings the edge is taken as straight. The light of the
visible area is then integrated in strips.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.raycast import RayCaster
from lightopt.rendering._lobe import out_of_reach, rectangle_diffuse, rectangle_specular
from lightopt.rendering._panel import PanelNumbers
from lightopt.rendering._surface import SurfacePoints

__all__ = ["CELLS", "shade_penumbra"]

Float64 = NDArray[np.float64]
State = NDArray[np.uint8]

CELLS = 8
"""Cells along each side of the panel."""

BISECTIONS = 6
"""Rays that halve the side of a cell in search of the shadow's edge: it is known to 1/128 of a side."""

STRIPS = 4
"""Strips that the visible area of a crossed cell is integrated in."""

HORIZON_NODES = 6
"""Gauss–Legendre nodes a side where the panel is partly below the surface's horizon."""

_BELOW, _VISIBLE, _BLOCKED = 1, 2, 3


def shade_penumbra(
    surface: SurfacePoints,
    panel: PanelNumbers,
    caster: RayCaster,
    *,
    inverse_two_sigma_squared: float,
    rules: tuple[Float64, Float64],
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    """Diffuse and specular light of the visible area of a panel of weight 1, per unit of R_d and R_s.

    Parameters
    ----------
    surface
        k surface points, part frame.
    panel
        Part frame.
    caster
        Of the part.
    inverse_two_sigma_squared
        1/(2σ²) [rad⁻²].
    rules
        Gauss–Legendre nodes and weights.

    Returns
    -------
    diffuse, specular, crossed
        Each of shape (k,); `crossed` is whether the edge of a shadow crosses the panel.
    """
    k = len(surface)
    point, row, column = (
        a.ravel().astype(np.int32)
        for a in np.meshgrid(np.arange(k), np.arange(CELLS + 1), np.arange(CELLS + 1), indexing="ij")
    )
    state = _look(surface, panel, caster, point, column / CELLS, row / CELLS).reshape(k, CELLS + 1, CELLS + 1)
    across = _edge_crossings(surface, panel, caster, state, vertical=False)
    along = _edge_crossings(surface, panel, caster, state, vertical=True)
    diffuse, specular = _visible_area(
        surface.points,
        surface.normals,
        surface.views,
        state,
        across,
        along,
        panel,
        inverse_two_sigma_squared,
        *rules,
    )
    crossed = (state == _VISIBLE).any(axis=(1, 2)) & (state == _BLOCKED).any(axis=(1, 2))
    return diffuse, specular, crossed


def _look(
    surface: SurfacePoints,
    panel: PanelNumbers,
    caster: RayCaster,
    point: NDArray[np.int32],
    s: Float64,
    t: Float64,
) -> State:
    # what surface point i sees at the place (s, t) of the panel, s and t in [0, 1]
    state, asked, targets = _horizon_state(
        surface.points, surface.normals, surface.facets, panel, point, s, t
    )
    blocked = caster.occluded_from(surface.points, surface.facets, targets, point_index=point[asked])
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
    surface: SurfacePoints, panel: PanelNumbers, caster: RayCaster, state: State, *, vertical: bool
) -> Float64:
    # where the shadow's edge crosses the sides of the cells that run along t (vertical) or along s: the share of the
    # side from its first corner; NaN where it does not cross
    blocked = state == _BLOCKED
    first, second = (blocked[:, :-1], blocked[:, 1:]) if vertical else (blocked[:, :, :-1], blocked[:, :, 1:])
    # sides between the horizon and a visible corner are not crossed by anything that matters
    crossing = np.full(first.shape, np.nan)
    where = np.nonzero(first != second)
    point = where[0].astype(np.int32)
    from_blocked = first[where]
    low, high = np.zeros(len(point)), np.ones(len(point))
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        s = (where[2] + (0.0 if vertical else middle)) / CELLS
        t = (where[1] + (middle if vertical else 0.0)) / CELLS
        as_first = (_look(surface, panel, caster, point, s, t) == _BLOCKED) == from_blocked
        low = np.where(as_first, middle, low)
        high = np.where(as_first, high, middle)
    crossing[where] = 0.5 * (low + high)
    return crossing


@kernel
def _visible_area(
    points: Float64,
    normals: Float64,
    views: Float64,
    state: State,
    across: Float64,
    along: Float64,
    panel: PanelNumbers,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
) -> tuple[Float64, Float64]:
    diffuse = np.zeros(len(points))
    specular = np.zeros(len(points))
    runs = np.empty((2 * STRIPS, 4))
    for i in range(len(points)):
        p, n, v = points[i], normals[i], views[i]
        n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        glossy = n_dot_v > 0.0 and not out_of_reach(p, n, v, panel, inverse_two_sigma_squared)
        for row in range(CELLS):
            column = 0
            while column < CELLS:
                kind, order = _cell_kind(state, i, row, column)
                end = column + 1
                if kind == _BLOCKED:
                    column = end
                    continue
                if kind == _VISIBLE:
                    # visible cells of one row in one go
                    while end < CELLS and _cell_kind(state, i, row, end) == (kind, order):
                        end += 1
                    count = 1
                    runs[0, 0], runs[0, 1], runs[0, 2], runs[0, 3] = column, end, row, row + 1
                else:
                    count = _crossed_cell(state, across, along, i, row, column, runs)
                for j in range(count):
                    s0, s1 = runs[j, 0] / CELLS - 0.5, runs[j, 1] / CELLS - 0.5
                    t0, t1 = runs[j, 2] / CELLS - 0.5, runs[j, 3] / CELLS - 0.5
                    diffuse[i] += rectangle_diffuse(p, n, v, panel, s0, s1, t0, t1, order, nodes, weights)
                    if glossy:
                        specular[i] += rectangle_specular(
                            p, n, v, n_dot_v, panel, s0, s1, t0, t1, inverse_two_sigma_squared, nodes, weights
                        )
                column = end
    return diffuse, specular


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
def _crossed_cell(
    state: State, across: Float64, along: Float64, i: int, row: int, column: int, runs: Float64
) -> int:
    # strips [s0, s1] × [t0, t1], in cells, that cover the visible area of a cell; returns their number. Corners and
    # sides go round the cell: corner c is followed by side c; x and y in [0, 1] are the cell's own coordinates
    corner_x = (0.0, 1.0, 1.0, 0.0)
    corner_y = (0.0, 0.0, 1.0, 1.0)
    seen = (
        state[i, row, column] != _BLOCKED,
        state[i, row, column + 1] != _BLOCKED,
        state[i, row + 1, column + 1] != _BLOCKED,
        state[i, row + 1, column] != _BLOCKED,
    )
    side_x = (across[i, row, column], 1.0, across[i, row + 1, column], 0.0)
    side_y = (0.0, along[i, row, column + 1], 1.0, along[i, row, column])
    count = 0
    for first in range(4):
        # a visible stretch of the boundary begins on the side before its first corner and ends on that after its last
        if not seen[first] or seen[(first + 3) % 4]:
            continue
        last = first
        while seen[(last + 1) % 4]:
            last = (last + 1) % 4
        ax, ay = side_x[(first + 3) % 4], side_y[(first + 3) % 4]
        bx, by = side_x[last], side_y[last]
        inside = (bx - ax) * (corner_y[first] - ay) - (by - ay) * (corner_x[first] - ax)
        sign = 1.0 if inside >= 0.0 else -1.0
        # strips run across the edge, so that each is cut where the edge is and not counted whole or not at all
        upright = abs(bx - ax) > abs(by - ay)
        for strip in range(STRIPS):
            middle = (strip + 0.5) / STRIPS
            # visible where sign·((bx − ax)·(y − ay) − (by − ay)·(x − ax)) ≥ 0
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
                first_end, second_end = strip / STRIPS, (strip + 1) / STRIPS
                if upright:
                    runs[count, 0], runs[count, 1] = column + first_end, column + second_end
                    runs[count, 2], runs[count, 3] = row + low, row + high
                else:
                    runs[count, 0], runs[count, 1] = column + low, column + high
                    runs[count, 2], runs[count, 3] = row + first_end, row + second_end
                count += 1
    return count
