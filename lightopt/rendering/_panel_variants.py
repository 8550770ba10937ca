"""The converged panel on variants of a surface: integrals that are shared where they are linear, and left out early.

Diffuse light is linear in the normal as long as the panel is above its horizon, so one vector serves all variants.
The lobe is integrated for those variants alone that it can reach. Where a part hides some of the panel, the panel is
taken in 4 × 4 cells, each seen or hidden as its centre is.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int64
from lightopt.core.kernels import kernel
from lightopt.geometry import RayCaster
from lightopt.optics import MIN_COS_VIEW
from lightopt.rendering._converged import ConvergedPanel
from lightopt.rendering._lobe import rectangle_diffuse, rectangle_specular
from lightopt.rendering._panel import PanelNumbers, panel_numbers
from lightopt.rendering._points import facing_pairs
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import panel_grid

CELLS = 4
"""Cells along a side of a panel of which a part hides some."""


def panel_variants(
    surface: SurfacePoints,
    references: Float64,
    converged: ConvergedPanel,
    clear: Bool,
    caster: RayCaster | None,
    *,
    lean: Float64,
    R_d: Float64,
    R_s: Float64,
    inverse: Float64,
    most: Float64,
) -> Float64:
    """Levels of variants of a surface under a converged panel, shape (k, t).

    surface, references: As :func:`lightopt.rendering.shade_variants` takes them
    converged: The panel
    clear: Which of its probes each point's facet faces and sees, shape (k, 5)
    caster: For the cells of panels that are seen in part; None for no shadows
    lean, R_d, R_s, inverse, most: Of the variants: normals in the points' frames, shape (t, 3); coefficients times the
        panel's weight, 1/(2σ²), and the exponent from which their lobe is negligible for a view along the normal, each
        of shape (t,)
    """
    panel = panel_numbers(converged.light)
    levels = np.zeros((len(surface), len(lean)))
    number = clear.sum(axis=1)
    mixed = np.flatnonzero((number > 0) & (number < clear.shape[1]))
    cells = np.ones((len(surface), CELLS * CELLS), np.bool_)
    if caster is not None and len(mixed):
        cells[mixed] = _clear_cells(surface.take(mixed), converged, caster)
    _kernel(
        surface.points,
        surface.normals,
        references,
        surface.views,
        number,
        clear.shape[1],
        cells,
        panel,
        converged.nodes,
        *converged.rules,
        lean,
        R_d,
        R_s,
        inverse,
        most,
        levels,
    )
    return levels


def _clear_cells(surface: SurfacePoints, converged: ConvergedPanel, caster: RayCaster) -> Bool:
    # along the panel's second side first, as panel_grid has them
    centres = panel_grid(converged.light, CELLS * CELLS)
    point, target = facing_pairs(replace(surface, normals=surface.facets), centres, geometric=False)
    blocked = caster.occluded(surface.points, surface.facets, centres, point_index=point, target_index=target)
    seen = np.zeros((len(surface), len(centres)), np.bool_)
    seen[point[~blocked], target[~blocked]] = True
    return seen


@kernel
def _kernel(
    points: Float64,
    normals: Float64,
    references: Float64,
    views: Float64,
    number: Int64,
    whole: int,
    cells: Bool,
    panel: PanelNumbers,
    panel_nodes: int,
    nodes: Float64,
    weights: Float64,
    lean: Float64,
    R_d: Float64,
    R_s: Float64,
    inverse: Float64,
    most: Float64,
    levels: Float64,
) -> None:
    towards = np.empty(3)
    turned = np.empty(3)
    half = 0.5 * math.sqrt(
        panel.across_x**2
        + panel.across_y**2
        + panel.across_z**2
        + panel.along_x**2
        + panel.along_y**2
        + panel.along_z**2
    )
    for i in range(len(points)):
        if number[i] == 0:
            continue
        p, n, v, r = points[i], normals[i], views[i], references[i]
        a0, a1, a2 = n[1] * r[2] - n[2] * r[1], n[2] * r[0] - n[0] * r[2], n[0] * r[1] - n[1] * r[0]
        _light_vector(p, panel, panel_nodes, nodes, weights, cells[i], number[i] == whole, towards)
        # how far the half vectors of the panel's points are from that of its centre, at most
        lx, ly, lz = panel.centre_x - p[0], panel.centre_y - p[1], panel.centre_z - p[2]
        distance = math.sqrt(lx * lx + ly * ly + lz * lz)
        hx, hy, hz = lx / distance + v[0], ly / distance + v[1], lz / distance + v[2]
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        spread = math.pi
        if half < 0.9 * distance and length > 1e-3:
            hx, hy, hz = hx / length, hy / length, hz / length
            turn = math.asin(half / distance)
            cosine = math.cos(math.acos(min(1.0, 0.5 * length)) + 0.5 * turn)
            if cosine > 0.1:
                spread = turn / (2.0 * cosine)
        for t in range(len(lean)):
            c0, c1, c2 = lean[t, 0], lean[t, 1], lean[t, 2]
            t0 = c0 * n[0] + c1 * r[0] + c2 * a0
            t1 = c0 * n[1] + c1 * r[1] + c2 * a1
            t2 = c0 * n[2] + c1 * r[2] + c2 * a2
            turned[0], turned[1], turned[2] = t0, t1, t2
            lowest = t0 * lx + t1 * ly + t2 * lz
            lowest -= 0.5 * abs(t0 * panel.across_x + t1 * panel.across_y + t2 * panel.across_z)
            lowest -= 0.5 * abs(t0 * panel.along_x + t1 * panel.along_y + t2 * panel.along_z)
            if lowest >= 0.0:
                d = t0 * towards[0] + t1 * towards[1] + t2 * towards[2]
            elif number[i] == whole:
                d = rectangle_diffuse(
                    p, turned, v, panel, -0.5, 0.5, -0.5, 0.5, panel_nodes, nodes, weights
                )  # fmt: skip
            else:
                d = _cells_diffuse(p, turned, v, panel, panel_nodes, nodes, weights, cells[i])
            s = 0.0
            n_dot_v = t0 * v[0] + t1 * v[1] + t2 * v[2]
            if n_dot_v > 0.0:
                furthest = most[t] - math.log(max(n_dot_v, MIN_COS_VIEW))
                reach = spread + math.sqrt(max(0.0, furthest) / inverse[t])
                if reach >= math.pi or t0 * hx + t1 * hy + t2 * hz > math.cos(reach):
                    if number[i] == whole:
                        s = rectangle_specular(
                            p, turned, v, n_dot_v, panel, -0.5, 0.5, -0.5, 0.5, inverse[t], panel_nodes, nodes, weights
                        )  # fmt: skip
                    else:
                        s = _cells_specular(
                            p, turned, v, n_dot_v, panel, inverse[t], panel_nodes, nodes, weights, cells[i]
                        )
            levels[i, t] = R_d[t] * d + R_s[t] * s


@kernel
def _light_vector(
    p: Float64,
    panel: PanelNumbers,
    count: int,
    nodes: Float64,
    weights: Float64,
    cells: Bool,
    whole: bool,
    towards: Float64,
) -> None:
    # Σ weight · L over the panel, or over its visible cells: diffuse light is its product with a normal that has all of
    # the panel above its horizon
    towards[:] = 0.0
    parts = 1 if whole else CELLS
    few = count if whole else math.ceil(2.0 * count / CELLS)
    for row in range(parts):
        for column in range(parts):
            if not whole and not cells[row * CELLS + column]:
                continue
            for i in range(few):
                t = (row + nodes[few, i]) / parts - 0.5
                for j in range(few):
                    s = (column + nodes[few, j]) / parts - 0.5
                    lx = panel.centre_x + s * panel.across_x + t * panel.along_x - p[0]
                    ly = panel.centre_y + s * panel.across_y + t * panel.along_y - p[1]
                    lz = panel.centre_z + s * panel.across_z + t * panel.along_z - p[2]
                    r2 = lx * lx + ly * ly + lz * lz
                    r = 1.0 / math.sqrt(r2)
                    w = weights[few, i] * weights[few, j] / (parts * parts)
                    if panel.inverse_square:
                        w *= panel.distance * panel.distance / r2
                    if panel.emission_exponent > 0.0:
                        cosine = (panel.outward_x * lx + panel.outward_y * ly + panel.outward_z * lz) * r
                        w *= max(0.0, cosine) ** panel.emission_exponent
                    towards[0] += w * r * lx
                    towards[1] += w * r * ly
                    towards[2] += w * r * lz


@kernel
def _cells_diffuse(
    p: Float64,
    n: Float64,
    v: Float64,
    panel: PanelNumbers,
    count: int,
    nodes: Float64,
    weights: Float64,
    cells: Bool,
) -> float:
    few = math.ceil(2.0 * count / CELLS)
    total = 0.0
    for row in range(CELLS):
        t0 = row / CELLS - 0.5
        for column in range(CELLS):
            if cells[row * CELLS + column]:
                s0 = column / CELLS - 0.5
                total += rectangle_diffuse(
                    p, n, v, panel, s0, s0 + 1.0 / CELLS, t0, t0 + 1.0 / CELLS, few, nodes, weights
                )
    return total


@kernel
def _cells_specular(
    p: Float64,
    n: Float64,
    v: Float64,
    n_dot_v: float,
    panel: PanelNumbers,
    inverse: float,
    panel_nodes: int,
    nodes: Float64,
    weights: Float64,
    cells: Bool,
) -> float:
    total = 0.0
    for row in range(CELLS):
        t0 = row / CELLS - 0.5
        column = 0
        while column < CELLS:
            end = column + 1
            if cells[row * CELLS + column]:
                # visible cells of one row in one go
                while end < CELLS and cells[row * CELLS + end]:
                    end += 1
                s0, s1 = column / CELLS - 0.5, end / CELLS - 0.5
                total += rectangle_specular(
                    p, n, v, n_dot_v, panel, s0, s1, t0, t0 + 1.0 / CELLS, inverse, panel_nodes, nodes, weights
                )  # fmt: skip
            column = end
    return total
