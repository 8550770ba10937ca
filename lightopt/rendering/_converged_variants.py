"""The converged panel on variants of a surface: integrals that are shared where they are linear, and left out early.

Lambert's diffuse light is linear in the normal as long as the panel is above its horizon, so one vector serves all
variants. The lobe is integrated for those variants alone that it can reach. Where a part hides some of the panel, the
panel is taken in 4 × 4 cells, each seen or hidden as its centre is.
"""

import math

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
from lightopt.rendering._converged_panel import ConvergedPanel, panel_probes
from lightopt.rendering._panel_quadrature import (
    NODES,
    WEIGHTS,
    WHOLE_PANEL,
    Rectangle,
    half_vector_cone,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._surface import SurfacePoints
from lightopt.rendering._variant_numbers import VariantNumbers, leaning

CELLS = 4  # cells along a side of a panel of which a part hides some


def panel_variants(
    surface: SurfacePoints,
    references: Float64,
    converged: ConvergedPanel,
    clear: Bool,
    caster: RayCaster | None,
    variants: VariantNumbers,
) -> Float64:
    """Levels of variants of a surface under a converged panel, shape (k, t).

    surface, references: As :func:`lightopt.rendering._surface_variants.shade_variants` takes them
    clear: Which of its probes each point's facet faces and sees, shape (k, 5)
    caster: For the cells of panels that are seen in part; None for no shadows
    variants: With coefficients times the panel's weight
    """
    levels = np.zeros((len(surface), len(variants.lean)))
    number = clear.sum(axis=1)
    mixed = np.flatnonzero((number > 0) & (number < clear.shape[1]))
    cells = np.ones((len(surface), CELLS * CELLS), np.bool_)
    if caster is not None and len(mixed):
        # along the panel's second side first, as panel_grid has them
        cells[mixed] = panel_probes(surface.take(mixed), panel_grid(converged.light, CELLS * CELLS), caster)
    _levels(
        surface.points,
        surface.frames,
        references,
        surface.views,
        number,
        clear.shape[1],
        cells,
        panel_numbers(converged.light),
        converged.nodes,
        variants,
        levels,
    )
    return levels


@kernel
def _levels(
    points: Float64,
    frames: Float64,
    references: Float64,
    views: Float64,
    number: Int64,
    all_probes: int,
    cells: Bool,
    panel: PanelNumbers,
    panel_nodes: int,
    variants: VariantNumbers,
    levels: Float64,
) -> None:
    lean, R_d, R_s, inverse, most, form, diffuse = variants
    linear = is_lambert(diffuse)
    for i in range(len(points)):
        if number[i] == 0:
            continue
        whole = number[i] == all_probes
        p, n, v, r = (vector_at(points, i), vector_at(frames, i), vector_at(views, i), vector_at(references, i))
        a = cross(n, r)
        towards = _light_vector(p, panel, panel_nodes, cells[i], whole)
        half, spread = half_vector_cone(p, v, panel.centre, half_diagonal(panel))
        light = minus(panel.centre, p)
        own = lobe_at(form, frames, i)
        for t in range(len(lean)):
            turned = leaning(lean, t, n, r, a)
            lowest = dot(turned, light)
            lowest -= 0.5 * abs(dot(turned, panel.across))
            lowest -= 0.5 * abs(dot(turned, panel.along))
            if linear and lowest >= 0.0:
                d = dot(turned, towards)
            elif whole:
                d = rectangle_diffuse(p, turned, v, panel, WHOLE_PANEL, diffuse, panel_nodes)
            else:
                d = _cells_diffuse(p, turned, v, panel, diffuse, panel_nodes, cells[i])
            s = 0.0
            n_dot_v = dot(turned, v)
            if n_dot_v > 0.0:
                lobe = lobe_beside(lobe_of_width(own, inverse[t]), turned)
                divisor = specular_divisor(n_dot_v, square_across(v, lobe), lobe)
                furthest = farthest_exponent(most[t] - math.log(divisor), lobe)
                reach = spread + math.sqrt(max(0.0, furthest) / inverse[t])
                if reach >= math.pi or dot(turned, half) > math.cos(reach):
                    if whole:
                        s = rectangle_specular(p, turned, v, n_dot_v, panel, WHOLE_PANEL, lobe, panel_nodes)
                    else:
                        s = _cells_specular(p, turned, v, n_dot_v, panel, lobe, panel_nodes, cells[i])
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
def _cells_diffuse(
    p: Vector, n: Vector, v: Vector, panel: PanelNumbers, form: DiffuseForm, count: int, cells: Bool
) -> float:
    few = math.ceil(2.0 * count / CELLS)
    total = 0.0
    for row in range(CELLS):
        t0 = row / CELLS - 0.5
        for column in range(CELLS):
            if cells[row * CELLS + column]:
                s0 = column / CELLS - 0.5
                area = Rectangle(s0, s0 + 1.0 / CELLS, t0, t0 + 1.0 / CELLS)
                total += rectangle_diffuse(p, n, v, panel, area, form, few)
    return total


@kernel
def _cells_specular(
    p: Vector, n: Vector, v: Vector, n_dot_v: float, panel: PanelNumbers, lobe: Lobe, panel_nodes: int, cells: Bool
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
                area = Rectangle(column / CELLS - 0.5, end / CELLS - 0.5, t0, t0 + 1.0 / CELLS)
                total += rectangle_specular(p, n, v, n_dot_v, panel, area, lobe, panel_nodes)
            column = end
    return total
