"""The light of a whole panel, where nothing is in the way."""

import math

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.vectors import column_at, dot, length, minus, plus, scaled
from lightopt.lights import attenuated, half_diagonal, panel_point
from lightopt.optics import MAX_LOBE_EXPONENT, is_lambert, lambert, lobe_at, specular_divisor, square_across
from lightopt.rendering._panel_quadrature import (
    NEGLIGIBLE_EXPONENT,
    NODES,
    PEAK_ERROR,
    TAIL_ERROR,
    WEIGHTS,
    WHOLE_PANEL,
    half_vector_cone,
    lobe_cone,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
    smooth_nodes_within,
    tail_error,
)
from lightopt.rendering._penumbra import ConvergedLight
from lightopt.rendering._point_lights import diffuse_only, lobe_towards, point_terms, round_lobes
from lightopt.rendering._surface import PointRows, point_at, surface_point

_AT_ONCE = 1024  # points whose terms are in the processor's nearest cache together
_STEP_S, _STEP_T = 0.6287067210378087, 0.5385972572236101  # 1/g³ and 1/g⁴ of g⁵ = g + 1
FAR_SHARE = 20.0 / MAX_LOBE_EXPONENT  # of the farthest exponent, e⁻²⁰ of the lobe, beyond which it is left out there
_FEW_NODES_ERROR = 1e-3  # share of the light of tails from which on few nodes do for fall-off and emission
_MOST_EVEN = 6  # nodes a side up to which a lobe is smooth all over the panel


@kernel
def whole_panel(rows: PointRows, index: Int32, light: ConvergedLight, terms: Float64) -> None:
    """Set the diffuse and specular light, per unit of R_d and R_s, of a panel of weight 1 at some points.

    index: Of the points, shape (j,)
    terms: Shape (k, 2)
    """
    points, frames, views, _, _ = rows
    panel, lobe, form, nodes = light.panel, light.lobe, light.form, light.nodes
    plain = is_lambert(form)
    # the processor works on several points at once in loops without branches over numbers that lie side by side
    p, n, v = np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE))
    diffuse, above, near = np.empty(_AT_ONCE), np.empty(_AT_ONCE, np.bool_), np.empty(_AT_ONCE, np.bool_)
    specular, work = np.empty(_AT_ONCE), np.empty((15, _AT_ONCE))
    for first in range(0, len(index), _AT_ONCE):
        count = min(_AT_ONCE, len(index) - first)
        for j in range(count):
            i = index[first + j]
            for axis in range(3):
                p[axis, j], n[axis, j], v[axis, j] = points[i, axis], frames[i, axis], views[i, axis]
        for j in range(count):
            at = surface_point(column_at(p, j), column_at(n, j), column_at(v, j))
            reach = 0.5 * (abs(dot(at.n, panel.across)) + abs(dot(at.n, panel.along)))
            above[j] = dot(at.n, minus(panel.centre, at.p)) > reach
            near[j] = not out_of_reach(at, panel, lobe)
            specular[j] = 0.0
            diffuse[j] = 0.0
        for a in range(nodes if plain else 0):
            for b in range(nodes):
                q = panel_point(panel, NODES[nodes, b] - 0.5, NODES[nodes, a] - 0.5)
                weight = WEIGHTS[nodes, a] * WEIGHTS[nodes, b]
                for j in range(count):
                    towards = minus(q, column_at(p, j))
                    r2 = dot(towards, towards)
                    towards = scaled(towards, 1.0 / math.sqrt(r2))
                    term = weight * lambert(dot(column_at(n, j), towards))
                    diffuse[j] += attenuated(term, panel, r2, dot(panel.outward, towards))
        if lobe.ggx or lobe.wider > 0:
            own = index[first : first + count]
            _add_smooth((p, n, v), frames, own, above[:count], near, light, work, specular)
        for j in range(count):
            i = index[first + j]
            at = surface_point(column_at(p, j), column_at(n, j), column_at(v, j))
            if not (plain and above[j]):
                diffuse[j] = rectangle_diffuse(at, panel, WHOLE_PANEL, form, nodes)
            terms[i, 0], terms[i, 1] = diffuse[j], specular[j]
            if near[j]:
                terms[i, 1] = rectangle_specular(at, panel, WHOLE_PANEL, lobe_at(lobe, frames, i), nodes)


@kernel
def _add_smooth(
    columns: tuple[Float64, Float64, Float64],
    frames: Float64,
    index: Int32,
    above: Bool,
    near: Bool,
    light: ConvergedLight,
    work: Float64,
    specular: Float64,
) -> None:
    # where the tails of a lobe, or the wider of two, are smooth all over the panel: sets the light of these points,
    # which are no longer `near`. The points that take as many nodes are worked out together
    (p, n, v), panel, lobe = columns, light.panel, light.lobe
    wanted, place = np.zeros(len(above), np.int64), np.empty(len(above), np.int64)
    for j in range(len(above)):
        at = surface_point(column_at(p, j), column_at(n, j), column_at(v, j))
        if near[j] and above[j] and at.n_dot_v > 0.0:
            turned = lobe_at(lobe, frames, index[j])
            away, spread = lobe_cone(at, panel.centre, half_diagonal(panel), turned)
            nearest = max(0.0, away - spread)
            error = tail_error(nearest * nearest * lobe.inverse, PEAK_ERROR) if lobe.ggx else TAIL_ERROR
            least = light.nodes if error < _FEW_NODES_ERROR else 2
            wanted[j] = max(smooth_nodes_within(away, spread, turned, error, NEGLIGIBLE_EXPONENT), least)
    for few in range(2, _MOST_EVEN + 1):
        number = 0
        for j in range(len(above)):
            if wanted[j] == few:
                place[number] = j
                for axis in range(3):
                    work[axis, number], work[3 + axis, number] = p[axis, j], n[axis, j]
                    work[6 + axis, number] = v[axis, j]
                work[9, number] = 0.0
                number += 1
        if number == 0:
            continue
        for a in range(few):
            for b in range(few):
                q = panel_point(panel, NODES[few, b] - 0.5, NODES[few, a] - 0.5)
                weight = WEIGHTS[few, a] * WEIGHTS[few, b]
                for k in range(number):
                    normal, view = column_at(work, k, 3), column_at(work, k, 6)
                    towards = minus(q, column_at(work, k))
                    r2 = dot(towards, towards)
                    towards = scaled(towards, 1.0 / math.sqrt(r2))
                    work[13, k] = attenuated(weight, panel, r2, dot(panel.outward, towards))
                    if lobe.widening > 1.0:
                        work[14, k] = lobe_towards(normal, view, towards, lobe_at(lobe, frames, index[place[k]]))
                    else:
                        half = plus(towards, view)
                        size = math.sqrt(dot(half, half))
                        chord = minus(normal, scaled(half, 1.0 / size))
                        work[10, k], work[11, k], work[12, k] = dot(chord, chord), dot(normal, towards), size
                if lobe.widening == 1.0:
                    round_lobes(work[14], work[10], work[11], work[12], number, lobe)
                for k in range(number):
                    work[9, k] += work[14, k] * work[13, k]
        for k in range(number):
            j = place[k]
            view = column_at(v, j)
            across = square_across(view, lobe_at(lobe, frames, index[j]))
            specular[j] = work[9, k] / specular_divisor(dot(column_at(n, j), view), across, lobe)
            near[j] = False


@kernel
def add_spread_points(rows: PointRows, clear: Bool, cells: int, light: ConvergedLight, terms: Float64) -> None:
    """Add the light of a panel of weight 1 to the clear points, by a place in each of cells × cells of the panel.

    Places follow the last numbers of the R₄ sequence (Roberts 2018) from point to point, so that they do not go with
    those of rays: the mean over many points is that of the panel.

    terms: Diffuse and specular light per unit of R_d and R_s, shape (k, 2)
    """
    points, frames, views, _, _ = rows
    panel, lobe, form = light.panel, light.lobe, light.form
    reach, share = half_diagonal(panel), 1.0 / (cells * cells)
    for i in range(len(points)):
        if not clear[i]:
            continue
        at = point_at(points, frames, views, i)
        s, t = _STEP_S * i, _STEP_T * i
        s, t = s - math.floor(s), t - math.floor(t)
        half, spread = half_vector_cone(at, panel.centre, reach)
        nearest = max(0.0, length(minus(at.n, half)) - spread)
        if spread < math.pi and nearest * nearest * lobe.inverse > FAR_SHARE * lobe.farthest:
            # diffuse light is as even as one place shows it
            terms[i, 0] += point_terms(diffuse_only(at), panel_point(panel, s - 0.5, t - 0.5), panel, lobe, form)[0]
            continue
        turned = lobe_at(lobe, frames, i)
        for a in range(cells):
            for b in range(cells):
                q = panel_point(panel, (a + s) / cells - 0.5, (b + t) / cells - 0.5)
                diffuse, specular = point_terms(at, q, panel, turned, form)
                terms[i, 0] += share * diffuse
                terms[i, 1] += share * specular
