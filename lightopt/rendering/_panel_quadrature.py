"""The light of a whole rectangle of a panel: the specular lobe integrated where it matters, at a cost free of σ.

The lobe's exponent δ²/(2σ²) is nearly a quadratic form over the panel. Its least value on the rectangle and its shape
there give a window outside which the lobe is negligible; a tensor Gauss–Legendre rule with just enough nodes for how
much the exponent varies integrates the exact expression inside the window. A narrow lobe has a small window, a wide one
varies little: neither needs many nodes.

The lobe of GGX has tails instead of a window. Along each side the nodes are those of a Gauss–Legendre rule in u, where
the side is width · sinh u from where the lobe is greatest: its peak is as smooth in u as its tails are.

Surface points are in the part's frame.
"""

import math
from typing import NamedTuple

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, cross, divided, dot, length, minus, plus, scaled
from lightopt.lights import PanelNumbers, attenuated, half_diagonal, panel_point
from lightopt.optics import (
    EVERYWHERE,
    LAMBERT,
    MAX_LOBE_EXPONENT,
    DiffuseForm,
    Lobe,
    Reflectance,
    fresnel_factor,
    gaussian_lobe,
    is_lambert,
    light_factor,
    narrow_gaussian,
    round_ggx,
    series_reach,
    specular_divisor,
    square_across,
)
from lightopt.rendering._point_lights import diffuse_only, point_terms, round_lobe_numbers
from lightopt.rendering._surface import SurfacePoint

# most Gauss–Legendre nodes along a side; only a view or a light that grazes the surface asks for as many
MAX_NODES = 48

NEGLIGIBLE_EXPONENT = 45.0  # a rectangle where the lobe is nowhere above e⁻⁴⁵ = 3e-20 of R_s gets no specular light
_NEGLIGIBLE_SHARE = NEGLIGIBLE_EXPONENT / MAX_LOBE_EXPONENT

# the window ends where the lobe has fallen to e⁻¹⁴ = 8e-7 of its greatest value on the rectangle
WINDOW_EXPONENT = 14.0

WINDOW_MARGIN = 1.15  # the window is widened by this, since the exponent is only nearly quadratic

# nodes a side of a whole panel where Oren and Nayar's component has a bend on it, and further ones where it has none
_BENT_NODES, _FURTHER_NODES = 12, 2

_PIECE, _MOST_PIECES = 10.0, 64  # of a lobe that is aslant: σ along a side of a piece, and the most pieces along one
_GRAZING = 1e-3
_LINEARISATIONS = 3
_BOX_STEPS = 12


def _gauss_legendre() -> tuple[Float64, Float64]:
    nodes = np.zeros((MAX_NODES + 1, MAX_NODES))
    weights = np.zeros((MAX_NODES + 1, MAX_NODES))
    for n in range(1, MAX_NODES + 1):
        x, w = np.polynomial.legendre.leggauss(n)
        nodes[n, :n] = 0.5 * (x + 1.0)
        weights[n, :n] = 0.5 * w
    for table in (nodes, weights):
        table.flags.writeable = False
    return nodes, weights


NO_LOBE = Reflectance(R_d=1.0, R_s=0.0, sigma=1.0).lobe
TAIL_ERROR, MOST_TAIL_ERROR = 3e-5, 1e-2  # share of the lobe's light by which a rule may be off, and by which at most
# of tails: what they may be off by in R_s, of which they are a tenth in fact, 0.02 level of chrome with R_s = 10⁶
PEAK_ERROR = 2e-7
_FEW_NODES_ERROR = 1e-3  # share of the light of tails from which on two nodes do for fall-off and emission
_FEW_NODES = 8  # a side of a rectangle that a tail is smooth over
_NODES_OF_MASKING = 2  # further ones where the horizon crosses it
_MOST_TAIL_NODES, _TAIL_PIECES = 24, 4  # a side of a rectangle; and pieces a side of one that takes more
_EVEN = 1e3  # width, in sides, from which a lobe is the same all along one

# of the Gauss–Legendre rules on [0, 1]; row n has the rule of n nodes, shape (MAX_NODES + 1, MAX_NODES)
NODES, WEIGHTS = _gauss_legendre()


class Rectangle(NamedTuple):
    """A part [s0, s1] × [t0, t1] of a panel; s and t run over [−½, ½]."""

    s0: float
    s1: float
    t0: float
    t1: float


WHOLE_PANEL = Rectangle(-0.5, 0.5, -0.5, 0.5)


class Plane(NamedTuple):
    """Height of the panel above a plane through the surface point, level + rise_s·s + rise_t·t."""

    level: float
    rise_s: float
    rise_t: float


class _Horizon(NamedTuple):
    """Height of the panel above the surface's tangent plane and above the plane of its face."""

    tangent: Plane
    face: Plane
    lowest: float  # the least height above either, on an area
    highest: float  # the greatest height above the one that the area is less above


@kernel
def rectangle_diffuse(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, form: DiffuseForm, count: int) -> float:
    """Diffuse light, per unit of R_d, of a rectangle of a panel of total weight 1.

    count: Nodes along each side that Lambert's form needs
    """
    if not is_lambert(form):
        count = _diffuse_nodes(at, panel, area, form, count)
    return _integrals(diffuse_only(at), panel, area, NO_LOBE, form, (count, count))[0]


@kernel
def _diffuse_nodes(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, form: DiffuseForm, count: int) -> int:
    """Nodes along each side of a rectangle that a form needs, by the number that Lambert's does.

    Oren and Nayar's component bends where (L − (N·L)·N)·V changes its sign, and where N·L is N·V. Between it is a
    polynomial of L, of degree 2 at most.
    """
    count += _FURTHER_NODES
    if form.roughness == 0.0:
        return count
    n, n_dot_v = at.n, max(0.0, dot(at.n, at.v))
    across = minus(at.v, scaled(n, n_dot_v))
    ahead = steep = 0
    for corner in range(4):
        s, t = area.s1 if corner % 2 else area.s0, area.t1 if corner // 2 else area.t0
        light = minus(panel_point(panel, s, t), at.p)
        ahead += dot(light, across) > 0.0
        steep += dot(light, n) > n_dot_v * length(light)
    if ahead % 4 == 0 and (ahead == 0 or steep % 4 == 0):
        return count
    return max(count, math.ceil(_BENT_NODES * max(area.s1 - area.s0, area.t1 - area.t0)))


@kernel
def _integrals(
    at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, form: DiffuseForm, counts: tuple[int, int]
) -> tuple[float, float]:
    # diffuse and specular terms over a rectangle, by so many Gauss–Legendre nodes along its sides
    count_s, count_t = counts
    horizon = _horizon(at, panel, area)
    ends = _broken_rows(horizon, area)
    diffuse = specular = 0.0
    for k in range(len(ends)):
        low, high = ends[k - 1] if k > 0 else area.t0, ends[k]
        if low >= high:
            continue
        part_d = part_s = 0.0
        for i in range(count_t):
            t = low + (high - low) * NODES[count_t, i]
            r0, r1 = _row_above_horizon(horizon, t, area)
            if r0 >= r1:
                continue
            row_d = row_s = 0.0
            for j in range(count_s):
                q = panel_point(panel, r0 + (r1 - r0) * NODES[count_s, j], t)
                d, s = point_terms(at, q, panel, lobe, form)
                row_d += WEIGHTS[count_s, j] * d
                row_s += WEIGHTS[count_s, j] * s
            part_d += WEIGHTS[count_t, i] * (r1 - r0) * row_d
            part_s += WEIGHTS[count_t, i] * (r1 - r0) * row_s
        diffuse += part_d * (high - low)
        specular += part_s * (high - low)
    return diffuse, specular


@kernel
def _horizon(at: SurfacePoint, panel: PanelNumbers, area: Rectangle) -> _Horizon:
    tangent = plane_over(at.n, at.p, panel)
    lowest, highest = _heights(tangent, area)
    if at.facet.x == at.n.x and at.facet.y == at.n.y and at.facet.z == at.n.z:
        return _Horizon(tangent, tangent, lowest, highest)
    face = plane_over(at.facet, at.p, panel)
    low, high = _heights(face, area)
    return _Horizon(tangent, face, min(lowest, low), min(highest, high))


@kernel
def plane_over(normal: Vector, p: Vector, panel: PanelNumbers) -> Plane:
    """Height of a panel above the plane through a surface point that is perpendicular to a unit normal."""
    return Plane(dot(normal, minus(panel.centre, p)), dot(normal, panel.across), dot(normal, panel.along))


@kernel
def _heights(plane: Plane, area: Rectangle) -> tuple[float, float]:
    # the least and the greatest one on an area
    a, b, c, d = plane.rise_s * area.s0, plane.rise_s * area.s1, plane.rise_t * area.t0, plane.rise_t * area.t1
    return plane.level + min(a, b) + min(c, d), plane.level + max(a, b) + max(c, d)


@kernel
def _broken_rows(horizon: _Horizon, area: Rectangle) -> tuple[float, float, float, float, float, float]:
    # what is above a plane is a half-plane of (s, t) with a break of the integrand along its border: rows of nodes end
    # there, and are taken apart where it meets the rectangle's sides or the other border; where each part ends in t
    end = area.t1
    if horizon.lowest > 0.0:
        return end, end, end, end, end, end
    a, b = _breaks(horizon.tangent, area)
    c, d = _breaks(horizon.face, area)
    # in order
    first, second, third, fourth = min(a, c), max(a, c), min(b, d), max(b, d)
    second, third = min(second, third), max(second, third)
    middle = _crossing(horizon, area)
    first, middle = min(first, middle), max(first, middle)
    second, middle = min(second, middle), max(second, middle)
    third, middle = min(third, middle), max(third, middle)
    fourth, middle = min(fourth, middle), max(fourth, middle)
    return first, second, third, fourth, middle, end


@kernel
def _breaks(plane: Plane, area: Rectangle) -> tuple[float, float]:
    # where the border of what is above a plane meets the rectangle's sides s0 and s1, in order
    level, rise_s, rise_t = plane
    if rise_t == 0.0:
        return area.t1, area.t1
    at_start, at_end = -(level + rise_s * area.s0) / rise_t, -(level + rise_s * area.s1) / rise_t
    first = min(max(min(at_start, at_end), area.t0), area.t1)
    return first, min(max(max(at_start, at_end), area.t0), area.t1)


@kernel
def _crossing(horizon: _Horizon, area: Rectangle) -> float:
    # t where both borders cross; the rectangle's end where they are parallel
    one, other = horizon.tangent, horizon.face
    determinant = one.rise_s * other.rise_t - other.rise_s * one.rise_t
    if determinant == 0.0:
        return area.t1
    return min(max((other.rise_s * one.level - one.rise_s * other.level) / determinant, area.t0), area.t1)


@kernel
def _row_above_horizon(horizon: _Horizon, t: float, area: Rectangle) -> tuple[float, float]:
    # the part of a row of the rectangle that is above both planes; empty where none is
    if horizon.lowest > 0.0:
        return area.s0, area.s1
    low, high = _row_above(horizon.tangent, t, area.s0, area.s1)
    return _row_above(horizon.face, t, low, high)


@kernel
def _row_above(plane: Plane, t: float, s0: float, s1: float) -> tuple[float, float]:
    height = plane.level + plane.rise_t * t
    if plane.rise_s > 0.0:
        return max(s0, -height / plane.rise_s), s1
    if plane.rise_s < 0.0:
        return s0, min(s1, -height / plane.rise_s)
    return (s0, s1) if height > 0.0 else (s0, s0)


@kernel
def rectangle_specular(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int) -> float:
    """Specular light, per unit of R_s, of a rectangle of a panel of total weight 1.

    panel_nodes: Nodes a side that the whole panel needs for its fall-off and emission
    """
    if at.n_dot_v <= 0.0:
        return 0.0
    if lobe.plain:
        return _gaussian_light(at, panel, area, lobe, panel_nodes)
    if lobe.ggx and lobe.widening > 1.0:
        return _brushed_light(at, panel, area, lobe, panel_nodes)
    if lobe.ggx:
        return _tailed_light(at, panel, area, lobe, panel_nodes)
    total = 0.0
    for number in range(lobe.wider + 1):
        share, one = gaussian_lobe(lobe, number)
        if lobe.widening > 1.0:
            total += share * _brushed_light(at, panel, area, one, panel_nodes)
        else:
            total += share * _gaussian_light(at, panel, area, one, panel_nodes)
    return total


class Exponent(NamedTuple):
    """The exponent δ²/(2σ²) of a lobe about a place (s, t) of a light.

    a, b, c: Half its Hessian [[a, b], [b, c]]
    gs, gt: Half its gradient
    least: Its value
    """

    s: float
    t: float
    a: float
    b: float
    c: float
    gs: float
    gt: float
    least: float


@kernel
def exponent_at(
    at: SurfacePoint, s: float, t: float, place: Vector, along_s: Vector, along_t: Vector, lobe: Lobe
) -> Exponent:
    """That of the place (s, t) [mm], which moves along `along_s` and `along_t`: the exponent is k·|h + J·Δx|²."""
    hx, hy, jxs, jxt, jys, jyt = _half_vector_map(at, place, along_s, along_t, lobe)
    k = lobe.inverse
    a, b, c = k * (jxs * jxs + jys * jys), k * (jxs * jxt + jys * jyt), k * (jxt * jxt + jyt * jyt)
    return Exponent(s, t, a, b, c, k * (jxs * hx + jys * hy), k * (jxt * hx + jyt * hy), k * (hx * hx + hy * hy))


@kernel
def _nearest(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, far: float) -> Exponent:
    # where on a rectangle the lobe is greatest. far: exponent beyond which nothing is sought
    s, t = mirror_point(at, panel)
    s, t = min(max(s, area.s0), area.s1), min(max(t, area.t0), area.t1)
    near = exponent_at(at, s, t, panel_point(panel, s, t), panel.across, panel.along, lobe)
    for _ in range(_LINEARISATIONS - 1):
        if near.least > far:
            break
        s, t = least_in_box(near, area)
        if abs(s - near.s) < 1e-6 and abs(t - near.t) < 1e-6:
            break
        near = exponent_at(at, s, t, panel_point(panel, s, t), panel.across, panel.along, lobe)
    return near


@kernel
def _gaussian_light(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int) -> float:
    near = _nearest(at, panel, area, lobe, 50.0 * NEGLIGIBLE_EXPONENT)
    if near.least > NEGLIGIBLE_EXPONENT:
        return 0.0
    window = lobe_window(near, area)
    if window.s0 >= window.s1 or window.t0 >= window.t1:
        return 0.0
    least_s = math.ceil(panel_nodes * (window.s1 - window.s0)) + 1
    least_t = math.ceil(panel_nodes * (window.t1 - window.t0)) + 1
    count_s = max(node_count(near.a, near.gs, window.s0 - near.s, window.s1 - near.s), least_s)
    count_t = max(node_count(near.c, near.gt, window.t0 - near.t, window.t1 - near.t), least_t)
    if _horizon(at, panel, window).lowest > 0.0:
        return _lobe_above_horizon(at, panel, window, lobe, (count_s, count_t))
    return _integrals(at, panel, window, lobe, LAMBERT, (count_s, count_t))[1]


@kernel
def _tailed_light(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int) -> float:
    # of a lobe with tails
    light = _tail_about_peak(at, panel, area, lobe, panel_nodes, _MOST_TAIL_NODES)
    if light >= 0.0:
        return light
    light = 0.0
    for k in range(_TAIL_PIECES * _TAIL_PIECES):
        piece = piece_of(area, k, _TAIL_PIECES, _TAIL_PIECES)
        light += _tail_about_peak(at, panel, piece, lobe, panel_nodes, MAX_NODES)
    return light


@kernel
def _tail_about_peak(
    at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int, most: int
) -> float:
    # light of a rectangle with at most so many nodes a side; −1 where it takes more, but for MAX_NODES. The lobe's
    # width is α = 2σ in δ: (2 + exponent)/2 is to the power of −2
    horizon = _horizon(at, panel, area)
    if horizon.highest <= 0.0:
        return 0.0
    whole, few = horizon.lowest > 0.0, nodes_of_tail(at, panel, area, lobe, panel_nodes)
    if few < MAX_NODES:
        return _tail_light(at, panel, area, lobe, few if whole else few + _NODES_OF_MASKING, horizon)
    s, t, a, b, c, gs, gt, least = _nearest(at, panel, area, lobe, EVERYWHERE)
    centre_s, width_s = peak(a, gs, least, s, area.s0, area.s1)
    centre_t, width_t = peak(c, gt, least, t, area.t0, area.t1)
    u0, u1 = math.asinh((area.s0 - centre_s) / width_s), math.asinh((area.s1 - centre_s) / width_s)
    w0, w1 = math.asinh((area.t0 - centre_t) / width_t), math.asinh((area.t1 - centre_t) / width_t)
    # the lobe is singular in u at ±iπ/2, and nearer where it leans across the sides
    slant = min(1.0, abs(b) / math.sqrt(max(a * c, 1e-30)))
    leaning = min(0.5 * math.pi / (1.0 + 2.0 * slant), math.acos(slant))
    count_s, count_t = tail_nodes(u0, u1, leaning, TAIL_ERROR), tail_nodes(w0, w1, leaning, TAIL_ERROR)
    if max(count_s, count_t) > most:
        return -1.0
    count_s = max(count_s, math.ceil(panel_nodes * (area.s1 - area.s0)) + 1)
    count_t = max(count_t, math.ceil(panel_nodes * (area.t1 - area.t0)) + 1)
    if not whole:
        # masking ends the light there, within about α
        count_s, count_t = min(2 * count_s, MAX_NODES), min(2 * count_t, MAX_NODES)
    places, across, ends = np.empty(count_s), np.empty(count_s), _broken_rows(horizon, area)
    room = count_s * count_t * (1 if whole else len(ends))
    s, t, weights = np.empty(room), np.empty(room), np.empty(room)
    number = 0
    for k in range(len(ends)):
        low, high = ends[k - 1] if k > 0 else area.t0, ends[k]
        if low >= high:
            continue
        w0, w1 = math.asinh((low - centre_t) / width_t), math.asinh((high - centre_t) / width_t)
        for i in range(count_t):
            sinh, cosh = _hyperbolic(w0 + (w1 - w0) * NODES[count_t, i])
            at_t = centre_t + width_t * sinh
            r0, r1 = _row_above_horizon(horizon, at_t, area)
            if r0 >= r1:
                continue
            if not whole:
                u0, u1 = math.asinh((r0 - centre_s) / width_s), math.asinh((r1 - centre_s) / width_s)
            along = width_t * (w1 - w0) * WEIGHTS[count_t, i] * cosh
            for j in range(count_s if number == 0 or not whole else 0):
                sinh, cosh = _hyperbolic(u0 + (u1 - u0) * NODES[count_s, j])
                places[j] = centre_s + width_s * sinh
                across[j] = width_s * (u1 - u0) * WEIGHTS[count_s, j] * cosh
            for j in range(count_s):
                s[number + j], t[number + j], weights[number + j] = places[j], at_t, along * across[j]
            number += count_s
    return _tails_together(at, panel, (s, t, weights), number, lobe)


@kernel
def _hyperbolic(u: float) -> tuple[float, float]:
    # sine and cosine, by one exponential
    up = math.exp(u)
    return 0.5 * (up - 1.0 / up), 0.5 * (up + 1.0 / up)


@kernel
def _tails_together(
    at: SurfacePoint, panel: PanelNumbers, places: tuple[Float64, Float64, Float64], count: int, lobe: Lobe
) -> float:
    # specular light of places (s, t) of a panel, with their weights, of which so many count
    (s, t, weights), values, total = places, np.empty(count), 0.0
    tail_values(at, panel, s, t, values, lobe)
    for k in range(count):
        total += weights[k] * values[k]
    return total / specular_divisor(at.n_dot_v, 0.0, lobe)


@kernel
def above_masking(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe) -> bool:
    """Whether all of a rectangle of a panel is so far above a surface's tangent plane that GGX is hardly masked."""
    alpha = math.sqrt(2.0 / lobe.inverse)
    return _horizon(at, panel, area).lowest > alpha * length(minus(panel.centre, at.p))


@kernel
def nodes_of_tail(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int) -> int:
    """Nodes a side where the tail of a lobe is smooth all over a rectangle; :data:`MAX_NODES` where it is not.

    panel_nodes: Nodes a side that the whole panel needs for its fall-off and emission
    """
    centre = panel_point(panel, 0.5 * (area.s0 + area.s1), 0.5 * (area.t0 + area.t1))
    along, across = (area.s1 - area.s0) * length(panel.across), (area.t1 - area.t0) * length(panel.along)
    half, spread = half_vector_cone(at, centre, 0.5 * math.hypot(along, across))
    return few_tail_nodes(length(minus(at.n, half)), spread, lobe, math.ceil(panel_nodes * (area.s1 - area.s0)))


@kernel
def _tail_light(
    at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, count: int, horizon: _Horizon
) -> float:
    # as the specular term of `_integrals`, for a lobe alike all round
    ends, number = _broken_rows(horizon, area), 0
    most = count * count * (len(ends) if horizon.lowest <= 0.0 else 1)
    s, t, weights = np.empty(most), np.empty(most), np.empty(most)
    for k in range(len(ends)):
        low, high = ends[k - 1] if k > 0 else area.t0, ends[k]
        for i in range(count if low < high else 0):
            row = low + (high - low) * NODES[count, i]
            r0, r1 = _row_above_horizon(horizon, row, area)
            if r0 < r1:
                weight = WEIGHTS[count, i] * (high - low) * (r1 - r0)
                for j in range(count):
                    s[number], t[number] = r0 + (r1 - r0) * NODES[count, j], row
                    weights[number] = weight * WEIGHTS[count, j]
                    number += 1
    return _tails_together(at, panel, (s, t, weights), number, lobe)


@kernel
def tail_values(at: SurfacePoint, panel: PanelNumbers, s: Float64, t: Float64, values: Float64, lobe: Lobe) -> None:
    """Set the specular light of places of a panel above the horizon, but for the view's divisor, shape (k,).

    Of GGX that is alike all round. Loops of few numbers: the processor takes several places at once.

    s, t: Of the places, of which the first k count
    """
    for k in range(len(values)):
        light = minus(panel_point(panel, s[k], t[k]), at.p)
        light = scaled(light, 1.0 / math.sqrt(dot(light, light)))
        chord, n_dot_l, _ = round_lobe_numbers(at.n, at.v, light)
        values[k] = round_ggx(chord, n_dot_l, lobe.inverse)
    for k in range(len(values) if lobe.n > 0.0 else 0):
        light = minus(panel_point(panel, s[k], t[k]), at.p)
        light = scaled(light, 1.0 / math.sqrt(dot(light, light)))
        _, _, size = round_lobe_numbers(at.n, at.v, light)
        values[k] *= fresnel_factor(size, lobe.n, lobe.k, lobe.normal_reflectance)
    for k in range(len(values) if fades(panel) else 0):
        values[k] *= faded(panel, minus(panel_point(panel, s[k], t[k]), at.p))


@kernel
def fades(panel: PanelNumbers) -> bool:
    """Whether a panel's light depends on the distance or the direction."""
    return panel.inverse_square or panel.emission_exponent > 0.0


@kernel
def faded(panel: PanelNumbers, towards: Vector) -> float:
    """What is left of the light of a place, from a surface point towards it [mm]."""
    r2 = dot(towards, towards)
    return attenuated(1.0, panel, r2, dot(panel.outward, towards) / math.sqrt(r2))


@kernel
def _brushed_light(at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, panel_nodes: int) -> float:
    # of a lobe that is wider across the brushing, a ridge that may lie aslant: nodes that resolve its narrow side all
    # over the window, in pieces
    far = EVERYWHERE if lobe.ggx else 50.0 * NEGLIGIBLE_EXPONENT
    near = _nearest(at, panel, area, lobe, far)
    window = area
    if not lobe.ggx:
        if near.least > NEGLIGIBLE_EXPONENT:
            return 0.0
        window = lobe_window(near, area)
    width, height = window.s1 - window.s0, window.t1 - window.t0
    if width <= 0.0 or height <= 0.0:
        return 0.0
    parts_s, count_s = ridge_nodes(width, near.a, lobe.ggx)
    parts_t, count_t = ridge_nodes(height, near.c, lobe.ggx)
    count_s = max(count_s, math.ceil(panel_nodes * width / parts_s) + 1)
    count_t = max(count_t, math.ceil(panel_nodes * height / parts_t) + 1)
    total = 0.0
    for k in range(parts_s * parts_t):
        piece = piece_of(window, k, parts_s, parts_t)
        total += _integrals(at, panel, piece, lobe, LAMBERT, (count_s, count_t))[1]
    return total


@kernel
def ridge_nodes(side: float, curvature: float, tailed: bool) -> tuple[int, int]:
    """Pieces of a side, and nodes in each, for a lobe that may be greatest anywhere on it.

    curvature: Of its exponent along the side, 1/(2σ²) in the side's units; GGX is singular at ±2iσ
    """
    width = side * math.sqrt(max(2.0 * curvature, 0.0))
    parts = min(max(math.ceil(width / _PIECE), 1), _MOST_PIECES)
    width /= parts
    wanted = tail_nodes(-0.5 * width, 0.5 * width, 2.0, TAIL_ERROR) if tailed else math.ceil(4.0 + 0.9 * width)
    return parts, min(wanted, MAX_NODES)


@kernel
def piece_of(window: Rectangle, k: int, parts_s: int, parts_t: int) -> Rectangle:
    """Piece k of a rectangle in equal ones, parts_s along the first side by parts_t along the second."""
    i, j = k // parts_t, k % parts_t
    ds, dt = (window.s1 - window.s0) / parts_s, (window.t1 - window.t0) / parts_t
    s0, t0 = window.s0 + i * ds, window.t0 + j * dt
    return Rectangle(s0, s0 + ds, t0, t0 + dt)


@kernel
def peak(curvature: float, gradient: float, least: float, at: float, low: float, high: float) -> tuple[float, float]:
    """Where along a side a lobe with tails is greatest, and how wide it is about it.

    curvature, gradient, least: Of its exponent curvature·x² + 2·gradient·x + least, x from `at`
    low, high: The side's ends
    """
    if curvature * (_EVEN * (high - low)) ** 2 <= 2.0 + least:
        return at, _EVEN * (high - low)
    away = gradient / curvature
    return at - away, math.sqrt(max((2.0 + least) / curvature - away * away, 2.0 / curvature))


@kernel
def tail_error(exponent: float, negligible: float) -> float:
    """By which share of its light a rule for a lobe with tails may be off: light that is little needs few digits.

    exponent: Of the lobe where it is greatest
    negligible: What it may be off by, as a share of the lobe's peak
    """
    value = 1.0 / (1.0 + 0.5 * exponent) ** 2
    return min(max(negligible / value, TAIL_ERROR), MOST_TAIL_ERROR)


@kernel
def tail_nodes(low: float, high: float, singular: float, error: float) -> int:
    """Nodes of a Gauss–Legendre rule from low to high for a function that is singular at ±i·singular.

    error: As a share of the integral, about
    """
    rate = math.log(_half_axes(low, high, singular))
    return min(math.ceil(0.5 * math.log(1.0 / error) / rate) + 1, MAX_NODES)


@kernel
def _half_axes(low: float, high: float, singular: float) -> float:
    # sum of the half axes of the ellipse through ±i·singular whose foci are the ends: with each node the error of a
    # Gauss–Legendre rule falls by its square
    half = max(0.5 * (high - low), 1e-9)
    x, y = 0.5 * (low + high) / half, singular / half
    axis = 0.5 * (math.sqrt((x - 1.0) ** 2 + y * y) + math.sqrt((x + 1.0) ** 2 + y * y))
    return axis + math.sqrt(axis * axis - 1.0)


@kernel
def few_tail_nodes(away: float, spread: float, lobe: Lobe, least: int) -> int:
    """As :func:`smooth_nodes_within` has them for tails, up to 8; :data:`MAX_NODES` where more. Without branches.

    least: Nodes that fall-off and emission need where the tails are not faint
    """
    nearest = max(0.0, away - spread)
    error = tail_error(nearest * nearest * lobe.inverse, PEAK_ERROR)
    falls = _half_axes(away - spread, away + spread, math.sqrt(2.0 / lobe.inverse)) ** 2
    wanted, reached = 2, falls * error
    for _ in range(_FEW_NODES - 1):
        wanted += reached < 1.0
        reached *= falls
    enough = (wanted <= _FEW_NODES) & (spread < 1.0)
    return max(wanted, least if error < _FEW_NODES_ERROR else 2) if enough else MAX_NODES


@kernel
def lobe_window(near: Exponent, area: Rectangle) -> Rectangle:
    """Where on an area the lobe is not negligible, from its exponent's quadratic form; empty where nowhere."""
    s, t, a, b, c, gs, gt, least = near
    window = area
    determinant = a * c - b * b
    if not (determinant <= 1e-12 * a * c or a <= 0.0 or c <= 0.0):
        centre_s = s - (c * gs - b * gt) / determinant
        centre_t = t - (a * gt - b * gs) / determinant
        reach = WINDOW_MARGIN * WINDOW_MARGIN * (least + WINDOW_EXPONENT) / determinant
        half_s, half_t = math.sqrt(reach * c), math.sqrt(reach * a)
        window = Rectangle(
            max(area.s0, centre_s - half_s),
            min(area.s1, centre_s + half_s),
            max(area.t0, centre_t - half_t),
            min(area.t1, centre_t + half_t),
        )
    return window


@kernel
def _lobe_above_horizon(
    at: SurfacePoint, panel: PanelNumbers, area: Rectangle, lobe: Lobe, counts: tuple[int, int]
) -> float:
    # the specular term of `_integrals` where no horizon crosses the rectangle: the processor works on several nodes at
    # once in loops without branches over numbers that lie side by side
    p, n, v, n_dot_v, _ = at
    (count_s, count_t), reach = counts, series_reach(lobe.inverse)
    chord, values = np.empty(count_s * count_t), np.empty(count_s * count_t)
    width, height = area.s1 - area.s0, area.t1 - area.t0
    for i in range(count_t):
        t, first = area.t0 + height * NODES[count_t, i], i * count_s
        for j in range(count_s):
            light = minus(panel_point(panel, area.s0 + width * NODES[count_s, j], t), p)
            r2 = dot(light, light)
            light = scaled(light, 1.0 / math.sqrt(r2))
            half = plus(light, v)
            size = math.sqrt(dot(half, half))
            away = minus(n, scaled(half, 1.0 / size))
            chord[first + j] = dot(away, away)
            weight = WEIGHTS[count_t, i] * WEIGHTS[count_s, j]
            values[first + j] = attenuated(weight, panel, r2, dot(panel.outward, light))
            if not lobe.plain:
                chord[first + j] = max(0.0, chord[first + j] - square_across(away, lobe))
                values[first + j] *= light_factor(dot(n, light), square_across(light, lobe), size, lobe)
    for k in range(len(values)):
        values[k] *= narrow_gaussian(min(chord[k], reach), lobe.inverse)
    total = widest = 0.0
    for k in range(len(values)):
        total += values[k]
        widest = max(widest, chord[k])
    if widest >= reach:
        # δ of 29° or more, where only a rough surface shows a lobe
        return _integrals(at, panel, area, lobe, LAMBERT, counts)[1]
    return total * width * height / specular_divisor(n_dot_v, square_across(v, lobe), lobe)


@kernel
def smooth_nodes(
    at: SurfacePoint, centre: Vector, reach: float, lobe: Lobe, error: float, negligible: float = NEGLIGIBLE_EXPONENT
) -> int:
    """Nodes a side that integrate a lobe where it is smooth all over a light; :data:`MAX_NODES` where it is not.

    Of several Gaussian lobes, the narrowest one that is not negligible counts; never the first.

    centre, reach: Of the light, and how far its points are from there at most [mm]
    error: Of tails, as a share of the light
    negligible: Exponent from which a Gaussian lobe is
    """
    away, spread = lobe_cone(at, centre, reach, lobe)
    return smooth_nodes_within(away, spread, lobe, error, negligible)


@kernel
def lobe_cone(at: SurfacePoint, centre: Vector, reach: float, lobe: Lobe) -> tuple[float, float]:
    """How far a light's half vector is from the lobe's middle, as the lobe counts it, and how its points spread.

    centre, reach: As :func:`half_vector_cone` takes them, which has the second
    """
    half, spread = half_vector_cone(at, centre, reach)
    off = minus(at.n, half)
    away = length(off)
    if lobe.widening > 1.0:
        away = math.sqrt(max(0.0, away * away - square_across(off, lobe)))
    return away, spread


@kernel
def smooth_nodes_within(away: float, spread: float, lobe: Lobe, error: float, negligible: float) -> int:
    """:func:`smooth_nodes` of a light whose half vectors are within `spread` of one that is `away` from the normal."""
    if spread >= 1.0:
        return MAX_NODES
    if lobe.ggx:
        # singular where δ = ±iα
        return tail_nodes(away - spread, away + spread, math.sqrt(2.0 / lobe.inverse), error)
    nearest = max(0.0, away - spread)
    if nearest * nearest * lobe.inverse <= negligible:
        return MAX_NODES
    narrowest = 0
    while narrowest < lobe.wider - 1 and nearest * nearest * lobe.inverses[narrowest] > negligible:
        narrowest += 1
    inverse = lobe.inverses[narrowest]
    return node_count(inverse, inverse * away, -min(spread, away), spread)


@kernel
def gaussian_nodes(away: float, spread: float, lobe: Lobe) -> int:
    """As :func:`smooth_nodes_within`, of Gaussian lobes of which even the narrowest may be near.

    The count was found by trying: it integrates e^(−κx² − γx) from −1 to 1 to 2e-4 of the integral, with γ by how steep
    the lobe is and κ by how wide; one more, since the exponent is only nearly quadratic.
    """
    nearest, inverse, k = max(0.0, away - spread), lobe.inverse, 0
    while k < lobe.wider and nearest * nearest * inverse > NEGLIGIBLE_EXPONENT:
        inverse = lobe.inverses[k]
        k += 1
    steep, width = 2.0 * inverse * away * spread, 2.0 * spread * math.sqrt(2.0 * inverse)
    return math.ceil(max(2.0 + width, min(2.0 + 0.9 * steep, 3.0 + 0.56 * steep))) + 1


@kernel
def out_of_reach(at: SurfacePoint, panel: PanelNumbers, lobe: Lobe) -> bool:
    """Whether the lobe is surely negligible all over the panel: a quick test that looks at its centre alone."""
    half, spread = half_vector_cone(at, panel.centre, half_diagonal(panel))
    # the chord is never more than the angle
    nearest = max(0.0, length(minus(at.n, half)) - spread)
    return (spread < math.pi) & (nearest * nearest * lobe.inverse > _NEGLIGIBLE_SHARE * lobe.farthest)


@kernel
def half_vector_cone(at: SurfacePoint, centre: Vector, reach: float) -> tuple[Vector, float]:
    """Unit half vector of a light's centre, and how far those of points within reach [mm] are from it, at most [rad].

    While L turns by α, H turns by no more than α / (2·cos(half the angle between L and V)). Where nothing is known, the
    angle is π, and the vector may be of another length. No branches: many points are tested at once.
    """
    light = minus(centre, at.p)
    r = length(light)
    half = plus(divided(light, r), at.v)
    size = length(half)
    # L turns by α ≤ 2·tan(α/2), sinα = reach / r; cosine of half the angle to V, and when L has turned away by α
    sine = reach / r
    usable = (sine < 0.9) & (size >= 1e-3)
    sine, size = min(sine, 0.9), max(size, 1e-3)
    half_cosine = math.sqrt(0.5 + 0.5 * math.sqrt(1.0 - sine * sine))
    half_sine = 0.5 * sine / half_cosine
    between = min(1.0, 0.5 * size)
    cosine = between * half_cosine - math.sqrt(1.0 - between * between) * half_sine
    usable = usable & (cosine >= 0.1)
    spread = half_sine / (half_cosine * max(cosine, 0.1))
    return divided(half, size), spread if usable else math.pi


@kernel
def mirror_point(at: SurfacePoint, panel: PanelNumbers) -> tuple[float, float]:
    """Where the mirrored view meets the panel's plane, (s, t) in the panel's sides; its centre where it never does."""
    mirrored = minus(scaled(at.n, 2.0 * at.n_dot_v), at.v)
    centre = minus(panel.centre, at.p)
    towards, ahead = dot(mirrored, panel.outward), dot(centre, panel.outward)
    if abs(towards) < _GRAZING or ahead / towards <= 0.0:
        return 0.0, 0.0
    place = minus(scaled(mirrored, ahead / towards), centre)
    return (
        dot(place, panel.across) / dot(panel.across, panel.across),
        dot(place, panel.along) / dot(panel.along, panel.along),
    )


@kernel
def _half_vector_map(
    at: SurfacePoint, place: Vector, along_s: Vector, along_t: Vector, lobe: Lobe
) -> tuple[float, float, float, float, float, float]:
    # components of H in the tangent plane of N, and their derivatives along s and t; so that |h| is δ, not its sine. Of
    # a brushed surface, the component across the brushing counts as much less as the lobe is wider there
    n = at.n
    light = minus(place, at.p)
    r = length(light)
    light = divided(light, r)
    half = plus(light, at.v)
    size = length(half)
    half = divided(half, size)
    # any two unit vectors perpendicular to N and to each other
    if abs(n.z) < 0.9:
        root = math.sqrt(n.x * n.x + n.y * n.y)
        a = Vector(-n.y / root, n.x / root, 0.0)
    else:
        root = math.sqrt(n.y * n.y + n.z * n.z)
        a = Vector(0.0, -n.z / root, n.y / root)
    shrunk = 1.0
    if lobe.widening > 1.0:
        aside = minus(lobe.across, scaled(n, dot(n, lobe.across)))
        root = length(aside)
        if root > _GRAZING:
            a, shrunk = divided(aside, root), 1.0 / math.sqrt(lobe.widening)
    b = cross(n, a)
    ha, hb = dot(half, a), dot(half, b)
    sine = math.sqrt(ha * ha + hb * hb)
    scale = 1.0
    if sine > 1e-6:
        scale = math.atan2(sine, dot(half, n)) / sine
    across = _half_vector_step(along_s, r, light, size, half)
    along = _half_vector_step(along_t, r, light, size, half)
    return (
        shrunk * scale * ha,
        scale * hb,
        shrunk * scale * dot(across, a),
        shrunk * scale * dot(along, a),
        scale * dot(across, b),
        scale * dot(along, b),
    )


@kernel
def _half_vector_step(side: Vector, r: float, light: Vector, size: float, half: Vector) -> Vector:
    # derivative of the unit half vector when the light moves along one side of the panel
    step = divided(minus(side, scaled(light, dot(side, light))), r)
    return divided(minus(step, scaled(half, dot(step, half))), size)


@kernel
def least_in_box(near: Exponent, area: Rectangle) -> tuple[float, float]:
    """Where an exponent's quadratic form is least in a box, one coordinate after the other: it is convex."""
    s, t, a, b, c, gs, gt, _ = near
    if a <= 0.0 or c <= 0.0:
        return s, t
    gs, gt = gs - a * s - b * t, gt - b * s - c * t
    for _ in range(_BOX_STEPS):
        before = s, t
        s = min(max(-(gs + b * t) / a, area.s0), area.s1)
        t = min(max(-(gt + b * s) / c, area.t0), area.t1)
        if (s, t) == before:
            break
    return s, t


@kernel
def node_count(curvature: float, gradient: float, low: float, high: float) -> int:
    """Nodes that integrate exp(−q), q = curvature·x² + 2·gradient·x on [low, high], to 2e-4 of the integral.

    They were found by trying; one more, since the exponent is only nearly quadratic.
    """
    at_low = curvature * low * low + 2.0 * gradient * low
    at_high = curvature * high * high + 2.0 * gradient * high
    spread = max(at_low, at_high, 0.0)
    width = (high - low) * math.sqrt(2.0 * curvature)
    if spread < 0.05:
        count = 2
    elif spread < 0.2:
        count = 3
    elif spread < 1.0:
        count = 4
    elif spread < 6.0:
        count = 5
    else:
        count = 6
    if width > 2.0:
        count = max(count, math.ceil(3.0 + 0.9 * width))
    return min(count + 1, MAX_NODES)
