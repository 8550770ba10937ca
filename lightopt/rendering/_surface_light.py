"""The light of surfaces other than panels: elements of planes, cones and spheres, each seen or hidden as its middle is.

Diffuse light takes a few Gauss–Legendre nodes of each element. The lobe is integrated as over a panel
(:mod:`lightopt.rendering._panel_quadrature`): where it is least far from the normal, the exponent's quadratic form in
(u, v) gives a window and the nodes that it takes. Where a part hides some of the elements, those that the lobe reaches
are divided, each piece with a ray of its own.
"""

import math
from dataclasses import replace

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped, in_threads
from lightopt.core.vectors import Vector, cross, divided, dot, length, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import (
    Element,
    SurfaceLight,
    element_at,
    element_place,
    element_weight,
    pattern_mean,
    pattern_value,
)
from lightopt.optics import MIN_COS_VIEW, Reflectance, specular_cosine, specular_lobe
from lightopt.rendering._panel_quadrature import (
    NODES,
    WEIGHTS,
    Rectangle,
    half_vector_cone,
    half_vector_map,
    least_in_box,
    lobe_window,
    node_count,
)
from lightopt.rendering._point_lights import facing_targets
from lightopt.rendering._surface import SurfacePoints
from lightopt.rendering._variant_numbers import VariantNumbers, leaning

DIFFUSE_NODES = 3  # a side of an element
LEAST_NODES, MOST_NODES = 2, 48  # a side of the lobe's window
# exponents from which the light of an element is so little that fewer nodes do, and their number far from the lobe
FLANK, FAR, FAR_NODES = 4.5, 9.0, 2
MOST_PATTERN_NODES = 40
PIECES = 4  # along a side of an element of which some may be hidden
LEAST_LEVEL = 1e-3  # what the lobe of an element adds at most where it is left out [grey level]
MOST_R_S_SIGMA_2 = 1e3  # R_s·σ² of fits, where R_s is not known [grey level]
NEGLIGIBLE_LEVEL = 0.02  # elements whose highlight is less are not divided [grey level]
STEPS = 6  # Newton steps to where the lobe is brightest
NEAR = 0.02  # of an element's sides: steps that are less end the search

_CHUNK = 8192  # surface points that a thread works on at once
_AT_ONCE = 1 << 21  # pairs of surface point and element that are shaded at once


@kernel
def _diffuse_nodes(e: Element) -> tuple[Float64, Float64]:
    # places of an element [mm], and their light: radiance · area · unit vector of where they shine; shape (nodes², 3)
    places, light = np.empty((DIFFUSE_NODES**2, 3)), np.empty((DIFFUSE_NODES**2, 3))
    du, dv = e.u1 - e.u0, e.v1 - e.v0
    k = 0
    for i in range(DIFFUSE_NODES):
        for j in range(DIFFUSE_NODES):
            u, v = e.u0 + du * NODES[DIFFUSE_NODES, i], e.v0 + dv * NODES[DIFFUSE_NODES, j]
            q, along_u, along_v = element_place(e, u, v)
            weight = WEIGHTS[DIFFUSE_NODES, i] * WEIGHTS[DIFFUSE_NODES, j] * du * dv * pattern_mean(e) * e.radiance
            shining = scaled(cross(along_u, along_v), weight * e.side)
            places[k, 0], places[k, 1], places[k, 2] = q
            light[k, 0], light[k, 1], light[k, 2] = shining
            k += 1
    return places, light


@kernel
def _diffuse(p: Vector, n: Vector, places: Float64, light: Float64) -> float:
    # light of an element per unit of R_d: Σ light · cosα · (N·L) / r²
    total = 0.0
    for k in range(len(places)):
        towards = minus(vector_at(places, k), p)
        r2 = dot(towards, towards)
        total += max(0.0, dot(n, towards)) * max(0.0, -dot(vector_at(light, k), towards)) / (r2 * r2)
    return total


@kernel
def specular_of_element(
    p: Vector, n: Vector, v: Vector, e: Element, area: Rectangle, inverse: float, most: float
) -> float:
    """Specular light of a piece of an element per unit of R_s (paper, equation 3).

    area: The piece, by u and v
    inverse: 1/(2σ²) [rad⁻²]
    most: Exponent from which the lobe is negligible
    """
    n_dot_v = dot(n, v)
    if n_dot_v <= 0.0:
        return 0.0
    half, spread = half_vector_cone(p, v, e.centre, e.reach)
    nearest = max(0.0, length(minus(n, half)) - spread)
    if spread < math.pi and nearest * nearest * inverse > most:
        return 0.0
    s, t = 0.5 * (area.s0 + area.s1), 0.5 * (area.t0 + area.t1)
    wide, high = area.s1 - area.s0, area.t1 - area.t0
    a = b = c = gs = gt = least = 0.0
    for _ in range(STEPS):
        q, along_s, along_t = element_place(e, s, t)
        hx, hy, jxs, jxt, jys, jyt = half_vector_map(p, n, v, q, along_s, along_t)
        a, b, c = (
            inverse * (jxs * jxs + jys * jys),
            inverse * (jxs * jxt + jys * jyt),
            inverse * (jxt * jxt + jyt * jyt),
        )
        gs, gt = inverse * (jxs * hx + jys * hy), inverse * (jxt * hx + jyt * hy)
        least = inverse * (hx * hx + hy * hy)
        ns, nt = least_in_box(a, b, c, gs - a * s - b * t, gt - b * s - c * t, s, t, area)
        moved = max(abs(ns - s) / wide, abs(nt - t) / high)
        if moved < NEAR:
            break
        s, t = ns, nt
    if least > most:
        return 0.0
    window = lobe_window(a, b, c, gs, gt, s, t, least, area)
    width, height = window.s1 - window.s0, window.t1 - window.t0
    if width <= 0.0 or height <= 0.0:
        return 0.0
    count_s = node_count(a, gs, window.s0 - s, window.s1 - s)
    count_t = node_count(c, gt, window.t0 - t, window.t1 - t)
    # the lobe's flank adds little to its light, of which few nodes are good enough
    few = FAR_NODES if least > FAR else MOST_NODES
    if least > FLANK:
        count_s, count_t = count_s - 2, count_t - 2
    count_s, count_t = max(min(count_s, few), LEAST_NODES), max(min(count_t, few), LEAST_NODES)
    if e.contrast != 0.0:
        count_s = max(count_s, min(MOST_PATTERN_NODES, math.ceil(3.0 + 0.6 * abs(e.wave_u) * width)))
        count_t = max(count_t, min(MOST_PATTERN_NODES, math.ceil(3.0 + 0.6 * abs(e.wave_v) * height)))
    total = 0.0
    for i in range(count_s):
        at_s = window.s0 + width * NODES[count_s, i]
        for j in range(count_t):
            at_t = window.t0 + height * NODES[count_t, j]
            q, along_s, along_t = element_place(e, at_s, at_t)
            towards = minus(q, p)
            if dot(n, towards) <= 0.0:
                continue
            half = plus(divided(towards, length(towards)), v)
            chord = minus(n, divided(half, length(half)))
            lobe = specular_lobe(dot(chord, chord), inverse)
            weight = WEIGHTS[count_s, i] * WEIGHTS[count_t, j] * pattern_value(e, at_s, at_t)
            total += weight * lobe * element_weight(e, towards, along_s, along_t)
    return total * width * height / specular_cosine(n_dot_v)


@kernel
def _whole(e: Element) -> Rectangle:
    return Rectangle(e.u0, e.u1, e.v0, e.v1)


@kernel
def _piece(e: Element, number: int) -> Rectangle:
    i, j = number // PIECES, number % PIECES
    du, dv = (e.u1 - e.u0) / PIECES, (e.v1 - e.v0) / PIECES
    return Rectangle(e.u0 + i * du, e.u0 + (i + 1) * du, e.v0 + j * dv, e.v0 + (j + 1) * dv)


@kernel
def _add_elements(
    points: Float64,
    normals: Float64,
    views: Float64,
    elements: Float64,
    clear: Bool,
    inverse: float,
    most: float,
    diffuse: Float64,
    specular: Float64,
) -> None:
    # diffuse light of the clear elements per unit of R_d, shape (k,), and specular light of each element per unit of
    # R_s, whatever hides it, shape (e, k)
    for m in range(len(elements)):
        e = element_at(elements, m)
        places, light = _diffuse_nodes(e)
        for i in range(len(points)):
            p, n = vector_at(points, i), vector_at(normals, i)
            if dot(n, minus(e.centre, p)) <= -e.reach:
                continue
            if clear[m, i]:
                diffuse[i] += _diffuse(p, n, places, light)
            specular[m, i] = specular_of_element(p, n, vector_at(views, i), e, _whole(e), inverse, most)


@kernel
def _piece_targets(elements: Float64) -> Float64:
    targets = np.empty((len(elements) * PIECES * PIECES, 3))
    for m in range(len(elements)):
        e = element_at(elements, m)
        for k in range(PIECES * PIECES):
            area = _piece(e, k)
            q, _, _ = element_place(e, 0.5 * (area.s0 + area.s1), 0.5 * (area.t0 + area.t1))
            row = m * PIECES * PIECES + k
            targets[row, 0], targets[row, 1], targets[row, 2] = q.x, q.y, q.z
    return targets


@kernel
def _replace_pieces(
    points: Float64,
    normals: Float64,
    views: Float64,
    elements: Float64,
    element: Index,
    point: Index,
    free: Bool,
    inverse: float,
    most: float,
    specular: Float64,
) -> None:
    for k in range(len(point)):
        i, m = point[k], element[k]
        p, n, v, e = vector_at(points, i), vector_at(normals, i), vector_at(views, i), element_at(elements, m)
        total = 0.0
        for number in range(PIECES * PIECES):
            if free[k, number]:
                total += specular_of_element(p, n, v, e, _piece(e, number), inverse, most)
        specular[m, i] = total


def shade_surface_light(
    surface: SurfacePoints, light: SurfaceLight, *, reflectance: Reflectance, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a light, per unit of R_d and R_s; two arrays of shape (k,).

    light: Part frame
    reflectance: Its σ shapes the lobe; R_s decides which shadows in highlights are worked out
    caster: For shadows; None for none
    """
    step = max(1, _AT_ONCE // len(light.elements))
    chunks = [
        _shade_chunk(surface.take(slice(start, start + step)), light, reflectance, caster)
        for start in range(0, len(surface), step)
    ]
    if len(chunks) == 1:
        return chunks[0]
    empty = [np.zeros(0)]
    return np.concatenate([d for d, _ in chunks] or empty), np.concatenate([s for _, s in chunks] or empty)


def _shade_chunk(
    surface: SurfacePoints, light: SurfaceLight, reflectance: Reflectance, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    end_if_stopped()
    elements, inverse = light.elements, 0.5 / reflectance.sigma**2
    # where the lobe's exponent is more, an element adds nothing to a level, at any angle of view
    most = math.log(max(1.0, light.total_weight * reflectance.R_s / (MIN_COS_VIEW * LEAST_LEVEL)))
    clear, hidden = _visibility(surface, light, caster)
    diffuse, specular = np.zeros(len(surface)), np.zeros((len(elements), len(surface)))
    geometry = surface.points, surface.normals, surface.views
    _add_elements(*geometry, elements, clear, inverse, most, diffuse, specular)
    specular[:, ~surface.front] = 0.0
    if caster is not None and hidden.any():
        bright = specular * (light.total_weight * reflectance.R_s) > NEGLIGIBLE_LEVEL
        element, point = np.nonzero(bright & hidden.any(axis=0))
        specular *= clear
        free = _free_pieces(surface, light, caster, element, point)
        _replace_pieces(*geometry, elements, element, point, free, inverse, most, specular)
    return light.total_weight * diffuse, light.total_weight * specular.sum(axis=0)


def _visibility(surface: SurfacePoints, light: SurfaceLight, caster: RayCaster | None) -> tuple[Bool, Bool]:
    # whether nothing is on the way to the middle of each element, and whether the part is, shape (e, k). What is below
    # a point's own horizon is no light of this element's nodes
    targets = light.targets
    if caster is None:
        return np.repeat(surface.front[None], len(targets), axis=0), np.zeros((len(targets), len(surface)), np.bool_)
    facing = facing_targets(surface, targets, geometric=True)
    seen = caster.visible(surface.points, surface.facets, targets, candidates=facing, outside=surface.outside)
    hidden = facing & ~seen
    return surface.front & ~hidden, hidden


def _free_pieces(surface: SurfacePoints, light: SurfaceLight, caster: RayCaster, element: Index, point: Index) -> Bool:
    # which pieces of an element a point sees, shape (pairs, PIECES²)
    number = PIECES * PIECES
    targets = _piece_targets(light.elements)
    target_index = (element[:, None] * number + np.arange(number)).astype(np.int32).ravel()
    point_index = np.repeat(point.astype(np.int32), number)
    blocked = caster.occluded(
        surface.points, surface.facets, targets, point_index=point_index, target_index=target_index
    )
    return ~blocked.reshape(-1, number)


@kernel
def _variant_levels(
    points: Float64,
    normals: Float64,
    references: Float64,
    views: Float64,
    elements: Float64,
    clear: Bool,
    variants: VariantNumbers,
    levels: Float64,
) -> None:
    # levels of the variants of each point, shape (t, k)
    lean, R_d, R_s, inverse, most = variants
    for m in range(len(elements)):
        e = element_at(elements, m)
        places, light = _diffuse_nodes(e)
        for i in range(len(points)):
            if not clear[m, i]:
                continue
            p, n, v, r = vector_at(points, i), vector_at(normals, i), vector_at(views, i), vector_at(references, i)
            a = cross(n, r)
            for t in range(len(lean)):
                turned = leaning(lean, t, n, r, a)
                if dot(turned, minus(e.centre, p)) <= -e.reach:
                    continue
                s = specular_of_element(p, turned, v, e, _whole(e), inverse[t], most[t])
                levels[t, i] += R_d[t] * _diffuse(p, turned, places, light) + R_s[t] * s


def surface_light_variants(
    surface: SurfacePoints, references: Float64, light: SurfaceLight, variants: VariantNumbers, caster: RayCaster | None
) -> Float64:
    """Levels of variants of a surface under a light, shape (t, k); elements are seen or hidden as wholes.

    surface, references: As :func:`lightopt.rendering.shade_variants` takes them
    variants: With coefficients times the light's weight
    """
    levels = np.zeros((len(variants.lean), len(surface)))
    step = max(1, _AT_ONCE // len(light.elements))
    for start in range(0, len(surface), step):
        end_if_stopped()
        part = slice(start, start + step)
        some, own = surface.take(part), np.zeros((len(variants.lean), len(surface.points[part])))
        clear, _ = _visibility(replace(some, normals=some.facets), light, caster)
        _variant_levels(some.points, some.normals, references[part], some.views, light.elements, clear, variants, own)
        levels[:, part] = own
    return levels


def light_of_elements(
    surface: SurfacePoints, light: SurfaceLight, sigma: float | None, *, threads: int | None = None
) -> tuple[Float64, Float64]:
    """Diffuse and specular light at points that see all of a light, per unit of R_d and R_s; shapes (k,).

    sigma: Width of the lobe [rad]; None for diffuse light alone
    """
    reflectance = Reflectance(R_d=1.0, R_s=0.0, sigma=1e-3)
    if sigma is not None:
        reflectance = Reflectance(R_d=1.0, R_s=MOST_R_S_SIGMA_2 / sigma**2, sigma=sigma)

    def chunk(start: int) -> tuple[Float64, Float64]:
        some = surface.take(slice(start, start + _CHUNK))
        return shade_surface_light(some, light, reflectance=reflectance, caster=None)

    # light is per unit of R_s: only where it is negligible depends on R_s
    found = in_threads(chunk, range(0, len(surface), _CHUNK), threads)
    empty = [np.zeros(0)]
    return np.concatenate([d for d, _ in found] or empty), np.concatenate([s for _, s in found] or empty)


@kernel
def _deflections(points: Float64, normals: Float64, views: Float64, elements: Float64, deflection: Float64) -> None:
    for i in range(len(points)):
        p, n, v = vector_at(points, i), vector_at(normals, i), vector_at(views, i)
        for m in range(len(elements)):
            e = element_at(elements, m)
            half, spread = half_vector_cone(p, v, e.centre, e.reach)
            chord = length(minus(n, half))
            angle = 2.0 * math.asin(min(1.0, 0.5 * chord)) - spread
            deflection[i] = min(deflection[i], max(0.0, angle))


def least_deflection(surface: SurfacePoints, light: SurfaceLight) -> Float64:
    """About the least angle between each normal and the half vectors of a light [rad], shape (k,)."""
    deflection = np.full(len(surface), math.pi)
    _deflections(surface.points, surface.normals, surface.views, light.elements, deflection)
    return deflection
