"""The light of surfaces other than panels: elements of planes, cones and spheres, each seen or hidden as its middle is.

Diffuse light takes a few Gauss–Legendre nodes of each element. The lobe is integrated as over a panel
(:mod:`lightopt.rendering._panel_quadrature`): where it is least far from the normal, the exponent's quadratic form in
(u, v) gives a window and the nodes that it takes. Where a part hides some of the elements, those that the lobe reaches
are divided, each piece with a ray of its own.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import available_processors, end_if_stopped, in_threads
from lightopt.core.vectors import Vector, column_at, cross, dot, length, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import (
    PICTURE,
    RADIANCE,
    SPHERE,
    Element,
    Pattern,
    SurfaceLight,
    element_at,
    element_place,
    element_weight,
    place_on_element,
    plane_places,
)
from lightopt.optics import (
    EVERYWHERE,
    NARROW_CHORD_SQUARED,
    DiffuseForm,
    Lobe,
    Reflectance,
    diffuse_term,
    exponential,
    farthest_exponent,
    fresnel_factor,
    gaussian_lobe,
    is_lambert,
    light_factor,
    lobe_at,
    narrow_gaussian,
    round_ggx,
    specular_divisor,
    specular_lobe,
    square_across,
)
from lightopt.rendering._panel_quadrature import (
    MAX_NODES,
    NODES,
    WEIGHTS,
    Exponent,
    Rectangle,
    exponent_at,
    half_vector_cone,
    least_in_box,
    lobe_window,
    node_count,
    peak,
    piece_of,
    ridge_nodes,
    smooth_nodes,
    smooth_nodes_within,
    tail_error,
    tail_nodes,
)
from lightopt.rendering._pattern_weights import pattern_weights, picture_weights
from lightopt.rendering._point_lights import facing_targets, round_lobes
from lightopt.rendering._surface import PointRows, SurfacePoint, SurfacePoints, point_at, surface_point

DIFFUSE_NODES = 3  # a side of an element
LEAST_NODES, MOST_NODES = 2, 48  # a side of the lobe's window
# exponents from which the light of an element is so little that fewer nodes do, and their number far from the lobe
FLANK, FAR, FAR_NODES = 4.5, 9.0, 2
MOST_PATTERN_NODES = 40
PIECES = 4  # along a side of an element of which some may be hidden
LEAST_LEVEL = 1e-3  # what the lobe of an element adds at most where it is left out [grey level]
FAINT_LEVEL, FAINT_NODES = 0.1, 2  # what an element adds at most where so few nodes a side do [grey level]
FAINT_AT_HORIZON = 0.4  # and where those of diffuse light do, although the horizon may cross it [grey level]
LEAST_TAIL_NODES, BENT = 4, 0.75
MANY_NODES = 6  # a side of elements all over which a lobe varies more
ELEMENT_ERROR = 0.005  # of what an element adds, which others add to [grey level]
FULL_ANGLE = 0.05  # solid angle of an element that it is for [sr]
MOST_R_S_SIGMA_2 = 1e3  # R_s·σ² of fits, where R_s is not known [grey level]
NEGLIGIBLE_LEVEL = 0.02  # elements whose highlight is less are not divided [grey level]
STEPS = 6  # Newton steps to where the lobe is brightest
# of the negligible exponent: where the quadratic form's least is more, so is the exponent, though an element may bend
# much between the place of the form and that of its least
FAR_OFF = 24.0
# the search for it ends where a step is less than this share of the element's sides, and the exponent so near its least
NEAR, NEAR_EXPONENT = 0.02, 0.5
MOST_ENDS, _RINGS, TAIL_GROWTH = 24, 11, 3.2  # of the pieces that a side is taken in for a lobe with tails
_CROSSING_STEPS, _CROSSING_NEAR = 20, 1e-9  # of the search for the horizon, and how near it is, as a share of a side
_SIDE_BY_SIDE = 512  # points whose numbers are in the processor's nearest cache together
_LEAST_AT_ONCE = 256
_Nodes = tuple[Float64, Float64, Float64]  # of an element: places, light and weights
AT_ONCE = 1 << 21  # surface points times elements times terms of patterns that are shaded at once


class _Sum(NamedTuple):
    # what an element, whose radiance has a pattern, gives to a surface point: for each term a sum that is added to
    at: SurfacePoint
    e: Element
    pattern: Pattern
    found: Float64


@kernel
def _nodes(e: Element, pattern: Pattern, count: int) -> _Nodes:
    places, light = np.empty((count**2, 3)), np.empty((count**2, 3))
    weights = np.empty((len(pattern.terms), count**2))
    _set_nodes(e, pattern, count, places, light, weights)
    return places, light, weights


@kernel
def _set_nodes(e: Element, pattern: Pattern, count: int, places: Float64, light: Float64, weights: Float64) -> None:
    du, dv = e.u1 - e.u0, e.v1 - e.v0
    for i in range(count):
        for j in range(count):
            k = i * count + j
            u, v = e.u0 + du * NODES[count, i], e.v0 + dv * NODES[count, j]
            q, along_u, along_v = element_place(e, u, v)
            shining = scaled(cross(along_u, along_v), du * dv * e.radiance * e.side)
            places[k, 0], places[k, 1], places[k, 2] = q
            light[k, 0], light[k, 1], light[k, 2] = shining
    for b in range(len(weights)):
        element_weights(e, pattern, b, weights[b].reshape(count, count))


@kernel
def element_weights(e: Element, pattern: Pattern, b: int, weights: Float64) -> None:
    """Set the weights of an element's nodes along u and v for a term of the pattern, shape (count_u, count_v)."""
    term, du, dv = pattern.terms[b], e.u1 - e.u0, e.v1 - e.v0
    if int(term[1]) == PICTURE:
        picture_weights(pattern, term, (e.u0, e.v0), (du, dv), weights)
        return
    weights_u, weights_v = np.empty(weights.shape[0]), np.empty(weights.shape[1])
    pattern_weights(term, 0, e.u0, du, len(weights_u), True, weights_u)
    pattern_weights(term, 1, e.v0, dv, len(weights_v), True, weights_v)
    for i in range(len(weights_u)):
        for j in range(len(weights_v)):
            weights[i, j] = weights_u[i] * weights_v[j]


@kernel
def diffuse_of_element(at: SurfacePoint, form: DiffuseForm, nodes: _Nodes, found: Float64) -> None:
    # light of an element per unit of R_d, for each term of the pattern: Σ weight · light · cosα · (N·L) / r²
    (places, light, weights), (p, n, v, _, _) = nodes, at
    found[:] = 0.0
    for k in range(len(places)):
        towards = minus(vector_at(places, k), p)
        r2 = dot(towards, towards)
        value = max(0.0, dot(n, towards)) * max(0.0, -dot(vector_at(light, k), towards)) / (r2 * r2)
        if not is_lambert(form) and value > 0.0:
            value *= _share_of_lambert(n, v, towards, form)
        for b in range(len(weights)):
            found[b] += weights[b, k] * value


@kernel
def _share_of_lambert(n: Vector, v: Vector, towards: Vector, form: DiffuseForm) -> float:
    # diffuse light of another form over that of Lambert's, above the horizon
    towards = scaled(towards, 1.0 / length(towards))
    n_dot_l = dot(n, towards)
    return diffuse_term(n_dot_l, dot(n, v), dot(towards, v), form) / n_dot_l


@kernel
def _even_nodes(low: float, high: float, count: int) -> Float64:
    at = np.empty(count)
    for i in range(count):
        at[i] = low + (high - low) * NODES[count, i]
    return at


@kernel
def _values_of_nodes(at: SurfacePoint, e: Element, at_s: Float64, at_t: Float64, lobe: Lobe) -> Float64:
    # lobe times radiance · cosα / r² · dA per ds dt of places of an element, shape (count_s, count_t); 0 below the
    # horizon. As in `whole_panel`, the processor works on several nodes at once
    p, n, v, _, _ = at
    count_s, count_t = len(at_s), len(at_t)
    values, work = np.empty((count_s, count_t)), np.zeros((7, count_t))
    chord, across, lit_across, n_dot_l, size = work[0], work[1], work[2], work[3], work[4]
    cosine, sine = work[5], work[6]
    for j in range(count_t):
        cosine[j] = 1.0
        if e.shape == SPHERE:
            cosine[j], sine[j] = math.cos(at_t[j]), math.sin(at_t[j])
    for i in range(count_s):
        s = at_s[i]
        of_s, row = (math.cos(s), math.sin(s)), values[i]
        for j in range(count_t):
            q, along_s, along_t = place_on_element(e, s, at_t[j], of_s, (cosine[j], sine[j]))
            towards = minus(q, p)
            distance = length(towards)
            half = plus(scaled(towards, 1.0 / distance), v)
            size[j], height = length(half), dot(n, towards)
            away = minus(n, scaled(half, 1.0 / size[j]))
            chord[j], n_dot_l[j] = dot(away, away), max(height, 0.0) / distance
            row[j] = element_weight(e, towards, along_s, along_t) if height > 0.0 else 0.0
            if lobe.widening > 1.0:
                across[j] = square_across(away, lobe)
                lit_across[j] = square_across(towards, lobe) / (distance * distance)
        widest = 0.0
        for j in range(count_t):
            widest = max(widest, chord[j])
        if widest < NARROW_CHORD_SQUARED and lobe.plain:
            for j in range(count_t):
                row[j] *= narrow_gaussian(chord[j], lobe.inverse)
        elif lobe.ggx and lobe.widening == 1.0:
            for j in range(count_t):
                row[j] *= round_ggx(chord[j], n_dot_l[j], lobe.inverse)
            for j in range(count_t if lobe.n > 0.0 else 0):
                row[j] *= fresnel_factor(size[j], lobe.n, lobe.k, lobe.normal_reflectance)
        else:
            for j in range(count_t):
                row[j] *= light_factor(n_dot_l[j], lit_across[j], size[j], lobe)
                row[j] *= specular_lobe(chord[j], across[j], lobe)
    return values


@kernel
def _height(at: SurfacePoint, e: Element, s: float, t: float) -> float:
    # of a place of an element above the plane through a point
    return dot(at.n, minus(element_place(e, s, t)[0], at.p))


@kernel
def _horizon_crosses(at: SurfacePoint, e: Element, area: Rectangle) -> bool:
    # whether the plane through a point passes between the corners of a part of an element
    if dot(at.n, minus(e.centre, at.p)) >= e.reach:
        return False
    first, second = _height(at, e, area.s0, area.t0), _height(at, e, area.s1, area.t0)
    third, fourth = _height(at, e, area.s0, area.t1), _height(at, e, area.s1, area.t1)
    return min(min(first, second), min(third, fourth)) < 0.0 < max(max(first, second), max(third, fourth))


@kernel
def _crossing(at: SurfacePoint, e: Element, start: tuple[float, float], end: tuple[float, float]) -> float:
    # how far along a line of (u, v) the horizon is met, as a share of it; −1 where both ends are on one side.
    # False position in the variant that halves the value of the end that stays
    low, high = 0.0, 1.0
    at_low, at_high = _height(at, e, start[0], start[1]), _height(at, e, end[0], end[1])
    if (at_low > 0.0) == (at_high > 0.0):
        return -1.0
    share, stayed = 0.0, 0
    for _ in range(_CROSSING_STEPS):
        share = (low * at_high - high * at_low) / (at_high - at_low)
        s, t = start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])
        value = _height(at, e, s, t)
        if (value > 0.0) == (at_low > 0.0):
            if abs(share - low) < _CROSSING_NEAR:
                break
            low, at_low = share, value
            if stayed == 1:
                at_high *= 0.5
            stayed = 1
        else:
            if abs(share - high) < _CROSSING_NEAR:
                break
            high, at_high = share, value
            if stayed == -1:
                at_low *= 0.5
            stayed = -1
    return share


@kernel
def _add_above_horizon(to: _Sum, area: Rectangle, counts: tuple[int, int], lobe: Lobe, share: float) -> None:
    # a share of the specular light of a part of an element that the horizon crosses, added for each term: rows of nodes
    # along v end at the horizon, and are taken apart along u where it meets the sides
    at, e, pattern, found = to
    terms = pattern.terms
    count_s, count_t = counts
    whole = share / _divisor(at, lobe)
    ends = np.array([area.s0, area.s0, area.s0, area.s1])
    for side in range(2):
        t = area.t1 if side else area.t0
        along = _crossing(at, e, (area.s0, t), (area.s1, t))
        if along > 0.0:
            ends[1 + side] = area.s0 + along * (area.s1 - area.s0)
    if ends[1] > ends[2]:
        ends[1], ends[2] = ends[2], ends[1]
    weights_s, weights_t = np.empty((len(terms), count_s)), np.empty(count_t)
    for piece in range(3):
        start, width = ends[piece], ends[piece + 1] - ends[piece]
        if width <= 0.0:
            continue
        for b in range(len(terms)):
            pattern_weights(terms[b], 0, start, width, count_s, False, weights_s[b])
        for i in range(count_s):
            s, low, high = start + width * NODES[count_s, i], area.t0, area.t1
            along = _crossing(at, e, (s, low), (s, high))
            if along >= 0.0:
                border = low + along * (high - low)
                if _height(at, e, s, low) > 0.0:
                    high = border
                else:
                    low = border
            elif _height(at, e, s, 0.5 * (low + high)) <= 0.0:
                continue
            values = _values_of_nodes(at, e, np.array([s]), _even_nodes(low, high, count_t), lobe)[0]
            factor = width * (high - low) * whole
            for b in range(len(terms)):
                pattern_weights(terms[b], 1, low, high - low, count_t, False, weights_t)
                found[b] += factor * weights_s[b, i] * np.dot(weights_t, values)


@kernel
def _divisor(at: SurfacePoint, lobe: Lobe) -> float:
    return specular_divisor(at.n_dot_v, square_across(at.v, lobe), lobe)


@kernel
def specular_of_element(
    at: SurfacePoint, e: Element, area: Rectangle, pattern: Pattern, lobe: Lobe, most: float, found: Float64
) -> None:
    """Add the specular light of a piece of an element per unit of R_s (paper, equation 3), for each pattern term.

    area: The piece, by u and v
    most: The lobe is negligible where it is less than e^−most of its height
    found: Shape (b,)
    """
    if at.n_dot_v <= 0.0:
        return
    to = _Sum(at, e, pattern, found)
    if lobe.plain:
        _add_gaussian(to, area, lobe, most, 1.0)
    elif lobe.ggx:
        _add_tailed(to, area, lobe, most)
    else:
        for number in range(lobe.wider + 1):
            share, one = gaussian_lobe(lobe, number)
            _add_gaussian(to, area, one, most + math.log(share), share)


@kernel
def _nearest(at: SurfacePoint, e: Element, area: Rectangle, lobe: Lobe, far: float) -> Exponent:
    # where on a piece of an element the lobe is greatest; with an infinite exponent where it is surely beyond `far`
    s, t = 0.5 * (area.s0 + area.s1), 0.5 * (area.t0 + area.t1)
    wide, high = area.s1 - area.s0, area.t1 - area.t0
    near = Exponent(s, t, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for _ in range(STEPS):
        q, along_s, along_t = element_place(e, s, t)
        near = exponent_at(at, s, t, q, along_s, along_t, lobe)
        _, _, a, b, c, gs, gt, least = near
        ns, nt = least_in_box(near, area)
        ds, dt = ns - s, nt - t
        there = least + 2.0 * (gs * ds + gt * dt) + a * ds * ds + 2.0 * b * ds * dt + c * dt * dt
        if there > far:
            return Exponent(s, t, a, b, c, gs, gt, np.inf)
        if max(abs(ds) / wide, abs(dt) / high) < NEAR and least - there < NEAR_EXPONENT:
            return near
        s, t = ns, nt
    return near


@kernel
def _add_gaussian(to: _Sum, area: Rectangle, lobe: Lobe, most: float, share: float) -> None:
    # adds a share of the light of one Gaussian lobe
    near = _nearest(to.at, to.e, area, lobe, FAR_OFF * (most + 1.0))
    s, t, a, _, c, gs, gt, least = near
    if least > most:
        return
    window = lobe_window(near, area)
    width, height = window.s1 - window.s0, window.t1 - window.t0
    if width <= 0.0 or height <= 0.0:
        return
    if lobe.widening > 1.0:
        _add_ridge(to, window, lobe, share)
        return
    count_s = node_count(a, gs, window.s0 - s, window.s1 - s)
    count_t = node_count(c, gt, window.t0 - t, window.t1 - t)
    # the lobe's flank adds little to its light, of which few nodes are good enough
    few = FAR_NODES if least > FAR else MOST_NODES
    if least > FLANK:
        count_s, count_t = count_s - 2, count_t - 2
    count_s, count_t = max(min(count_s, few), LEAST_NODES), max(min(count_t, few), LEAST_NODES)
    _add_window(to, window, (count_s, count_t), lobe, share)


@kernel
def _add_tailed(to: _Sum, area: Rectangle, lobe: Lobe, most: float) -> None:
    # adds the light of a lobe with tails. As on a panel, nodes are those of a rule in u, where a side is width · sinh u
    # from where it is greatest. Those of patterns take pieces that grow with the distance from there
    at, e, pattern, found = to
    s, t, a, b, c, gs, gt, least = _nearest(at, e, area, lobe, EVERYWHERE)
    if least > farthest_exponent(most, lobe):
        return
    # of its light, which is less than e^most times LEAST_LEVEL
    error = tail_error(least, ELEMENT_ERROR / LEAST_LEVEL * math.exp(-most) / FULL_ANGLE)
    if lobe.widening > 1.0:
        _add_ridge(to, area, lobe, 1.0)
        return
    centre_s, width_s = peak(a, gs, least, s, area.s0, area.s1)
    centre_t, width_t = peak(c, gt, least, t, area.t0, area.t1)
    if len(pattern.terms) == 1 and pattern.terms[0, 2] == 0.0:
        # singular in u at ±iπ/2, nearer where it leans across the sides, and where they are bent
        leaning = BENT * 0.5 * math.pi / (1.0 + 2.0 * abs(b) / math.sqrt(max(a * c, 1e-30)))
        # masking lets the light end at the horizon, not break off: more nodes are enough there
        crossed = _horizon_crosses(at, e, area)
        if not crossed and _height(at, e, 0.5 * (area.s0 + area.s1), 0.5 * (area.t0 + area.t1)) <= 0.0:
            return
        times = 2 if crossed else 1
        at_s, weights_s = _sinh_nodes(centre_s, width_s, area.s0, area.s1, leaning, error, times)
        at_t, weights_t = _sinh_nodes(centre_t, width_t, area.t0, area.t1, leaning, error, times)
        values = _values_of_nodes(at, e, at_s, at_t, lobe)
        total = 0.0
        for i in range(len(at_s)):
            total += weights_s[i] * np.dot(weights_t, values[i])
        found[0] += total / _divisor(at, lobe)
        return
    ends_s, ends_t = np.empty(MOST_ENDS), np.empty(MOST_ENDS)
    count_s = _set_ends(centre_s, width_s, area.s0, area.s1, ends_s)
    count_t = _set_ends(centre_t, width_t, area.t0, area.t1, ends_t)
    for i in range(count_s):
        nodes_s = tail_nodes(ends_s[i] - centre_s, ends_s[i + 1] - centre_s, width_s, error)
        for j in range(count_t):
            nodes_t = tail_nodes(ends_t[j] - centre_t, ends_t[j + 1] - centre_t, width_t, error)
            window = Rectangle(ends_s[i], ends_s[i + 1], ends_t[j], ends_t[j + 1])
            _add_window(to, window, (nodes_s, nodes_t), lobe, 1.0)


@kernel
def _add_ridge(to: _Sum, window: Rectangle, lobe: Lobe, share: float) -> None:
    # adds a share of the light of a lobe that is wider across the brushing, a ridge that may lie aslant. Along the
    # angle of a disc it is as narrow as where it is farthest out
    along_s = along_t = 0.0
    for corner in range(4):
        s, t = window.s1 if corner % 2 else window.s0, window.t1 if corner // 2 else window.t0
        q, of_s, of_t = element_place(to.e, s, t)
        there = exponent_at(to.at, s, t, q, of_s, of_t, lobe)
        along_s, along_t = max(along_s, there.a), max(along_t, there.c)
    parts_s, count_s = ridge_nodes(window.s1 - window.s0, along_s, lobe.ggx)
    parts_t, count_t = ridge_nodes(window.t1 - window.t0, along_t, lobe.ggx)
    for k in range(parts_s * parts_t):
        piece = piece_of(window, k, parts_s, parts_t)
        _add_window(to, piece, (count_s, count_t), lobe, share)


@kernel
def _sinh_nodes(
    centre: float, width: float, low: float, high: float, singular: float, error: float, times: int
) -> tuple[Float64, Float64]:
    # places along a side and their weights
    u0, u1 = math.asinh((low - centre) / width), math.asinh((high - centre) / width)
    count = min(max(LEAST_TAIL_NODES, times * tail_nodes(u0, u1, singular, error)), MAX_NODES)
    at, weights, half = np.empty(count), np.empty(count), 0.5 * width
    for i in range(count):
        up = exponential(u0 + (u1 - u0) * NODES[count, i])
        down = 1.0 / up
        at[i], weights[i] = centre + half * (up - down), WEIGHTS[count, i] * (u1 - u0) * half * (up + down)
    return at, weights


@kernel
def _set_ends(centre: float, width: float, low: float, high: float, ends: Float64) -> int:
    # where the pieces of a side end, in order; returns how many pieces there are
    ends[0], count = low, 0
    for number in range(-_RINGS, _RINGS + 1):
        if number == 0:
            continue
        away = width * TAIL_GROWTH ** (abs(number) - 1)
        end = centre - away if number < 0 else centre + away
        if ends[count] < end < high:
            count += 1
            ends[count] = end
    ends[count + 1] = high
    return count + 1


@kernel
def _add_window(to: _Sum, window: Rectangle, counts: tuple[int, int], lobe: Lobe, share: float) -> None:
    # adds a share of the light of a part of an element by so many nodes, and more where the pattern needs them
    at, e, pattern, found = to
    count_s, count_t = counts
    terms, width, height, pictures = pattern.terms, window.s1 - window.s0, window.t1 - window.t0, 0
    for b in range(len(terms)):
        wave, of_v, edged = terms[b, 2], int(terms[b, 1]) == 1, terms[b, 4] > 0.0
        if wave == 0.0:
            continue
        if int(terms[b, 1]) == PICTURE:
            pictures += 1
            continue
        # the polynomial through the nodes follows the light between edges; else the nodes follow the stripes
        count, side = (count_t, height) if of_v else (count_s, width)
        least_count = 2 * count if edged else math.ceil(3.0 + 0.6 * wave * side)
        count = max(count, min(MOST_PATTERN_NODES, least_count))
        if of_v:
            count_t = count
        else:
            count_s = count
    if pictures > 0:
        count_s, count_t = min(MOST_PATTERN_NODES, 2 * count_s), min(MOST_PATTERN_NODES, 2 * count_t)
    elif _horizon_crosses(at, e, window):
        _add_above_horizon(to, window, (count_s, count_t), lobe, share)
        return
    factor = share * (width * height / _divisor(at, lobe))
    at_s, at_t = _even_nodes(window.s0, window.s1, count_s), _even_nodes(window.t0, window.t1, count_t)
    values = _values_of_nodes(at, e, at_s, at_t, lobe)
    if len(terms) == 1 and terms[0, 2] == 0.0:
        for i in range(count_s):
            total = 0.0
            for j in range(count_t):
                total += WEIGHTS[count_t, j] * values[i, j]
            found[0] += factor * WEIGHTS[count_s, i] * total
        return
    weights_s, weights_t = np.empty((len(terms), count_s)), np.empty((len(terms) + 1, count_t))
    # sums along v, of which terms of u have one in common, the first
    row_of, rows = np.zeros(len(terms), np.int64), 1
    for j in range(count_t):  # loops: numba takes seconds to compile assignments of arrays
        weights_t[0, j] = WEIGHTS[count_t, j]
    of_picture, number = np.empty((pictures, count_s, count_t)), 0
    for b in range(len(terms)):
        if int(terms[b, 1]) == PICTURE:
            picture_weights(pattern, terms[b], (window.s0, window.t0), (width, height), of_picture[number])
            row_of[b], number = number, number + 1
            continue
        pattern_weights(terms[b], 0, window.s0, width, count_s, False, weights_s[b])
        if terms[b, 2] != 0.0 and int(terms[b, 1]) == 1:
            pattern_weights(terms[b], 1, window.t0, height, count_t, False, weights_t[rows])
            row_of[b] = rows
            rows += 1
    row, sums = np.empty(rows), np.zeros(pictures)
    for i in range(count_s):
        for k in range(rows):
            row[k] = 0.0
        for j in range(count_t):
            for k in range(rows):
                row[k] += weights_t[k, j] * values[i, j]
            for k in range(pictures):
                sums[k] += of_picture[k, i, j] * values[i, j]
        for b in range(len(terms)):
            if int(terms[b, 1]) != PICTURE:
                found[b] += factor * weights_s[b, i] * row[row_of[b]]
    for b in range(len(terms)):
        if int(terms[b, 1]) == PICTURE:
            found[b] += factor * sums[row_of[b]]


@kernel
def whole_element(e: Element) -> Rectangle:
    return Rectangle(e.u0, e.u1, e.v0, e.v1)


@kernel
def element_piece(e: Element, number: int) -> Rectangle:
    i, j = number // PIECES, number % PIECES
    du, dv = (e.u1 - e.u0) / PIECES, (e.v1 - e.v0) / PIECES
    return Rectangle(e.u0 + i * du, e.u0 + (i + 1) * du, e.v0 + j * dv, e.v0 + (j + 1) * dv)


@kernel
def _of_views(rows: PointRows, most: float, lobe: Lobe) -> tuple[Float64, Float64]:
    # what the specular light of each point is divided by for its view, and where less than e to the power of minus how
    # much of a lobe is negligible: `most` where that is 1; −1 where there is no specular light
    points, frames, views, _, _ = rows
    divisors, limits = np.ones(len(frames)), np.full(len(frames), -1.0)
    for i in range(len(frames)):
        at = point_at(points, frames, views, i)
        if at.n_dot_v > 0.0 and most >= 0.0:
            divisors[i] = _divisor(at, lobe_at(lobe, frames, i))
            limits[i] = max(0.0, most - math.log(divisors[i]))
    return divisors, limits


@kernel
def all_diffuse_nodes(elements: Float64, pattern: Pattern) -> tuple[Float64, Float64, Float64]:
    """Places of the nodes of each element [mm], their light and their weights: shapes (e, k, 3), (e, k, 3), (e, b, k).

    Light is radiance · area · unit vector of where they shine, and weights are those of the pattern's terms.
    """
    count = DIFFUSE_NODES**2
    places, light = np.empty((len(elements), count, 3)), np.empty((len(elements), count, 3))
    weights = np.empty((len(elements), len(pattern.terms), count))
    for m in range(len(elements)):
        _set_nodes(element_at(elements, m), pattern, DIFFUSE_NODES, places[m], light[m], weights[m])
    return places, light, weights


@kernel
def _add_elements(
    rows: PointRows,
    elements: Float64,
    pattern: Pattern,
    group: Index,
    clear: Bool,
    form: DiffuseForm,
    lobe: Lobe,
    most: float,
    diffuse: Float64,
    specular: Float64,
) -> None:
    # diffuse light of the clear elements of each group and term per unit of R_d, shape (groups, b, k), and specular
    # light of each element and term per unit of R_s, whatever hides it, shape (e, b, k). The processor works on several
    # points at once in loops without branches over numbers that lie side by side
    points, frames, views, _, _ = rows
    terms = len(pattern.terms)
    found, (divisors, limits) = np.empty(terms), _of_views(rows, most, lobe)
    places, light, weights = all_diffuse_nodes(elements, pattern)
    striped = not (terms == 1 and pattern.terms[0, 2] == 0.0)
    p, n, v = np.empty((3, _SIDE_BY_SIDE)), np.empty((3, _SIDE_BY_SIDE)), np.empty((3, _SIDE_BY_SIDE))
    value, near = np.empty(_SIDE_BY_SIDE), np.empty(_SIDE_BY_SIDE, np.bool_)
    limit, farthest, greatest = np.empty(_SIDE_BY_SIDE), np.empty(_SIDE_BY_SIDE), np.empty(_SIDE_BY_SIDE)
    work, cones = np.empty((14, _SIDE_BY_SIDE)), np.empty((4, _SIDE_BY_SIDE))
    chord, spread, height, distance2 = cones[0], cones[1], cones[2], cones[3]
    for first in range(0, len(points), _SIDE_BY_SIDE):
        count = min(_SIDE_BY_SIDE, len(points) - first)
        for j in range(count):
            for axis in range(3):
                p[axis, j], n[axis, j] = points[first + j, axis], frames[first + j, axis]
                v[axis, j] = views[first + j, axis]
            limit[j] = limits[first + j]
            farthest[j] = farthest_exponent(limit[j], lobe)
            # level of a lobe of height 1, in which all is bright
            greatest[j] = LEAST_LEVEL * math.exp(max(limit[j], 0.0)) / lobe.normal_reflectance
        for m in range(len(elements)):
            e, own = element_at(elements, m), clear[m, first : first + count]
            if own.any():
                for k in range(DIFFUSE_NODES**2):
                    q, shining = vector_at(places[m], k), vector_at(light[m], k)
                    for j in range(count):
                        towards = minus(q, column_at(p, j))
                        r2 = dot(towards, towards)
                        facing = max(0.0, dot(column_at(n, j), towards)) * max(0.0, -dot(shining, towards))
                        value[j] = facing / (r2 * r2)
                    if not is_lambert(form):
                        for j in range(count):
                            if value[j] > 0.0:
                                towards = minus(q, column_at(p, j))
                                value[j] *= _share_of_lambert(column_at(n, j), column_at(v, j), towards, form)
                    for b in range(terms):
                        to = diffuse[group[m], b, first : first + count]
                        for j in range(count):
                            to[j] += weights[m, b, k] * value[j] if own[j] else 0.0
            for j in range(count):
                at = surface_point(column_at(p, j), column_at(n, j), column_at(v, j))
                half, spread[j] = half_vector_cone(at, e.centre, e.reach)
                towards = minus(e.centre, at.p)
                chord[j], height[j], distance2[j] = length(minus(at.n, half)), dot(at.n, towards), dot(towards, towards)
                # whether the lobe may not be negligible on the element: a quick test
                nearest = max(0.0, chord[j] - spread[j])
                reached = (spread[j] >= math.pi) | (nearest * nearest * lobe.inverse <= farthest[j])
                near[j] = (height[j] > -e.reach) & reached
            if not lobe.plain:
                nodes = places[m], light[m], weights[m]
                few = nodes if striped else _nodes(e, pattern, FAINT_NODES)
                many = nodes if striped else _nodes(e, pattern, MANY_NODES)
                own_specular = specular[m, :, first:]
                columns, rules, numbers = (p, n, v), (few, nodes, many), (cones, work)
                some, of_lobe = near[:count], (limit, greatest, divisors[first:])
                _add_smooth(columns, frames[first:], some, e, rules, lobe, of_lobe, numbers, own_specular)
            for j in range(count):
                if near[j]:
                    i = first + j
                    for b in range(terms):
                        found[b] = 0.0
                    at, turned = (
                        surface_point(column_at(p, j), column_at(n, j), column_at(v, j)),
                        lobe_at(lobe, frames, i),
                    )
                    specular_of_element(at, e, whole_element(e), pattern, turned, limit[j], found)
                    for b in range(terms):
                        specular[m, b, i] = found[b]


@kernel
def _add_smooth(
    columns: tuple[Float64, Float64, Float64],
    frames: Float64,
    near: Bool,
    e: Element,
    rules: tuple[_Nodes, _Nodes, _Nodes],
    lobe: Lobe,
    of_lobe: tuple[Float64, Float64, Float64],
    numbers: tuple[Float64, Float64],
    specular: Float64,
) -> None:
    # where the lobe is smooth all over an element, which is above the horizon: sets the light of these points from the
    # nodes of diffuse light, and they are no longer `near`. Where the element adds hardly anything, few nodes do.
    # numbers: of the cone of half vectors of each point, and of the work
    (p, n, v), (few, nodes, many), (limit, greatest, divisors), (cones, work) = columns, rules, of_lobe, numbers
    rule = np.zeros(len(near), np.int64)
    striped = len(many[0]) == len(nodes[0])
    for j in range(len(near)):
        if not near[j] or limit[j] < 0.0:
            continue
        chord, spread, height, distance2 = cones[0, j], cones[1, j], cones[2, j], cones[3, j]
        nearest = max(0.0, chord - spread) if spread < math.pi else 0.0
        angle = min(math.pi * e.reach**2 / distance2, math.pi)
        level = greatest[j] * specular_lobe(nearest * nearest / lobe.widening, 0.0, lobe) * angle
        if level < FAINT_LEVEL:
            rule[j] = FAINT_NODES
        elif lobe.ggx and level < FAINT_AT_HORIZON:
            # masking lets its light end at the horizon, not break off
            rule[j] = DIFFUSE_NODES
        elif height >= e.reach:
            error = min(ELEMENT_ERROR / level, 0.1)
            if lobe.widening > 1.0:
                at = surface_point(column_at(p, j), column_at(n, j), column_at(v, j))
                wanted = smooth_nodes(at, e.centre, e.reach, lobe_at(lobe, frames, j), error, limit[j])
            else:
                wanted = smooth_nodes_within(chord, spread, lobe, error, limit[j])
            if wanted <= DIFFUSE_NODES + (not striped):
                rule[j] = DIFFUSE_NODES
            elif wanted <= MANY_NODES + 1 and not striped:
                rule[j] = MANY_NODES
    _add_nodes(columns, frames, rule == FAINT_NODES, few, lobe, work, divisors, specular)
    _add_nodes(columns, frames, rule == DIFFUSE_NODES, nodes, lobe, work, divisors, specular)
    _add_nodes(columns, frames, rule == MANY_NODES, many, lobe, work, divisors, specular)
    for j in range(len(near)):
        near[j] &= rule[j] == 0


@kernel
def _light_of_node(at: SurfacePoint, q: Vector, shining: Vector, lobe: Lobe) -> float:
    towards = minus(q, at.p)
    r2 = dot(towards, towards)
    r = math.sqrt(r2)
    half = plus(scaled(towards, 1.0 / r), at.v)
    size = math.sqrt(dot(half, half))
    chord = minus(at.n, scaled(half, 1.0 / size))
    height = dot(at.n, towards)
    factor = light_factor(max(height, 0.0) / r, square_across(towards, lobe) / r2, size, lobe)
    height_of_lobe = specular_lobe(dot(chord, chord), square_across(chord, lobe), lobe)
    value = height_of_lobe * factor * max(0.0, -dot(shining, towards)) / (r2 * r)
    return value if height > 0.0 else 0.0


@kernel
def _set_light_of_node(work: Float64, number: int, q: Vector, shining: Vector, lobe: Lobe) -> None:
    # the same of points side by side, for lobes that are alike all round
    for i in range(number):
        towards, normal = minus(q, column_at(work, i)), column_at(work, i, 3)
        r2 = dot(towards, towards)
        r = math.sqrt(r2)
        half = plus(scaled(towards, 1.0 / r), column_at(work, i, 6))
        size = math.sqrt(dot(half, half))
        chord = minus(normal, scaled(half, 1.0 / size))
        work[10, i], work[11, i] = dot(chord, chord), size
        n_dot_l = max(0.0, dot(normal, towards)) / r
        work[12, i] = n_dot_l
        work[13, i] = max(0.0, -dot(shining, towards)) / (r2 * r) if n_dot_l > 0.0 else 0.0
    round_lobes(work[9], work[10], work[12], work[11], number, lobe)
    for i in range(number):
        work[9, i] *= work[13, i]


@kernel
def _add_nodes(
    columns: tuple[Float64, Float64, Float64],
    frames: Float64,
    chosen: Bool,
    nodes: _Nodes,
    lobe: Lobe,
    work: Float64,
    divisors: Float64,
    specular: Float64,
) -> None:
    # adds the light of the nodes of an element that are above the horizon to the chosen points, which lie side by side
    # in `work` then, so that the processor works on several at once
    (p, n, v), (places, light, weights) = columns, nodes
    index, number = np.empty(len(chosen), np.int64), 0
    for j in range(len(chosen)):
        if chosen[j]:
            index[number] = j
            for axis in range(3):
                work[axis, number], work[3 + axis, number] = p[axis, j], n[axis, j]
                work[6 + axis, number] = v[axis, j]
            number += 1
    for k in range(len(places) if number else 0):
        q, shining = vector_at(places, k), vector_at(light, k)
        if lobe.widening > 1.0:
            for i in range(number):
                turned = lobe_at(lobe, frames, index[i])
                at = surface_point(column_at(work, i), column_at(work, i, 3), column_at(work, i, 6))
                work[9, i] = _light_of_node(at, q, shining, turned)
        else:
            _set_light_of_node(work, number, q, shining, lobe)
        for b in range(len(weights)):
            for i in range(number):
                specular[b, index[i]] += weights[b, k] * work[9, i]
    for i in range(number):
        for b in range(len(weights)):
            specular[b, index[i]] /= divisors[index[i]]


@kernel
def _add_channels(specular: Float64, shares: Float64, levels: Float64) -> None:
    # specular light of each channel, shape (channels, k)
    for m in range(len(specular)):
        for c in range(len(shares)):
            for b in range(specular.shape[1]):
                if shares[c, m, b] != 0.0:
                    for i in range(specular.shape[2]):
                        levels[c, i] += shares[c, m, b] * specular[m, b, i]


@kernel
def _piece_targets(elements: Float64) -> Float64:
    targets = np.empty((len(elements) * PIECES * PIECES, 3))
    for m in range(len(elements)):
        e = element_at(elements, m)
        for k in range(PIECES * PIECES):
            area = element_piece(e, k)
            # no two pieces in line, so that an edge along a side is met at PIECES² places, not at PIECES
            s, t = (k % PIECES + 0.5) / PIECES, (k // PIECES + 0.5) / PIECES
            q, _, _ = element_place(e, area.s0 + s * (area.s1 - area.s0), area.t0 + t * (area.t1 - area.t0))
            row = m * PIECES * PIECES + k
            targets[row, 0], targets[row, 1], targets[row, 2] = q
    return targets


@kernel
def _replace_by_pieces(
    rows: PointRows,
    elements: Float64,
    pattern: Pattern,
    pairs: tuple[Index, Index],
    free: Bool,
    lobe: Lobe,
    most: float,
    specular: Float64,
) -> None:
    (points, frames, views, _, _), (element, point) = rows, pairs
    found, (_, limits) = np.empty(len(pattern.terms)), _of_views(rows, most, lobe)
    for k in range(len(point)):
        i, m = point[k], element[k]
        at, e, turned = point_at(points, frames, views, i), element_at(elements, m), lobe_at(lobe, frames, i)
        for b in range(len(found)):
            found[b] = 0.0
        for number in range(PIECES * PIECES):
            if free[k, number]:
                specular_of_element(at, e, element_piece(e, number), pattern, turned, limits[i], found)
        for b in range(len(found)):
            specular[m, b, i] = found[b]


@dataclass(frozen=True)
class Channels:
    """Channels of one light: the surface that they have in common, and what each makes of it."""

    elements: Float64  # of all channels, of radiance 1, shape (e, ELEMENT_NUMBERS)
    pattern: Pattern  # the terms of all patterns, of coefficient 1
    shares: Float64  # radiance times coefficient of each channel, element and term, shape (channels, e, b)
    group: Index  # of each element, of those that are alike in every channel, shape (e,)
    group_shares: Float64  # the shares of the groups, shape (channels, groups, b)


def channels_of(lights: Sequence[SurfaceLight]) -> Channels:
    """What channels of a light have in common, and what each makes of it."""
    shapes = [np.delete(light.elements, RADIANCE, axis=1) for light in lights]
    elements, element = _different(shapes, np.concatenate([light.elements for light in lights]))
    rows = [light.pattern.terms for light in lights]
    terms, term = _different([some[:, 1:] for some in rows], np.concatenate(rows))
    elements[:, RADIANCE], terms[:, 0] = 1.0, 1.0
    shares = np.zeros((len(lights), len(elements), len(terms)))
    for share, light, m, b in zip(shares, lights, element, term, strict=True):
        share[np.ix_(m, b)] = light.elements[:, RADIANCE, None] * light.pattern.terms[:, 0]
    alike, group = np.unique(shares.swapaxes(0, 1), axis=0, return_inverse=True)
    pattern, group_shares = lights[0].pattern._replace(terms=terms), np.ascontiguousarray(alike.swapaxes(0, 1))
    return Channels(elements, pattern, shares, group.ravel().astype(np.intp), group_shares)


def _different(rows: Sequence[Float64], all_rows: Float64) -> tuple[Float64, list[Index]]:
    # one of `all_rows` for each of the different rows, and their numbers
    joined = np.round(np.concatenate(rows), 9) + 0.0  # no negative zeros
    _, first, number = np.unique(joined, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as in the lights
    place = np.empty(len(order), np.intp)
    place[order] = np.arange(len(order))
    ends = np.cumsum([len(some) for some in rows])[:-1]
    return all_rows[first[order]], np.split(place[number.ravel()], ends)


def points_at_once(points: int, threads: int) -> int:
    """How many surface points a thread works on, so that all threads are busy to the end."""
    return max(_LEAST_AT_ONCE, -(-points // (4 * threads)))


def shade_surface_lights(
    surface: SurfacePoints,
    lights: Sequence[SurfaceLight],
    *,
    reflectance: Reflectance,
    caster: RayCaster | None,
    threads: int = 1,
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of the channels of a light, per unit of R_d and R_s; two arrays, shape (channels, k).

    lights: The channels, part frame, of the same gain
    reflectance: Its σ shapes the lobe; R_s decides which shadows in highlights are worked out. Where R_d or R_s is 0,
        that light is left out, and 0
    caster: For shadows; None for none
    """
    channels, weight = channels_of(lights), lights[0].total_weight
    most = max(1, AT_ONCE // (len(channels.elements) * len(channels.pattern.terms)))
    step = min(most, points_at_once(len(surface), threads))

    def chunk(start: int) -> Float64:
        return _shade_chunk(surface.take(slice(start, start + step)), channels, weight, reflectance, caster)

    # no point at all is a chunk, too
    found = np.concatenate(in_threads(chunk, range(0, max(1, len(surface)), step), threads), axis=2)
    return found[0], found[1]


def _shade_chunk(
    surface: SurfacePoints, channels: Channels, weight: float, reflectance: Reflectance, caster: RayCaster | None
) -> Float64:
    # diffuse and specular light, shape (2, channels, k)
    end_if_stopped()
    elements, pattern, shares = channels.elements, channels.pattern, channels.shares
    lobe = reflectance.lobe
    # where the lobe's exponent is more, an element adds nothing to a level
    greatest = weight * reflectance.R_s / LEAST_LEVEL
    most = math.log(max(greatest, 1.0)) if greatest > 0.0 else -1.0
    clear, hidden = elements_seen(surface, elements, caster)
    size = len(surface)
    diffuse = np.zeros((channels.group_shares.shape[1], len(pattern.terms), size))
    specular = np.zeros((len(elements), len(pattern.terms), size))
    diffusing = clear if reflectance.R_d > 0.0 else np.zeros_like(clear)
    form, rows = reflectance.diffuse, surface.rows
    _add_elements(rows, elements, pattern, channels.group, diffusing, form, lobe, most, diffuse, specular)
    specular[..., ~surface.front] = 0.0
    if caster is not None and hidden.any():
        # in the channel where they are brightest
        largest = np.abs(shares).max(axis=0)
        level = np.einsum("mb,mbi->mi", largest, np.abs(specular)) * (weight * reflectance.R_s)
        element, point = map(np.ascontiguousarray, np.nonzero((level > NEGLIGIBLE_LEVEL) & hidden.any(axis=0)))
        free = free_pieces(surface, elements, caster, element, point)
        clear[element, point] = free.any(axis=1)
        specular *= clear[:, None]
        partly = clear[element, point] & ~free.all(axis=1)
        _replace_by_pieces(
            rows, elements, pattern, (element[partly], point[partly]), free[partly], lobe, most, specular
        )
    levels = np.zeros((2, len(shares), size))
    _add_channels(diffuse, channels.group_shares, levels[0])
    _add_channels(specular, shares, levels[1])
    return weight * levels


def elements_seen(surface: SurfacePoints, elements: Float64, caster: RayCaster | None) -> tuple[Bool, Bool]:
    # whether nothing is on the way to the middle of each element, and whether the part is, shape (e, k). What is below
    # a point's own horizon is no light of this element's nodes
    targets = np.ascontiguousarray(elements[:, 22:25])
    if caster is None:
        return np.repeat(surface.front[None], len(targets), axis=0), np.zeros((len(targets), len(surface)), np.bool_)
    facing = facing_targets(surface, targets, geometric=True)
    seen = caster.visible(surface.points, surface.facets, targets, candidates=facing, outside=surface.outside)
    hidden = facing & ~seen
    return surface.front & ~hidden, hidden


def free_pieces(surface: SurfacePoints, elements: Float64, caster: RayCaster, element: Index, point: Index) -> Bool:
    # which pieces of an element a point sees, shape (pairs, PIECES²)
    number = PIECES * PIECES
    targets = _piece_targets(elements)
    target_index = (element[:, None] * number + np.arange(number)).astype(np.int32).ravel()
    point_index = np.repeat(point.astype(np.int32), number)
    blocked = caster.occluded(
        surface.points, surface.facets, targets, point_index=point_index, target_index=target_index
    )
    return ~blocked.reshape(-1, number)


def light_of_channels(
    surface: SurfacePoints,
    lights: Sequence[SurfaceLight],
    reflectance: Reflectance | DiffuseForm,
    *,
    diffuse: bool = True,
    caster: RayCaster | None = None,
    threads: int | None = None,
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a surface light, per unit of R_d and R_s; two arrays, shape (channels, k).

    lights: The channels, of the same gain
    reflectance: With the lobe; a form for diffuse light alone
    diffuse: Whether diffuse light is wanted; it is 0 otherwise
    caster: Of the part that hides some of the light; None where the points see all of it
    """
    if isinstance(reflectance, DiffuseForm):
        reflectance = Reflectance(R_d=float(diffuse), R_s=0.0, sigma=1e-3, diffuse=reflectance)
    else:
        reflectance = replace(reflectance, R_d=float(diffuse), R_s=MOST_R_S_SIGMA_2 / reflectance.sigma**2)
    # light is per unit of R_s: only where it is negligible depends on R_s
    threads = threads or available_processors()
    return shade_surface_lights(surface, lights, reflectance=reflectance, caster=caster, threads=threads)


@kernel
def _deflections(rows: PointRows, elements: Float64, deflection: Float64) -> None:
    points, frames, views, _, _ = rows
    for i in range(len(points)):
        at = point_at(points, frames, views, i)
        for m in range(len(elements)):
            e = element_at(elements, m)
            half, spread = half_vector_cone(at, e.centre, e.reach)
            chord = length(minus(at.n, half))
            angle = 2.0 * math.asin(min(1.0, 0.5 * chord)) - spread
            deflection[i] = min(deflection[i], max(0.0, angle))


def least_deflection(surface: SurfacePoints, light: SurfaceLight) -> Float64:
    """About the least angle between each normal and the half vectors of a light [rad], shape (k,)."""
    deflection = np.full(len(surface), math.pi)
    _deflections(surface.rows, light.elements, deflection)
    return deflection


def mirrored_places(surface: SurfacePoints, light: SurfaceLight) -> tuple[Float64, Float64, Float64]:
    """Place on the plane of a light that each point mirrors, u and v, and how far away it is [mm], shape (k,) each.

    NaN where a point mirrors nothing of the plane; places beyond the light's edges are not left out.
    """
    cosine = np.einsum("ij,ij->i", surface.normals, surface.views)
    towards = 2.0 * cosine[:, None] * surface.normals - surface.views
    return plane_places(light, surface.points, towards)
