"""``points: auto``: the panel as the continuous surface it is.

Per pixel and light five rays, to the panel's corners and centre, tell lit from shaded. Where they agree among themselves
and with those of the neighbouring pixels, the panel is wholly visible or wholly hidden. In the penumbrae that remain, a
quadtree over the panel finds the edge of the shadow, and only its visible leaves give light.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from lightopt.raycast import RayCaster
from lightopt.rendering._lobe import gauss_legendre_table, rectangle_diffuse, rectangle_specular
from lightopt.rendering._panel import PanelNumbers, panel_numbers
from lightopt.rendering._points import facing_pairs
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import PanelLight

__all__ = ["ConvergedPanel", "converged_panel", "shade_converged"]

Float64 = NDArray[np.float64]

DIFFUSE_TOLERANCE = 2e-4
"""Error of the diffuse quadrature per unit of R_d: 0.05 level of 255."""

HORIZON_NODES = 6
"""Gauss–Legendre nodes a side where the panel is partly below the surface's horizon."""

COARSE_CELLS = 4
FINE_CELLS = 64
"""In a penumbra the panel is divided in COARSE_CELLS² cells; those that the shadow's edge crosses, by their corners, are
quartered down to FINE_CELLS a side."""

PROBE_INSET = 0.98
"""The rays to the corners go this far from the panel's centre towards them."""

PENUMBRA_BATCH = 512
"""Penumbra pixels that are worked on at once; their quadtrees take 4 KiB each."""

# what the coarse rays of a pixel and a light say
_DARK, _CLEAR, _HIDDEN, _MIXED = 0, 1, 2, 3
# state of a corner of the quadtree's cells
_UNKNOWN, _BELOW, _VISIBLE, _BLOCKED = 0, 1, 2, 3


@dataclass(frozen=True)
class ConvergedPanel:
    """A panel with the quadrature that it needs for a part.

    Attributes
    ----------
    light
        The panel, part frame.
    nodes
        Gauss–Legendre nodes a side for diffuse light.
    rules
        From :func:`gauss_legendre_table`.
    """

    light: PanelLight
    nodes: int
    rules: tuple[Float64, Float64]


def converged_panel(light: PanelLight, *, centre: Float64, radius: float) -> ConvergedPanel:
    """Choose the diffuse quadrature of a panel by trying it on surface points all over a part.

    Parameters
    ----------
    light
        Part frame.
    centre, radius
        Sphere around the part, part frame [mm].
    """
    panel = panel_numbers(light)
    nodes, weights = gauss_legendre_table()
    towards = light.centre - centre
    towards = towards / np.linalg.norm(towards)
    positions = [centre + radius * np.array(d) for d in itertools.product((-0.57, 0.57), repeat=3)]
    tilts = [towards, towards + 1.5 * light.across, towards + 1.5 * light.along]
    normals = [tilt / np.linalg.norm(tilt) for tilt in tilts]
    for count in (2, 3, 4, 6, 8):
        error = max(
            abs(
                rectangle_diffuse(p, n, n, panel, -0.5, 0.5, -0.5, 0.5, count, nodes, weights)
                - rectangle_diffuse(p, n, n, panel, -0.5, 0.5, -0.5, 0.5, 24, nodes, weights)
            )
            for p in positions
            for n in normals
        )
        if error <= DIFFUSE_TOLERANCE:
            break
    return ConvergedPanel(light, count, (nodes, weights))


def shade_converged(
    surface: SurfacePoints,
    converged: ConvergedPanel,
    *,
    sample: NDArray[np.intp],
    shape: tuple[int, int],
    sigma: float,
    caster: RayCaster | None,
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a whole panel, per unit of R_d and R_s; two arrays of shape (k,).

    Parameters
    ----------
    surface
        k surface points, part frame.
    converged
        The panel and its quadrature.
    sample
        Index of each point in the raveled grid of image samples that was traced, shape (k,): shadows are refined where
        neighbours in this grid disagree.
    shape
        Rows and columns of that grid; the grid's own border has no neighbours beyond it.
    sigma
        Of the specular lobe [rad].
    caster
        For shadows; None for none.
    """
    panel = panel_numbers(converged.light)
    inverse = 0.5 / sigma**2
    nodes, weights = converged.rules
    if caster is None:
        verdict = np.where(surface.front, _CLEAR, _DARK).astype(np.uint8)
        uncertain = np.zeros(len(surface), np.bool_)
    else:
        verdict = _coarse_verdict(surface, converged.light, caster)
        uncertain = _disagreeing(verdict, sample, shape)
    diffuse, specular = _whole_panel(
        surface.points,
        surface.normals,
        surface.views,
        verdict,
        panel,
        converged.nodes,
        inverse,
        nodes,
        weights,
    )
    if caster is not None:
        looked_at = np.zeros(len(surface), np.bool_)
        while uncertain.any():
            penumbra = np.zeros(len(surface), np.bool_)
            index = np.flatnonzero(uncertain)
            for start in range(0, len(index), PENUMBRA_BATCH):
                batch = index[start : start + PENUMBRA_BATCH]
                some = surface.take(batch)
                state = _shadow_quadtrees(some, panel, caster)
                diffuse[batch], specular[batch], penumbra[batch] = _visible_leaves(
                    some.points, some.normals, some.views, state, panel, inverse, nodes, weights
                )
            # a penumbra goes on until its neighbours, too, see the whole panel or none of it
            looked_at |= uncertain
            uncertain = _neighbours(penumbra, sample, shape) & ~looked_at & (verdict != _DARK)
    total = converged.light.total_weight
    return total * diffuse, total * specular


def _coarse_verdict(surface: SurfacePoints, light: PanelLight, caster: RayCaster) -> NDArray[np.uint8]:
    half = 0.5 * PROBE_INSET
    targets = np.array(
        [
            light.centre + s * light.size[0] * light.across + t * light.size[1] * light.along
            for s, t in ((0.0, 0.0), (-half, -half), (-half, half), (half, -half), (half, half))
        ]
    )
    point, target = facing_pairs(surface, targets, geometric=True)
    blocked = caster.occluded(surface.points, surface.facets, targets, point_index=point, target_index=target)
    clear = np.bincount(point[~blocked], minlength=len(surface))
    # a point above the interpolated horizon but below the face's own plane is hidden by the face itself
    above, _ = facing_pairs(surface, targets, geometric=False)
    all_above = np.bincount(above, minlength=len(surface))
    verdict = np.full(len(surface), _MIXED, np.uint8)
    verdict[clear == 0] = _HIDDEN
    verdict[clear == all_above] = _CLEAR
    verdict[all_above == 0] = _DARK
    return verdict


def _disagreeing(
    verdict: NDArray[np.uint8], sample: NDArray[np.intp], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    # points whose rays disagree among themselves or with those of a neighbouring sample
    near_clear = _neighbours((verdict == _CLEAR) | (verdict == _MIXED), sample, shape)
    near_hidden = _neighbours((verdict == _HIDDEN) | (verdict == _MIXED), sample, shape)
    return near_clear & near_hidden & (verdict != _DARK)


def _neighbours(
    flags: NDArray[np.bool_], sample: NDArray[np.intp], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    # whether any of the 3 × 3 samples around each point is flagged
    grid = np.zeros((shape[0] + 2, shape[1] + 2), np.bool_)
    inner = grid[1:-1, 1:-1]
    inner[np.unravel_index(sample, shape)] = flags
    near = np.zeros(shape, np.bool_)
    for dy, dx in itertools.product(range(3), repeat=2):
        near |= grid[dy : dy + shape[0], dx : dx + shape[1]]
    return near.ravel()[sample]


@numba.njit(cache=True, nogil=True)
def _whole_panel(
    points: Float64,
    normals: Float64,
    views: Float64,
    verdict: NDArray[np.uint8],
    panel: PanelNumbers,
    diffuse_nodes: int,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
) -> tuple[Float64, Float64]:
    diffuse = np.zeros(len(points))
    specular = np.zeros(len(points))
    for i in range(len(points)):
        if verdict[i] != _CLEAR:
            continue
        p, n, v = points[i], normals[i], views[i]
        least, most = _horizon(p, n, panel)
        if most <= 0.0:
            continue
        count = diffuse_nodes if least > 0.0 else HORIZON_NODES
        diffuse[i] = rectangle_diffuse(p, n, v, panel, -0.5, 0.5, -0.5, 0.5, count, nodes, weights)
        n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        specular[i] = rectangle_specular(
            p, n, v, n_dot_v, panel, -0.5, 0.5, -0.5, 0.5, inverse_two_sigma_squared, nodes, weights
        )
    return diffuse, specular


@numba.njit(cache=True, nogil=True)
def _horizon(p: Float64, n: Float64, panel: PanelNumbers) -> tuple[float, float]:
    # height of the panel's lowest and highest corner above the surface's tangent plane
    middle = across = along = 0.0
    for a in range(3):
        middle += n[a] * (panel.centre[a] - p[a])
        across += n[a] * panel.across[a]
        along += n[a] * panel.along[a]
    half = 0.5 * (abs(across) + abs(along))
    return middle - half, middle + half


def _shadow_quadtrees(surface: SurfacePoints, panel: PanelNumbers, caster: RayCaster) -> NDArray[np.uint8]:
    # state of the corners of the quadtrees' cells, on a grid of FINE_CELLS + 1 points a side, shape (k, side, side)
    k = len(surface)
    state = np.zeros((k, FINE_CELLS + 1, FINE_CELLS + 1), np.uint8)
    count = COARSE_CELLS
    point, row, column = (
        a.ravel().astype(np.int32)
        for a in np.meshgrid(np.arange(k), np.arange(count), np.arange(count), indexing="ij")
    )
    while len(point) > 0:
        asked, y, x, targets = _unknown_corners(
            surface.points, surface.normals, surface.facets, panel, point, row, column, count, state
        )
        blocked = caster.occluded_from(surface.points, surface.facets, targets, point_index=asked)
        state[asked, y, x] = np.where(blocked, _BLOCKED, _VISIBLE)
        if count == FINE_CELLS:
            break
        point, row, column = _split_mixed(point, row, column, count, state)
        count *= 2
    return state


@numba.njit(cache=True, nogil=True)
def _unknown_corners(
    points: Float64,
    normals: Float64,
    facets: Float64,
    panel: PanelNumbers,
    point: NDArray[np.int32],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    count: int,
    state: NDArray[np.uint8],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], Float64]:
    # the corners of these cells that need a ray; those that the horizon decides are written down at once
    most = 4 * len(point)
    asked, ys, xs = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    targets = np.empty((most, 3))
    side = FINE_CELLS // count
    m = 0
    for j in range(len(point)):
        i = point[j]
        for corner in range(4):
            y, x = (row[j] + corner // 2) * side, (column[j] + corner % 2) * side
            if state[i, y, x] != _UNKNOWN:
                continue
            s, t = x / FINE_CELLS - 0.5, y / FINE_CELLS - 0.5
            height = plane = 0.0
            for a in range(3):
                q = panel.centre[a] + s * panel.across[a] + t * panel.along[a]
                targets[m, a] = q
                height += normals[i, a] * (q - points[i, a])
                plane += facets[i, a] * (q - points[i, a])
            if height <= 0.0:
                state[i, y, x] = _BELOW
                continue
            # blocked until the ray says otherwise, and for good below the face's own plane
            state[i, y, x] = _BLOCKED
            if plane > 0.0:
                asked[m], ys[m], xs[m] = i, y, x
                m += 1
    return asked[:m].copy(), ys[:m].copy(), xs[:m].copy(), targets[:m].copy()


@numba.njit(cache=True, nogil=True)
def _corner_counts(
    state: NDArray[np.uint8], i: int, row: int, column: int, side: int
) -> tuple[int, int, int]:
    # how many corners of a cell are visible, blocked and below the horizon
    visible = blocked = below = 0
    for corner in range(4):
        value = state[i, (row + corner // 2) * side, (column + corner % 2) * side]
        if value == _VISIBLE:
            visible += 1
        elif value == _BLOCKED:
            blocked += 1
        else:
            below += 1
    return visible, blocked, below


@numba.njit(cache=True, nogil=True)
def _split_mixed(
    point: NDArray[np.int32],
    row: NDArray[np.int32],
    column: NDArray[np.int32],
    count: int,
    state: NDArray[np.uint8],
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    # the quarters of the cells that a shadow's edge crosses
    most = 4 * len(point)
    points, rows, columns = np.empty(most, np.int32), np.empty(most, np.int32), np.empty(most, np.int32)
    m = 0
    for j in range(len(point)):
        visible, blocked, _ = _corner_counts(state, point[j], row[j], column[j], FINE_CELLS // count)
        if visible == 0 or blocked == 0:
            continue
        for quarter in range(4):
            points[m] = point[j]
            rows[m] = 2 * row[j] + quarter // 2
            columns[m] = 2 * column[j] + quarter % 2
            m += 1
    return points[:m].copy(), rows[:m].copy(), columns[:m].copy()


@numba.njit(cache=True, nogil=True)
def _visible_leaves(
    points: Float64,
    normals: Float64,
    views: Float64,
    state: NDArray[np.uint8],
    panel: PanelNumbers,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
) -> tuple[Float64, Float64, NDArray[np.bool_]]:
    # light of the leaves of each quadtree, and whether it has both visible and blocked corners
    diffuse = np.zeros(len(points))
    specular = np.zeros(len(points))
    mixed = np.zeros(len(points), np.bool_)
    stack = np.empty((4 * COARSE_CELLS * COARSE_CELLS + 64, 3), np.int32)
    for i in range(len(points)):
        p, n, v = points[i], normals[i], views[i]
        n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        seen = hidden = False
        height = 0
        for row in range(COARSE_CELLS):
            for column in range(COARSE_CELLS):
                stack[height, 0], stack[height, 1], stack[height, 2] = COARSE_CELLS, row, column
                height += 1
        while height > 0:
            height -= 1
            count, row, column = stack[height, 0], stack[height, 1], stack[height, 2]
            visible, blocked, below = _corner_counts(state, i, row, column, FINE_CELLS // count)
            seen |= visible > 0
            hidden |= blocked > 0
            if visible == 0:
                continue
            if blocked > 0 and count < FINE_CELLS:
                for quarter in range(4):
                    stack[height, 0] = 2 * count
                    stack[height, 1] = 2 * row + quarter // 2
                    stack[height, 2] = 2 * column + quarter % 2
                    height += 1
                continue
            share = visible / (visible + blocked)
            s0, s1 = column / count - 0.5, (column + 1) / count - 0.5
            t0, t1 = row / count - 0.5, (row + 1) / count - 0.5
            order = 2 if below == 0 else HORIZON_NODES
            diffuse[i] += share * rectangle_diffuse(p, n, v, panel, s0, s1, t0, t1, order, nodes, weights)
            specular[i] += share * rectangle_specular(
                p, n, v, n_dot_v, panel, s0, s1, t0, t1, inverse_two_sigma_squared, nodes, weights
            )
        mixed[i] = seen and hidden
    return diffuse, specular, mixed
