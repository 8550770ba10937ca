"""Levels of variants of a surface under the surface of a light.

All variants of a point take the same few Gauss–Legendre nodes of an element where these resolve the lobe; a narrow lobe
is integrated for each variant.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped, in_threads
from lightopt.core.vectors import Vector, column_at, cross, dot, length, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import (
    SPHERE,
    Element,
    Pattern,
    SurfaceLight,
    element_at,
    element_place,
    element_weight,
    place_on_element,
)
from lightopt.optics import (
    DiffuseForm,
    Lobe,
    farthest_exponent,
    is_lambert,
    light_factor,
    lobe_at,
    lobe_beside,
    lobe_of_width,
    rough_gaussian,
    specular_divisor,
    specular_lobe,
    square_across,
)
from lightopt.rendering._converged_variants import VariantNumbers, leaning
from lightopt.rendering._panel_quadrature import NODES, exponent_at, half_vector_cone
from lightopt.rendering._surface import PointRows, SurfacePoint, SurfacePoints, point_at, surface_point
from lightopt.rendering._surface_light import (
    AT_ONCE,
    LEAST_LEVEL,
    PIECES,
    all_diffuse_nodes,
    channels_of,
    diffuse_of_element,
    element_piece,
    element_weights,
    elements_seen,
    free_pieces,
    points_at_once,
    specular_of_element,
    whole_element,
)

NEGLIGIBLE_CHANGE = 0.05  # what all of a light adds at most where its lobes are left out [grey level]
MOST_SHARED = 12  # nodes a side of an element that all variants share
LEAST_SHARED = 3
WHOLE, HIDDEN = -1, -2  # what a point sees of an element, in place of a row of pieces
# of each element and point such a number, and of each row which pieces of the element are free, shape (rows, PIECES²)
_Seen = tuple[Int32, Bool]
# rows of the variants of a point: normal, N·V, 1/(2σ²), number, what specular light is divided by, and the vector that
# the lobe has across the brushing
_N_DOT_V, _INVERSE, _NUMBER, _DIVISOR, _ACROSS, _ROWS = 3, 4, 5, 6, 7, 10


@kernel
def _shared_count(width: float) -> int:
    # nodes a side that resolve a lobe, by the side's width in half vectors [σ]: to half a percent of a large light
    return max(LEAST_SHARED, math.ceil(1.5 + 0.6 * width))


@kernel
def _shared_counts(at: SurfacePoint, e: Element, lobe: Lobe) -> tuple[int, int]:
    u, v = 0.5 * (e.u0 + e.u1), 0.5 * (e.v0 + e.v1)
    q, along_u, along_v = element_place(e, u, v)
    middle = exponent_at(at, u, v, q, along_u, along_v, lobe)
    wide, high = math.sqrt(2.0 * middle.a) * (e.u1 - e.u0), math.sqrt(2.0 * middle.c) * (e.v1 - e.v0)
    return _shared_count(min(wide, 1e3)), _shared_count(min(high, 1e3))


@kernel
def _set_shared_nodes(
    at: SurfacePoint,
    e: Element,
    pattern: Pattern,
    counts: tuple[int, int],
    nodes: Float64,
    light: Float64,
    work: Float64,
) -> None:
    # half vector of each node and 2·H·V, shape (4, nodes), and its light for each term, shape (b, nodes); `work` is for
    # its own use, shape (2, nodes)
    du, dv, (count_u, count_v) = e.u1 - e.u0, e.v1 - e.v0, counts
    for j in range(count_v):
        v = e.v0 + dv * NODES[count_v, j]
        work[0, j], work[1, j] = (math.cos(v), math.sin(v)) if e.shape == SPHERE else (1.0, 0.0)
    for i in range(count_u):
        u = e.u0 + du * NODES[count_u, i]
        of_u = (math.cos(u), math.sin(u))
        for j in range(count_v):
            k, v = i * count_v + j, e.v0 + dv * NODES[count_v, j]
            q, along_u, along_v = place_on_element(e, u, v, of_u, (work[0, j], work[1, j]))
            towards = minus(q, at.p)
            half = plus(scaled(towards, 1.0 / length(towards)), at.v)
            half = scaled(half, 1.0 / length(half))
            nodes[0, k], nodes[1, k], nodes[2, k] = half
            nodes[3, k] = 2.0 * dot(half, at.v)
            value = du * dv * element_weight(e, towards, along_u, along_v)
            for b in range(len(light)):
                light[b, k] = value
    weights = work[1, : count_u * count_v]
    for b in range(len(light)):
        element_weights(e, pattern, b, weights.reshape(count_u, count_v))
        for k in range(len(weights)):
            light[b, k] *= weights[k]


@kernel
def _even_count(count: int) -> int:
    # Gauss–Legendre rules that give each of PIECES = 4 pieces of a side its share, to 3.5 and 6 %
    return 6 if count <= 6 else 12


@kernel
def _hide_nodes(counts: tuple[int, int], free: Bool, light: Float64) -> None:
    # takes the light of nodes in pieces that are hidden
    count_u, count_v = counts
    for i in range(count_u):
        first = int(NODES[count_u, i] * PIECES) * PIECES
        for j in range(count_v):
            if not free[first + int(NODES[count_v, j] * PIECES)]:
                light[:, i * count_v + j] = 0.0


@kernel
def _set_variants(at: SurfacePoint, r: Vector, own: Lobe, lean: Float64, inverse: Float64, turned: Float64) -> None:
    # of a point, by its reference direction r
    a = cross(at.n, r)
    for t in range(len(lean)):
        n = leaning(lean, t, at.n, r, a)
        lobe = lobe_beside(lobe_of_width(own, inverse[t]), n)
        turned[0, t], turned[1, t], turned[2, t] = n
        turned[_N_DOT_V, t], turned[_INVERSE, t], turned[_NUMBER, t] = dot(n, at.v), inverse[t], t
        turned[_DIVISOR, t] = specular_divisor(turned[_N_DOT_V, t], square_across(at.v, lobe), lobe)
        turned[_ACROSS, t], turned[_ACROSS + 1, t], turned[_ACROSS + 2, t] = lobe.across


@kernel
def _take_near(turned: Float64, reach: Float64, half: Vector, spread: float, flags: Bool, near: Float64) -> int:
    # the variants whose lobes may reach an element, side by side; returns how many they are
    for t in range(len(reach)):
        away, most = minus(column_at(turned, t), half), reach[t] + spread
        flags[t] = (turned[_N_DOT_V, t] > 0.0) & (dot(away, away) <= most * most)
    number = 0
    for t in range(len(reach)):
        near[_NUMBER, number] = t
        number += flags[t]
    for j in range(number):
        t = int(near[_NUMBER, j])
        for row in range(_NUMBER):
            near[row, j] = turned[row, t]
    return number


@kernel
def _lobe_of(own: Lobe, turned: Float64, near: Float64, j: int) -> Lobe:
    # of one of the variants
    lobe: Lobe = lobe_of_width(own, near[_INVERSE, j])
    if lobe.widening == 1.0:
        return lobe
    return Lobe(*lobe[:-1], column_at(turned, int(near[_NUMBER, j]), _ACROSS))


@kernel
def _set_specular(
    v: Vector,
    nodes: Float64,
    light: Float64,
    own: Lobe,
    turned: Float64,
    near: Float64,
    counts: tuple[int, int],
    values: Float64,
    found: Float64,
) -> None:
    # light of each term on variants, shape (b, variants), by so many nodes on so many variants; `values` is for its own
    # use. The processor works on several variants at once in loops without branches
    count, number = counts
    for b in range(len(found)):
        for j in range(number):
            found[b, j] = 0.0
    for k in range(count):
        half, twice = Vector(nodes[0, k], nodes[1, k], nodes[2, k]), nodes[3, k]
        if own.plain:
            _set_gaussian(half, twice, near, number, values)
        else:
            _set_lobe(v, half, twice, own, turned, near, number, values)
        for b in range(len(found)):
            for j in range(number):
                found[b, j] += light[b, k] * values[j]


@kernel
def _set_gaussian(half: Vector, twice: float, near: Float64, number: int, values: Float64) -> None:
    # of variants by one half vector H and 2·H·V
    for j in range(number):
        away = minus(column_at(near, j), half)
        chord = dot(away, away)
        # N·L = 2 (N·H)(H·V) − N·V, and N·H = 1 − chord²/2
        lit = (1.0 - 0.5 * chord) * twice > near[_N_DOT_V, j]
        values[j] = rough_gaussian(chord, near[_INVERSE, j]) if lit else 0.0


@kernel
def _set_lobe(
    v: Vector, half: Vector, twice: float, own: Lobe, turned: Float64, near: Float64, number: int, values: Float64
) -> None:
    towards = minus(scaled(half, twice), v)  # L = 2 (H·V) H − V
    for j in range(number):
        away, lobe = minus(column_at(near, j), half), _lobe_of(own, turned, near, j)
        chord = dot(away, away)
        n_dot_l = (1.0 - 0.5 * chord) * twice - near[_N_DOT_V, j]
        factor = light_factor(max(n_dot_l, 0.0), square_across(towards, lobe), twice, lobe)
        value = specular_lobe(chord, square_across(away, lobe), lobe) * factor
        values[j] = value if n_dot_l > 0.0 else 0.0


@kernel
def _add_diffuse(
    at: SurfacePoint,
    nodes: tuple[Float64, Float64, Float64],
    turned: Float64,
    R_d: Float64,
    steps: tuple[Float64, Index],
    vectors: Float64,
    sums: Float64,
) -> None:
    # Lambert's light of an element on variants, shape (b, t), which the steeper ones follow: it is linear in the normal
    # as long as a node is above the horizon. steps: how far the normals of variants of a slope are from the point's,
    # and the first variant of each. vectors: for each term the sum of what is linear for so many slopes and no more,
    # shape (b, slopes + 1, 3)
    (places, light, weights), (away, first) = nodes, steps
    for k in range(len(places)):
        towards = minus(vector_at(places, k), at.p)
        r2 = dot(towards, towards)
        arriving = scaled(towards, max(0.0, -dot(vector_at(light, k), towards)) / (r2 * r2))
        height, size = dot(at.n, arriving), length(arriving)
        # slopes of which all variants have the node above the horizon, or all below
        above = below = 0
        if away[-1] * size <= height:
            above = len(away)
        elif height >= 0.0:
            while above < len(away) and away[above] * size <= height:
                above += 1
        else:
            while below < len(away) and away[below] * size <= -height:
                below += 1
        start = first[max(above, below)]
        for b in range(len(weights)):
            own = scaled(arriving, weights[b, k])
            for axis in range(3 if above > 0 else 0):
                vectors[b, above, axis] += own[axis]
            if start < len(R_d):
                # of a row's slice the compiler knows that no index counts from the end: it takes several at once
                to, share = sums[b, start:], R_d[start:]
                x, y, z = turned[0, start:], turned[1, start:], turned[2, start:]
                for t in range(len(to)):
                    facing = arriving.x * x[t] + arriving.y * y[t] + arriving.z * z[t]
                    to[t] += share[t] * weights[b, k] * max(0.0, facing)


@kernel
def _add_other_diffuse(
    at: SurfacePoint,
    nodes: tuple[Float64, Float64, Float64],
    turned: Float64,
    R_d: Float64,
    form: DiffuseForm,
    found: Float64,
    sums: Float64,
) -> None:
    # of another form; `found` is for its own use
    for t in range(len(R_d)):
        diffuse_of_element(surface_point(at.p, column_at(turned, t), at.v), form, nodes, found)
        for b in range(len(found)):
            sums[b, t] += R_d[t] * found[b]


@kernel
def _slopes(lean: Float64) -> tuple[Float64, Index]:
    # how far the normals of the variants of each slope are from the point's, and the first variant of each, and the end
    away, first, count = np.empty(len(lean)), np.empty(len(lean) + 1, np.intp), 0
    for t in range(len(lean)):
        if t == 0 or lean[t, 0] != lean[t - 1, 0]:
            away[count], first[count] = length(minus(vector_at(lean, t), Vector(1.0, 0.0, 0.0))), t
            count += 1
    first[count] = len(lean)
    return away[:count], first[: count + 1]


@kernel
def _reaches(variants: VariantNumbers) -> Float64:
    # how far from the normal half vectors see something of the lobe of each variant (chord)
    reach = np.empty(len(variants.inverse))
    for t in range(len(reach)):
        inverse = variants.inverse[t]
        farthest = farthest_exponent(variants.most[t], lobe_of_width(variants.lobe, inverse))
        reach[t] = math.sqrt(max(0.0, farthest) / inverse)
    return reach


@kernel
def _in_reach(rows: PointRows, elements: Float64, hidden: Bool, variants: VariantNumbers) -> Bool:
    # of which hidden elements the lobe of some variant sees something, if all of them is not in the way
    points, frames, views, _, _ = rows
    widest, found = _reaches(variants).max() + _slopes(variants.lean)[0][-1], np.zeros(hidden.shape, np.bool_)
    for m in range(len(elements)):
        e = element_at(elements, m)
        for i in range(len(points)):
            if hidden[m, i]:
                at = point_at(points, frames, views, i)
                half, spread = half_vector_cone(at, e.centre, e.reach)
                found[m, i] = spread >= math.pi or length(minus(at.n, half)) - spread <= widest
    return found


@kernel
def _variant_sums(
    rows: PointRows,
    references: Float64,
    elements: Float64,
    pattern: Pattern,
    group: Index,
    seen: _Seen,
    variants: VariantNumbers,
    shares: Float64,
    levels: Float64,
) -> None:
    # levels of the variants of each point under each channel, shape (channels, t, k). The light of the elements of a
    # group is summed, of which a channel has `shares`, shape (channels, groups, b). Steeper variants follow. Of an
    # element that is not whole, lobes see the free pieces, and diffuse light nothing
    lean, R_d, R_s, inverse, most, form, diffuse = variants
    points, frames, views, _, _ = rows
    terms, groups, count, most_nodes = len(pattern.terms), shares.shape[1], len(lean), MOST_SHARED**2
    reach, (row_of, free) = _reaches(variants), seen
    away, first = _slopes(lean)
    farthest, linear, widest = away[-1], is_lambert(diffuse), reach.max()
    found, one, values = np.empty((terms, count)), np.empty(terms), np.empty(count)
    nodes, shared, work = np.empty((4, most_nodes)), np.empty((terms, most_nodes)), np.empty((2, most_nodes))
    vectors, sums = np.empty((groups, terms, len(away) + 1, 3)), np.empty((groups, terms, count))
    turned, near, flags = np.empty((_ROWS, count)), np.empty((_NUMBER + 1, count)), np.empty(count, np.bool_)
    places, light, weights = all_diffuse_nodes(elements, pattern)
    for i in range(len(points)):
        plain, own = point_at(points, frames, views, i), lobe_at(form, frames, i)
        _set_variants(plain, vector_at(references, i), own, lean, inverse, turned)
        vectors[:], sums[:] = 0.0, 0.0
        for m in range(len(elements)):
            row = row_of[m, i]
            if row == HIDDEN:
                continue
            e, g = element_at(elements, m), group[m]
            middle = minus(e.centre, plain.p)
            if dot(plain.n, middle) + farthest * length(middle) <= -e.reach:
                continue
            if row == WHOLE and linear:
                diffuse_nodes = places[m], light[m], weights[m]
                _add_diffuse(plain, diffuse_nodes, turned, R_d, (away, first), vectors[g], sums[g])
            elif row == WHOLE:
                _add_other_diffuse(plain, (places[m], light[m], weights[m]), turned, R_d, diffuse, one, sums[g])
            half, spread = half_vector_cone(plain, e.centre, e.reach)
            if spread < math.pi and length(minus(plain.n, half)) - spread - farthest > widest:
                continue
            number = _take_near(turned, reach, half, spread, flags, near)
            if number == 0:
                continue
            sharpest = 0.0
            for j in range(number):
                sharpest = max(sharpest, near[_INVERSE, j])
            counts = _shared_counts(plain, e, lobe_of_width(own, sharpest))
            if max(counts) <= MOST_SHARED:
                if row != WHOLE:
                    counts = _even_count(counts[0]), _even_count(counts[1])
                _set_shared_nodes(plain, e, pattern, counts, nodes, shared, work)
                if row != WHOLE:
                    _hide_nodes(counts, free[row], shared)
                of_all = counts[0] * counts[1], number
                _set_specular(plain.v, nodes, shared, own, turned, near, of_all, values, found)
                for j in range(number):
                    t = int(near[_NUMBER, j])
                    for b in range(terms):
                        sums[g, b, t] += R_s[t] / turned[_DIVISOR, t] * found[b, j]
                continue
            for j in range(number):
                t, at = int(near[_NUMBER, j]), surface_point(plain.p, column_at(near, j), plain.v)
                for b in range(terms):
                    one[b] = 0.0
                lobe = _lobe_of(own, turned, near, j)
                if row == WHOLE:
                    specular_of_element(at, e, whole_element(e), pattern, lobe, most[t], one)
                for k in range(0 if row == WHOLE else PIECES * PIECES):
                    if free[row, k]:
                        specular_of_element(at, e, element_piece(e, k), pattern, lobe, most[t], one)
                for b in range(terms):
                    sums[g, b, t] += R_s[t] * one[b]
        for g in range(groups):
            for b in range(terms):
                total = Vector(0.0, 0.0, 0.0)
                for s in range(len(away) - 1, -1, -1):
                    total = plus(total, vector_at(vectors[g, b], s + 1))
                    for t in range(first[s], first[s + 1]):
                        level = sums[g, b, t] + R_d[t] * dot(total, column_at(turned, t))
                        for c in range(len(shares)):
                            levels[c, t, i] += shares[c, g, b] * level


def _whole_lobes(variants: VariantNumbers, radiance: float) -> Float64:
    # light of all of a lobe at most, per unit of R_s, with that radiance all round, or 1; shape (t,)
    lobe = variants.lobe
    if lobe.ggx:
        return np.ones(len(variants.inverse))
    widest = min(lobe.inverse, *lobe.inverses) / lobe.inverse * variants.inverse
    return np.clip(radiance * 4.0 * math.pi * math.sqrt(lobe.widening) / widest, 1e-30, 1.0)


def _seen(surface: SurfacePoints, elements: Float64, variants: VariantNumbers, caster: RayCaster | None) -> _Seen:
    # as whole what nothing is in the way of the middle of; of others in reach of lobes, pieces
    shadowed = replace(surface, normals=surface.facets)
    clear, hidden = elements_seen(shadowed, elements, caster)
    row_of = np.where(clear, np.int32(WHOLE), np.int32(HIDDEN))
    if caster is None or not hidden.any():
        return row_of, np.zeros((0, PIECES * PIECES), np.bool_)
    element, point = map(np.ascontiguousarray, np.nonzero(_in_reach(surface.rows, elements, hidden, variants)))
    free = free_pieces(shadowed, elements, caster, element, point)
    some = free.any(axis=1)
    row_of[element[some], point[some]] = np.arange(int(some.sum()), dtype=np.int32)
    return row_of, np.ascontiguousarray(free[some])


def surface_light_variants(
    surface: SurfacePoints,
    references: Float64,
    lights: Sequence[SurfaceLight],
    variants: VariantNumbers,
    caster: RayCaster | None,
    threads: int,
) -> Float64:
    """Levels of variants of a surface under channels of a light, shape (channels, t, k).

    Elements are seen or hidden as wholes; lobes see the pieces of those whose middles are hidden.

    surface, references: As :func:`lightopt.rendering._surface_variants.shade_variants` takes them
    lights: The channels, of the same gain
    variants: With coefficients times the light's weight
    """
    channels = channels_of(lights)
    elements = channels.elements
    group, shares = channels.group, channels.group_shares
    # what is far below the noise does not count
    whole = _whole_lobes(variants, float(np.abs(shares).sum(axis=2).max()))
    order = np.argsort(-variants.lean[:, 0], kind="stable")
    variants = variants._replace(most=variants.most + np.log(whole * (LEAST_LEVEL / NEGLIGIBLE_CHANGE)))
    rows = {name: getattr(variants, name)[order] for name in ("lean", "R_d", "R_s", "inverse", "most")}
    ordered = variants._replace(**rows)
    levels = np.empty((len(lights), len(variants.lean), len(surface)))

    def chunk(start: int) -> None:
        end_if_stopped()
        part = slice(start, start + step)
        some = surface.take(part)
        own = np.zeros((len(lights), len(variants.lean), len(some)))
        seen = _seen(some, elements, ordered, caster)
        _variant_sums(some.rows, references[part], elements, channels.pattern, group, seen, ordered, shares, own)
        levels[:, order, part] = own

    step = min(max(1, AT_ONCE // len(elements)), points_at_once(len(surface), threads))
    in_threads(chunk, range(0, len(surface), step), threads)
    return levels
