"""The converged panel on variants of a surface: integrals that are shared where they are linear, and left out early.

Lambert's diffuse light is linear in the normal as long as the panel is above its horizon, so one vector serves all
variants. The lobe is integrated for those variants alone that it can reach. Where a part hides some of the panel, the
panel is taken in 4 × 4 cells, each seen or hidden as its centre is.
"""

import math
from typing import NamedTuple

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int64
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, cross, dot, minus, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelNumbers, attenuated, half_diagonal, panel_grid, panel_numbers, panel_point
from lightopt.optics import (
    DiffuseForm,
    Lobe,
    farthest_exponent,
    is_lambert,
    lobe_at,
    lobe_beside,
    lobe_of_width,
    specular_divisor,
    square_across,
)
from lightopt.rendering._converged_panel import ConvergedPanel, panel_probes, probe_targets
from lightopt.rendering._panel_quadrature import (
    NODES,
    WEIGHTS,
    WHOLE_PANEL,
    Rectangle,
    half_vector_cone,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._surface import PointRows, SurfacePoint, SurfacePoints, point_at, surface_point


class VariantNumbers(NamedTuple):
    """The variants of a surface in the form that kernels take."""

    lean: Float64  # normals in the points' frames, shape (t, 3)
    R_d: Float64  # of each, shape (t,)
    R_s: Float64  # of each, shape (t,)
    inverse: Float64  # 1/(2σ²) [rad⁻²], shape (t,)
    # the lobe is negligible where it is less than e^−most of its height, for the view that it is brightest in, shape
    # (t,)
    most: Float64
    lobe: Lobe  # form of all lobes, of any width
    diffuse: DiffuseForm  # form of the diffuse light of all


@kernel
def leaning(lean: Float64, t: int, n: Vector, r: Vector, a: Vector) -> Vector:
    """Normal of variant t in the frame of the vectors n (the point's normal), r (its reference) and a = n × r."""
    c0, c1, c2 = lean[t, 0], lean[t, 1], lean[t, 2]
    return Vector(c0 * n.x + c1 * r.x + c2 * a.x, c0 * n.y + c1 * r.y + c2 * a.y, c0 * n.z + c1 * r.z + c2 * a.z)


CELLS = 4  # cells along a side of a panel of which a part hides some


def panel_variants(
    surface: SurfacePoints,
    references: Float64,
    converged: ConvergedPanel,
    caster: RayCaster | None,
    variants: VariantNumbers,
) -> Float64:
    """Levels of variants of a surface under a converged panel, shape (k, t).

    surface, references: As :func:`lightopt.rendering._surface_variants.shade_variants` takes them
    caster: For the probes, and the cells of panels that are seen in part; None for no shadows
    variants: With coefficients times the panel's weight
    """
    levels = np.zeros((len(surface), len(variants.lean)))
    probes = probe_targets(converged.light)
    number, cells = np.full(len(surface), len(probes)), np.ones((len(surface), CELLS * CELLS), np.bool_)
    if caster is not None:
        number = panel_probes(surface, probes, caster).sum(axis=1)
        mixed = np.flatnonzero((number > 0) & (number < len(probes)))
        # along the panel's second side first, as panel_grid has them
        cells[mixed] = panel_probes(surface.take(mixed), panel_grid(converged.light, CELLS * CELLS), caster)
    panel, rows = panel_numbers(converged.light), surface.rows
    _levels(rows, references, number, len(probes), cells, panel, converged.nodes, variants, levels)
    return levels


@kernel
def _levels(
    rows: PointRows,
    references: Float64,
    number: Int64,
    all_probes: int,
    cells: Bool,
    panel: PanelNumbers,
    panel_nodes: int,
    variants: VariantNumbers,
    levels: Float64,
) -> None:
    lean, R_d, R_s, inverse, most, form, diffuse = variants
    points, frames, views, _, _ = rows
    linear = is_lambert(diffuse)
    for i in range(len(points)):
        if number[i] == 0:
            continue
        whole = number[i] == all_probes
        plain, r = point_at(points, frames, views, i), vector_at(references, i)
        a = cross(plain.n, r)
        towards = _light_vector(plain.p, panel, panel_nodes, cells[i], whole)
        half, spread = half_vector_cone(plain, panel.centre, half_diagonal(panel))
        light = minus(panel.centre, plain.p)
        own = lobe_at(form, frames, i)
        for t in range(len(lean)):
            at = surface_point(plain.p, leaning(lean, t, plain.n, r, a), plain.v)
            lowest = dot(at.n, light) - 0.5 * abs(dot(at.n, panel.across)) - 0.5 * abs(dot(at.n, panel.along))
            if linear and lowest >= 0.0:
                d = dot(at.n, towards)
            elif whole:
                d = rectangle_diffuse(at, panel, WHOLE_PANEL, diffuse, panel_nodes)
            else:
                d = _cells_diffuse(at, panel, diffuse, panel_nodes, cells[i])
            s = 0.0
            if at.n_dot_v > 0.0:
                lobe = lobe_beside(lobe_of_width(own, inverse[t]), at.n)
                divisor = specular_divisor(at.n_dot_v, square_across(at.v, lobe), lobe)
                furthest = farthest_exponent(most[t] - math.log(divisor), lobe)
                reach = spread + math.sqrt(max(0.0, furthest) / inverse[t])
                if reach >= math.pi or dot(at.n, half) > math.cos(reach):
                    if whole:
                        s = rectangle_specular(at, panel, WHOLE_PANEL, lobe, panel_nodes)
                    else:
                        s = _cells_specular(at, panel, lobe, panel_nodes, cells[i])
            levels[i, t] = R_d[t] * d + R_s[t] * s


@kernel
def _light_vector(p: Vector, panel: PanelNumbers, count: int, cells: Bool, whole: bool) -> Vector:
    # Σ weight · L over the panel, or over its visible cells: diffuse light is its product with a normal that has all of
    # the panel above its horizon
    x = y = z = 0.0
    parts = 1 if whole else CELLS
    few = count if whole else math.ceil(2.0 * count / CELLS)
    for row in range(parts):
        for column in range(parts):
            if not whole and not cells[row * CELLS + column]:
                continue
            for i in range(few):
                t = (row + NODES[few, i]) / parts - 0.5
                for j in range(few):
                    s = (column + NODES[few, j]) / parts - 0.5
                    light = minus(panel_point(panel, s, t), p)
                    r2 = dot(light, light)
                    r = 1.0 / math.sqrt(r2)
                    w = WEIGHTS[few, i] * WEIGHTS[few, j] / (parts * parts)
                    w = attenuated(w, panel, r2, dot(panel.outward, light) * r)
                    x += w * r * light.x
                    y += w * r * light.y
                    z += w * r * light.z
    return Vector(x, y, z)


@kernel
def _cells_diffuse(at: SurfacePoint, panel: PanelNumbers, form: DiffuseForm, count: int, cells: Bool) -> float:
    few = math.ceil(2.0 * count / CELLS)
    total = 0.0
    for row in range(CELLS):
        t0 = row / CELLS - 0.5
        for column in range(CELLS):
            if cells[row * CELLS + column]:
                s0 = column / CELLS - 0.5
                area = Rectangle(s0, s0 + 1.0 / CELLS, t0, t0 + 1.0 / CELLS)
                total += rectangle_diffuse(at, panel, area, form, few)
    return total


@kernel
def _cells_specular(at: SurfacePoint, panel: PanelNumbers, lobe: Lobe, panel_nodes: int, cells: Bool) -> float:
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
                area = Rectangle(column / CELLS - 0.5, end / CELLS - 0.5, t0, t0 + 1.0 / CELLS)
                total += rectangle_specular(at, panel, area, lobe, panel_nodes)
            column = end
    return total
