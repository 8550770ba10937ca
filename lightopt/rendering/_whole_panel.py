"""The light of a whole panel, where nothing is in the way."""

import math

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, column_at, dot, length, minus, scaled
from lightopt.lights import PanelNumbers, attenuated, half_diagonal, panel_point
from lightopt.optics import (
    MAX_LOBE_EXPONENT,
    NARROW_CHORD_SQUARED,
    Lobe,
    is_lambert,
    lambert,
    lobe_at,
    series_reach,
    specular_divisor,
    square_across,
)
from lightopt.rendering._panel_quadrature import (
    NEGLIGIBLE_EXPONENT,
    NODES,
    TAIL_ERROR,
    WEIGHTS,
    WHOLE_PANEL,
    faded,
    fades,
    few_tail_nodes,
    gaussian_nodes,
    half_vector_cone,
    lobe_cone,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
    smooth_nodes_within,
)
from lightopt.rendering._penumbra import ConvergedLight
from lightopt.rendering._point_lights import diffuse_only, lobe_towards, point_terms, round_lobe_numbers, round_lobes
from lightopt.rendering._surface import PointRows, SurfacePoint, point_at, surface_point

_AT_ONCE = 1024  # points whose terms are in the processor's nearest cache together
_STEP_S, _STEP_T = 0.6287067210378087, 0.5385972572236101  # 1/g³ and 1/g⁴ of g⁵ = g + 1
FAR_SHARE = 20.0 / MAX_LOBE_EXPONENT  # of the farthest exponent, e⁻²⁰ of the lobe, beyond which it is left out there
_MOST_EVEN = 12  # nodes a side up to which a lobe is smooth all over the panel


@kernel
def whole_panel(rows: PointRows, index: Int32, light: ConvergedLight, terms: Float64) -> None:
    """Set the diffuse and specular light, per unit of R_d and R_s, of a panel of weight 1 at some points.

    index: Of the points, shape (j,)
    terms: Shape (k, 2)
    """
    points, frames, views, facets, _ = rows
    panel, lobe, form, nodes = light.panel, light.lobe, light.form, light.nodes
    plain = is_lambert(form)
    # the processor works on several points at once in loops without branches over numbers that lie side by side
    p, n, v, f = np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE))
    diffuse, above, near = np.empty(_AT_ONCE), np.empty(_AT_ONCE, np.bool_), np.empty(_AT_ONCE, np.bool_)
    specular, work = np.empty(_AT_ONCE), np.empty((14, _AT_ONCE))
    for first in range(0, len(index), _AT_ONCE):
        count = min(_AT_ONCE, len(index) - first)
        for j in range(count):
            i = index[first + j]
            for axis in range(3):
                p[axis, j], n[axis, j], v[axis, j] = points[i, axis], frames[i, axis], views[i, axis]
                f[axis, j] = facets[i, axis]
        for j in range(count):
            at = surface_point(column_at(p, j), column_at(n, j), column_at(v, j))
            towards = minus(panel.centre, at.p)
            above[j] = _is_above(at.n, towards, panel) & _is_above(column_at(f, j), towards, panel)
            near[j] = True
            specular[j] = 0.0
            diffuse[j] = 0.0
        for j in range(0 if lobe.ggx else count):
            near[j] = not out_of_reach(surface_point(column_at(p, j), column_at(n, j), column_at(v, j)), panel, lobe)
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
        own = index[first : first + count]
        _add_smooth((p, n, v), frames, own, above[:count], near, light, work, specular)
        for j in range(count):
            i = index[first + j]
            normal, view = column_at(n, j), column_at(v, j)
            at = SurfacePoint(column_at(p, j), normal, view, dot(normal, view), column_at(f, j))
            if not (plain and above[j]):
                diffuse[j] = rectangle_diffuse(at, panel, WHOLE_PANEL, form, nodes)
            terms[i, 0], terms[i, 1] = diffuse[j], specular[j]
            if near[j]:
                terms[i, 1] = rectangle_specular(at, panel, WHOLE_PANEL, lobe_at(lobe, frames, i), nodes)


@kernel
def _is_above(normal: Vector, towards: Vector, panel: PanelNumbers) -> bool:
    # whether all of a panel is above the plane of a normal; towards: From the surface point to the panel's centre
    return dot(normal, towards) > 0.5 * (abs(dot(normal, panel.across)) + abs(dot(normal, panel.along)))


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
    # where a lobe is smooth all over the panel: sets the light of these points, which are no longer `near`. The points
    # that take as many nodes are worked out together
    (at_p, at_n, at_v), panel, lobe = columns, light.panel, light.lobe
    wanted, place = np.zeros(len(above), np.int64), np.empty(len(above), np.int64)
    brushed, widest = lobe.widening > 1.0, math.sqrt(series_reach(lobe.inverse))
    for j in range(len(above) if lobe.ggx and not brushed else 0):
        at = surface_point(column_at(at_p, j), column_at(at_n, j), column_at(at_v, j))
        away, spread = lobe_cone(at, panel.centre, half_diagonal(panel), lobe)
        few = few_tail_nodes(away, spread, lobe, light.nodes)
        wanted[j] = few if near[j] & above[j] & (at.n_dot_v > 0.0) else 0
    for j in range(len(above) if brushed or not lobe.ggx else 0):
        at = surface_point(column_at(at_p, j), column_at(at_n, j), column_at(at_v, j))
        if near[j] and above[j] and at.n_dot_v > 0.0:
            away, spread = lobe_cone(at, panel.centre, half_diagonal(panel), lobe_at(lobe, frames, index[j]))
            if lobe.ggx:
                wanted[j] = few_tail_nodes(away, spread, lobe, light.nodes)
            elif away + spread < widest:
                wanted[j] = max(gaussian_nodes(away, spread, lobe), light.nodes + 1)
            else:
                few = smooth_nodes_within(away, spread, lobe, TAIL_ERROR, NEGLIGIBLE_EXPONENT)
                wanted[j] = max(few, light.nodes)
    p, n, v, light_sum, spare = work[0:3], work[3:6], work[6:9], work[9], (work[10], work[11], work[12], work[13])
    for few in range(2, _MOST_EVEN + 1):
        number = 0
        for j in range(len(above)):
            if wanted[j] == few:
                place[number] = j
                for axis in range(3):
                    p[axis, number], n[axis, number], v[axis, number] = at_p[axis, j], at_n[axis, j], at_v[axis, j]
                number += 1
        if number == 0:
            continue
        light_sum[:number] = 0.0
        for a in range(few):
            for b in range(few):
                q = panel_point(panel, NODES[few, b] - 0.5, NODES[few, a] - 0.5)
                weight = WEIGHTS[few, a] * WEIGHTS[few, b]
                if not brushed:
                    _add_node((p, n, v), panel, q, weight, lobe, spare, light_sum[:number])
                    continue
                for k in range(number):
                    towards = minus(q, column_at(p, k))
                    r2 = dot(towards, towards)
                    towards = scaled(towards, 1.0 / math.sqrt(r2))
                    turned = lobe_at(lobe, frames, index[place[k]])
                    value = lobe_towards(column_at(n, k), column_at(v, k), towards, turned)
                    light_sum[k] += value * attenuated(weight, panel, r2, dot(panel.outward, towards))
        for k in range(number):
            j = place[k]
            view = column_at(at_v, j)
            across = square_across(view, lobe_at(lobe, frames, index[j]))
            specular[j] = light_sum[k] / specular_divisor(dot(column_at(at_n, j), view), across, lobe)
            near[j] = False


@kernel
def _add_node(
    columns: tuple[Float64, Float64, Float64],
    panel: PanelNumbers,
    q: Vector,
    weight: float,
    lobe: Lobe,
    work: tuple[Float64, Float64, Float64, Float64],
    total: Float64,
) -> None:
    # adds the light of a place of the panel at some points, of a lobe that is alike all round. Loops of few numbers,
    # and a function of its own, whose arrays do not overlap for all the compiler knows: it takes several points at once
    (p, n, v), (chord, n_dot_l, half_size, values), count = columns, work, len(total)
    for k in range(count):
        towards = minus(q, column_at(p, k))
        towards = scaled(towards, 1.0 / math.sqrt(dot(towards, towards)))
        chord[k], n_dot_l[k], half_size[k] = round_lobe_numbers(column_at(n, k), column_at(v, k), towards)
    round_lobes(values, chord, n_dot_l, half_size, count, lobe)
    if fades(panel):
        for k in range(count):
            values[k] *= faded(panel, minus(q, column_at(p, k)))
    for k in range(count):
        total[k] += weight * values[k]


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
    # the series of Gaussian lobes serves at all angles, as the form of GGX does
    everywhere = lobe.ggx or series_reach(lobe.inverse) > NARROW_CHORD_SQUARED
    together = is_lambert(form) and lobe.widening == 1.0 and everywhere
    p, n, v = np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE))
    places, index = np.empty((2, _AT_ONCE)), np.empty(_AT_ONCE, np.int64)
    count = 0
    for i in range(len(points)):
        if clear[i]:
            at = point_at(points, frames, views, i)
            s, t = _STEP_S * i, _STEP_T * i
            s, t = s - math.floor(s), t - math.floor(t)
            half, spread = half_vector_cone(at, panel.centre, reach)
            nearest = max(0.0, length(minus(at.n, half)) - spread)
            if spread < math.pi and nearest * nearest * lobe.inverse > FAR_SHARE * lobe.farthest:
                # diffuse light is as even as one place shows it
                q = panel_point(panel, s - 0.5, t - 0.5)
                terms[i, 0] += point_terms(diffuse_only(at), q, panel, lobe, form)[0]
            elif together:
                index[count], places[0, count], places[1, count] = i, s, t
                for axis in range(3):
                    p[axis, count], n[axis, count], v[axis, count] = points[i, axis], frames[i, axis], views[i, axis]
                count += 1
            else:
                turned = lobe_at(lobe, frames, i)
                for a in range(cells):
                    for b in range(cells):
                        q = panel_point(panel, (a + s) / cells - 0.5, (b + t) / cells - 0.5)
                        diffuse, specular = point_terms(at, q, panel, turned, form)
                        terms[i, 0] += share * diffuse
                        terms[i, 1] += share * specular
        if count == _AT_ONCE or (i + 1 == len(points) and count > 0):
            sums = _spread_light((p, n, v), places[:, :count], cells, panel, lobe)
            for j in range(count):
                n_dot_v = dot(column_at(n, j), column_at(v, j))
                terms[index[j], 0] += share * sums[0][j]
                if n_dot_v > 0.0:
                    terms[index[j], 1] += share * sums[1][j] / specular_divisor(n_dot_v, 0.0, lobe)
            count = 0


@kernel
def _spread_light(
    columns: tuple[Float64, Float64, Float64], places: Float64, cells: int, panel: PanelNumbers, lobe: Lobe
) -> tuple[Float64, Float64]:
    # sums of diffuse light, and of specular light but for its divisor, over a place in each of cells × cells of the
    # panel; in loops as those of `_add_node`
    (p, n, v), count = columns, places.shape[1]
    chord, n_dot_l, half_size, values = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    weights, diffuse, specular = np.ones(count), np.zeros(count), np.zeros(count)
    for a in range(cells):
        for b in range(cells):
            for k in range(count):
                q = panel_point(panel, (a + places[0, k]) / cells - 0.5, (b + places[1, k]) / cells - 0.5)
                towards = minus(q, column_at(p, k))
                towards = scaled(towards, 1.0 / math.sqrt(dot(towards, towards)))
                chord[k], n_dot_l[k], half_size[k] = round_lobe_numbers(column_at(n, k), column_at(v, k), towards)
                n_dot_l[k] = lambert(n_dot_l[k])
            if fades(panel):
                for k in range(count):
                    q = panel_point(panel, (a + places[0, k]) / cells - 0.5, (b + places[1, k]) / cells - 0.5)
                    weights[k] = faded(panel, minus(q, column_at(p, k)))
            round_lobes(values, chord, n_dot_l, half_size, count, lobe)
            for k in range(count):
                diffuse[k] += weights[k] * n_dot_l[k]
                specular[k] += weights[k] * values[k] if n_dot_l[k] > 0.0 else 0.0
    return diffuse, specular
