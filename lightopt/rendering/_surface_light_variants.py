"""Levels of variants of a surface under the surface of a light.

All variants of a point take the same few Gauss–Legendre nodes of an element where these resolve the lobe; a narrow lobe
is integrated for each variant.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped
from lightopt.core.vectors import Vector, cross, divided, dot, length, minus, plus, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import Element, Pattern, SurfaceLight, element_at, element_place, element_weight
from lightopt.optics import specular_cosine, specular_lobe
from lightopt.rendering._panel_quadrature import NODES, half_vector_cone, half_vector_map
from lightopt.rendering._surface import SurfacePoints
from lightopt.rendering._surface_light import (
    AT_ONCE,
    LEAST_LEVEL,
    channels_of,
    diffuse_nodes,
    diffuse_of_element,
    element_weights,
    elements_seen,
    specular_of_element,
    whole_element,
)
from lightopt.rendering._variant_numbers import VariantNumbers, leaning

NEGLIGIBLE_CHANGE = 0.05  # what the lobe of an element adds at most where it is left out [grey level]
MOST_SHARED = 12  # nodes a side of an element that all variants share
LEAST_SHARED = 3


@kernel
def _shared_count(width: float) -> int:
    # nodes a side that resolve a lobe, by the side's width in half vectors [σ]: to half a percent of a large light
    return max(LEAST_SHARED, math.ceil(1.5 + 0.6 * width))


@kernel
def _shared_counts(p: Vector, n: Vector, v: Vector, e: Element, inverse: float) -> tuple[int, int]:
    q, along_u, along_v = element_place(e, 0.5 * (e.u0 + e.u1), 0.5 * (e.v0 + e.v1))
    _, _, jxu, jxv, jyu, jyv = half_vector_map(p, n, v, q, along_u, along_v)
    wide = math.sqrt(2.0 * inverse * (jxu * jxu + jyu * jyu)) * (e.u1 - e.u0)
    high = math.sqrt(2.0 * inverse * (jxv * jxv + jyv * jyv)) * (e.v1 - e.v0)
    return _shared_count(min(wide, 1e3)), _shared_count(min(high, 1e3))


@kernel
def _set_shared_nodes(
    p: Vector, v: Vector, e: Element, pattern: Pattern, counts: tuple[int, int], nodes: Float64, light: Float64
) -> None:
    # half vector of each node and 2·H·V, shape (nodes, 4), and its light for each term, shape (b, nodes)
    du, dv = e.u1 - e.u0, e.v1 - e.v0
    weights = np.empty(counts)
    for i in range(counts[0]):
        for j in range(counts[1]):
            k = i * counts[1] + j
            q, along_u, along_v = element_place(e, e.u0 + du * NODES[counts[0], i], e.v0 + dv * NODES[counts[1], j])
            towards = minus(q, p)
            half = plus(divided(towards, length(towards)), v)
            half = divided(half, length(half))
            nodes[k, 0], nodes[k, 1], nodes[k, 2] = half
            nodes[k, 3] = 2.0 * dot(half, v)
            light[:, k] = du * dv * element_weight(e, towards, along_u, along_v)
    for b in range(len(pattern.terms)):
        element_weights(e, pattern, b, weights)
        light[b, : weights.size] *= weights.ravel()


@kernel
def _specular_of_nodes(
    n: Vector, n_dot_v: float, nodes: Float64, light: Float64, count: int, inverse: float, found: Float64
) -> None:
    factor = 1.0 / specular_cosine(n_dot_v)
    for k in range(count):
        half = vector_at(nodes, k)
        chord = minus(n, half)
        # N·L = 2 (N·H)(H·V) − N·V
        if dot(n, half) * nodes[k, 3] > n_dot_v:
            lobe = factor * specular_lobe(dot(chord, chord), inverse)
            for b in range(len(light)):
                found[b] += lobe * light[b, k]


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
def _variant_levels(
    points: Float64,
    normals: Float64,
    references: Float64,
    views: Float64,
    elements: Float64,
    pattern: Pattern,
    shares: Float64,
    clear: Bool,
    variants: VariantNumbers,
    levels: Float64,
) -> None:
    # levels of the variants of each point under each channel, shape (channels, t, k)
    lean, R_d, R_s, inverse, most = variants
    sharpest = inverse.max()
    terms = len(pattern.terms)
    found, level, whole = np.empty(terms), np.empty(terms), np.empty((terms, 3))
    nodes, shared = np.empty((MOST_SHARED**2, 4)), np.empty((terms, MOST_SHARED**2))
    for m in range(len(elements)):
        e = element_at(elements, m)
        places, light, weights = diffuse_nodes(e, pattern)
        for i in range(len(points)):
            if not clear[m, i]:
                continue
            p, n, v, r = vector_at(points, i), vector_at(normals, i), vector_at(views, i), vector_at(references, i)
            a, middle = cross(n, r), minus(e.centre, p)
            half, spread = half_vector_cone(p, v, e.centre, e.reach)
            _set_vector_light(p, places, light, weights, whole)
            counts = 0, 0
            for t in range(len(lean)):
                turned = leaning(lean, t, n, r, a)
                height = dot(turned, middle)
                if height <= -e.reach:
                    continue
                if height >= e.reach:
                    for b in range(terms):
                        level[b] = R_d[t] * dot(vector_at(whole, b), turned)
                else:
                    diffuse_of_element(p, turned, places, light, weights, found)
                    for b in range(terms):
                        level[b] = R_d[t] * found[b]
                n_dot_v = dot(turned, v)
                nearest = max(0.0, length(minus(turned, half)) - spread)
                if n_dot_v > 0.0 and (spread >= math.pi or nearest * nearest * inverse[t] <= most[t]):
                    if counts[0] == 0:
                        counts = _shared_counts(p, n, v, e, sharpest)
                        if max(counts) <= MOST_SHARED:
                            _set_shared_nodes(p, v, e, pattern, counts, nodes, shared)
                    found[:] = 0.0
                    if max(counts) <= MOST_SHARED:
                        _specular_of_nodes(turned, n_dot_v, nodes, shared, counts[0] * counts[1], inverse[t], found)
                    else:
                        specular_of_element(p, turned, v, e, whole_element(e), pattern, inverse[t], most[t], found)
                    for b in range(terms):
                        level[b] += R_s[t] * found[b]
                for c in range(len(shares)):
                    for b in range(terms):
                        levels[c, t, i] += shares[c, m, b] * level[b]


def surface_light_variants(
    surface: SurfacePoints,
    references: Float64,
    lights: Sequence[SurfaceLight],
    variants: VariantNumbers,
    caster: RayCaster | None,
) -> Float64:
    """Levels of variants of a surface under channels of a light, shape (channels, t, k).

    Elements are seen or hidden as wholes.

    surface, references: As :func:`lightopt.rendering.shade_variants` takes them
    lights: The channels, of the same gain
    variants: With coefficients times the light's weight
    """
    channels = channels_of(lights)
    elements, pattern, shares = channels.elements, channels.pattern, channels.shares
    # what is far below the noise does not count
    variants = variants._replace(most=variants.most - math.log(NEGLIGIBLE_CHANGE / LEAST_LEVEL))
    levels = np.zeros((len(lights), len(variants.lean), len(surface)))
    step = max(1, AT_ONCE // len(elements))
    for start in range(0, len(surface), step):
        end_if_stopped()
        part = slice(start, start + step)
        some = surface.take(part)
        own = np.zeros((*levels.shape[:2], len(some)))
        clear, _ = elements_seen(replace(some, normals=some.facets), elements, caster)
        geometry = some.points, some.normals, references[part], some.views
        _variant_levels(*geometry, elements, pattern, shares, clear, variants, own)
        levels[..., part] = own
    return levels
