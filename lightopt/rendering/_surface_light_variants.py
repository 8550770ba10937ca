"""Levels of variants of a surface under the surface of a light.

All variants of a point take the same few Gauss–Legendre nodes of an element where these resolve the lobe; a narrow lobe
is integrated for each variant.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped, in_threads
from lightopt.core.vectors import Vector, cross, divided, dot, length, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import Element, Pattern, SurfaceLight, element_at, element_place, element_weight
from lightopt.optics import (
    NARROW_CHORD_SQUARED,
    Lobe,
    farthest_exponent,
    is_lambert,
    light_factor,
    lobe_at,
    lobe_beside,
    lobe_of_width,
    narrow_gaussian,
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
    all_diffuse_nodes,
    channels_of,
    diffuse_of_element,
    element_weights,
    elements_seen,
    points_at_once,
    specular_of_element,
    whole_element,
)

NEGLIGIBLE_CHANGE = 0.05  # what the lobe of an element adds at most where it is left out [grey level]
MOST_SHARED = 12  # nodes a side of an element that all variants share
LEAST_SHARED = 3


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
    at: SurfacePoint, e: Element, pattern: Pattern, counts: tuple[int, int], nodes: Float64, light: Float64
) -> None:
    # half vector of each node and 2·H·V, shape (4, nodes), and its light for each term, shape (b, nodes)
    du, dv = e.u1 - e.u0, e.v1 - e.v0
    weights = np.empty(counts)
    for i in range(counts[0]):
        for j in range(counts[1]):
            k = i * counts[1] + j
            q, along_u, along_v = element_place(e, e.u0 + du * NODES[counts[0], i], e.v0 + dv * NODES[counts[1], j])
            towards = minus(q, at.p)
            half = plus(divided(towards, length(towards)), at.v)
            half = divided(half, length(half))
            nodes[0, k], nodes[1, k], nodes[2, k] = half
            nodes[3, k] = 2.0 * dot(half, at.v)
            light[:, k] = du * dv * element_weight(e, towards, along_u, along_v)
    for b in range(len(pattern.terms)):
        element_weights(e, pattern, b, weights)
        light[b, : weights.size] *= weights.ravel()


@kernel
def _specular_of_nodes(
    at: SurfacePoint,
    nodes: Float64,
    light: Float64,
    count: int,
    lobe: Lobe,
    narrow: bool,
    values: Float64,
    found: Float64,
) -> None:
    # adds to `found`; `narrow`: whether all half vectors are so near; `values` is for its own use. The processor works
    # on several nodes at once in loops without branches
    _, n, v, n_dot_v = at
    if narrow and lobe.plain:
        for k in range(count):
            x, y, z = n.x - nodes[0, k], n.y - nodes[1, k], n.z - nodes[2, k]
            chord = x * x + y * y + z * z
            # N·L = 2 (N·H)(H·V) − N·V, and N·H = 1 − chord²/2
            lit = (1.0 - 0.5 * chord) * nodes[3, k] > n_dot_v
            values[k] = narrow_gaussian(chord, lobe.inverse) if lit else 0.0
    else:
        for k in range(count):
            x, y, z = n.x - nodes[0, k], n.y - nodes[1, k], n.z - nodes[2, k]
            chord = x * x + y * y + z * z
            n_dot_l = (1.0 - 0.5 * chord) * nodes[3, k] - n_dot_v
            aside = square_across(Vector(x, y, z), lobe)
            # L = 2 (H·V) H − V
            half = scaled(Vector(nodes[0, k], nodes[1, k], nodes[2, k]), nodes[3, k])
            factor = light_factor(n_dot_l, square_across(minus(half, v), lobe), nodes[3, k], lobe)
            values[k] = specular_lobe(chord, aside, lobe) * factor if n_dot_l > 0.0 else 0.0
    factor = 1.0 / specular_divisor(n_dot_v, square_across(v, lobe), lobe)
    for b in range(len(light)):
        total = 0.0
        for k in range(count):
            total += light[b, k] * values[k]
        found[b] += factor * total


@kernel
def _set_vector_light(p: Vector, places: Float64, light: Float64, weights: Float64, whole: Float64) -> None:
    # Σ light · cosα · L / r² for each term, shape (b, 3): times N the diffuse light of an element above the horizon
    whole[:] = 0.0
    for k in range(len(places)):
        towards = minus(vector_at(places, k), p)
        r2 = dot(towards, towards)
        value = max(0.0, -dot(vector_at(light, k), towards)) / (r2 * r2)
        for b in range(len(weights)):
            whole[b, 0] += weights[b, k] * value * towards.x
            whole[b, 1] += weights[b, k] * value * towards.y
            whole[b, 2] += weights[b, k] * value * towards.z


@kernel
def _set_normals(n: Vector, r: Vector, lean: Float64, normals: Float64) -> float:
    # normals of the variants; returns how far a normal is from n, at most
    a, farthest = cross(n, r), 0.0
    for t in range(len(lean)):
        turned = leaning(lean, t, n, r, a)
        normals[t, 0], normals[t, 1], normals[t, 2] = turned
        farthest = max(farthest, length(minus(turned, n)))
    return farthest


@kernel
def _variant_sums(
    rows: PointRows,
    references: Float64,
    elements: Float64,
    pattern: Pattern,
    group: Index,
    clear: Bool,
    variants: VariantNumbers,
    shares: Float64,
    levels: Float64,
) -> None:
    # levels of the variants of each point under each channel, shape (channels, t, k). The light of the elements of a
    # group is summed, of which a channel has `shares`, shape (channels, groups, b)
    lean, R_d, R_s, inverse, most, form, diffuse = variants
    points, frames, views, _, _ = rows
    linear = is_lambert(diffuse)
    sharpest, reach = inverse.max(), 0.0
    ends = np.empty(len(inverse))
    for t in range(len(inverse)):
        ends[t] = farthest_exponent(most[t], lobe_of_width(form, inverse[t]))
        reach = max(reach, math.sqrt(ends[t] / inverse[t]))
    terms, groups, count = len(pattern.terms), shares.shape[1], len(lean)
    found, whole = np.empty(terms), np.empty((terms, 3))
    nodes, shared, values = np.empty((4, MOST_SHARED**2)), np.empty((terms, MOST_SHARED**2)), np.empty(MOST_SHARED**2)
    towards, sums = np.empty((groups, terms, 3)), np.empty((groups, count, terms))
    turned_normals = np.empty((count, 3))
    places, light, weights = all_diffuse_nodes(elements, pattern)
    for i in range(len(points)):
        plain, own = point_at(points, frames, views, i), lobe_at(form, frames, i)
        farthest = _set_normals(plain.n, vector_at(references, i), lean, turned_normals)
        towards[:], sums[:] = 0.0, 0.0
        for m in range(len(elements)):
            if not clear[m, i]:
                continue
            e, g = element_at(elements, m), group[m]
            middle = minus(e.centre, plain.p)
            height, turn = dot(plain.n, middle), farthest * length(middle)
            if height + turn <= -e.reach:
                continue
            above = linear and height - turn >= e.reach
            if linear:
                _set_vector_light(plain.p, places[m], light[m], weights[m], whole)
            if above:
                # Lambert's light is linear in the normal
                towards[g] += whole
            half, spread = half_vector_cone(plain, e.centre, e.reach)
            far = spread < math.pi and length(minus(plain.n, half)) - spread - farthest > reach
            if above and far:
                continue
            counts = 0, 0
            for t in range(count):
                at = surface_point(plain.p, vector_at(turned_normals, t), plain.v)
                if not above:
                    height = dot(at.n, middle)
                    if height <= -e.reach:
                        continue
                    if linear and height >= e.reach:
                        for b in range(terms):
                            sums[g, t, b] += R_d[t] * dot(vector_at(whole, b), at.n)
                    else:
                        diffuse_of_element(at, diffuse, (places[m], light[m], weights[m]), found)
                        for b in range(terms):
                            sums[g, t, b] += R_d[t] * found[b]
                if far or at.n_dot_v <= 0.0:
                    continue
                lobe = lobe_beside(lobe_of_width(own, inverse[t]), at.n)
                away = length(minus(at.n, half))
                nearest = max(0.0, away - spread)
                if spread < math.pi and nearest * nearest * inverse[t] > ends[t]:
                    continue
                if counts[0] == 0:
                    counts = _shared_counts(plain, e, lobe_of_width(own, sharpest))
                    if max(counts) <= MOST_SHARED:
                        _set_shared_nodes(plain, e, pattern, counts, nodes, shared)
                found[:] = 0.0
                if max(counts) <= MOST_SHARED:
                    number = counts[0] * counts[1]
                    narrow = (away + spread) ** 2 < NARROW_CHORD_SQUARED
                    _specular_of_nodes(at, nodes, shared, number, lobe, narrow, values, found)
                else:
                    specular_of_element(at, e, whole_element(e), pattern, lobe, most[t], found)
                for b in range(terms):
                    sums[g, t, b] += R_s[t] * found[b]
        for t in range(count):
            turned = vector_at(turned_normals, t)
            for g in range(groups):
                for b in range(terms):
                    total = sums[g, t, b] + R_d[t] * dot(vector_at(towards[g], b), turned)
                    for c in range(len(shares)):
                        levels[c, t, i] += shares[c, g, b] * total


def surface_light_variants(
    surface: SurfacePoints,
    references: Float64,
    lights: Sequence[SurfaceLight],
    variants: VariantNumbers,
    caster: RayCaster | None,
    threads: int,
) -> Float64:
    """Levels of variants of a surface under channels of a light, shape (channels, t, k).

    Elements are seen or hidden as wholes.

    surface, references: As :func:`lightopt.rendering._surface_variants.shade_variants` takes them
    lights: The channels, of the same gain
    variants: With coefficients times the light's weight
    """
    channels = channels_of(lights)
    elements = channels.elements
    group, shares = channels.group, channels.group_shares
    # what is far below the noise does not count
    variants = variants._replace(most=variants.most - math.log(NEGLIGIBLE_CHANGE / LEAST_LEVEL))

    def chunk(start: int) -> Float64:
        end_if_stopped()
        part = slice(start, start + step)
        some = surface.take(part)
        own = np.zeros((len(lights), len(variants.lean), len(some)))
        clear, _ = elements_seen(replace(some, normals=some.facets), elements, caster)
        _variant_sums(some.rows, references[part], elements, channels.pattern, group, clear, variants, shares, own)
        return own

    step = min(max(1, AT_ONCE // len(elements)), points_at_once(len(surface), threads))
    found = in_threads(chunk, range(0, max(1, len(surface)), step), threads)
    return np.concatenate(found, axis=2)
