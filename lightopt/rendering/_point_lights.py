"""The panel as m point lights (paper, section 4.1, equation 4)."""

import math

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped
from lightopt.core.vectors import Vector, column_at, dot, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, PanelNumbers, attenuated, panel_grid, panel_numbers
from lightopt.optics import (
    NARROW_CHORD_SQUARED,
    DiffuseForm,
    Lobe,
    Reflectance,
    diffuse_term,
    fresnel_factor,
    is_lambert,
    lambert,
    light_factor,
    lobe_at,
    narrow_gaussian,
    round_ggx,
    specular_divisor,
    specular_lobe,
    square_across,
)
from lightopt.rendering._surface import PointRows, SurfacePoint, SurfacePoints

# pairs of surface point and point light that are shaded at once: some 60 MiB, and 0.2 s that Ctrl-C waits
PAIRS_AT_ONCE = 1 << 20

_AT_ONCE = 1024  # points whose terms are in the processor's nearest cache together
# share of those near the lobe from which on all their lobes are computed at once, and not one by one
_LEAST_SHARE = 0.25


@kernel
def diffuse_only(at: SurfacePoint) -> SurfacePoint:
    """The point with a cosθ_o of 0, which leaves the specular term out."""
    return SurfacePoint(at.p, at.n, at.v, 0.0, at.facet)


@kernel
def point_terms(at: SurfacePoint, q: Vector, panel: PanelNumbers, lobe: Lobe, form: DiffuseForm) -> tuple[float, float]:
    """Diffuse and specular terms, per unit of R_d and R_s, of one point light of weight 1 (paper, equations 2 and 3).

    at: Its cosθ_o, where 0, leaves the specular term out
    q: The point light [mm], a point of the panel
    form: Of the diffuse term
    """
    p, n, v, n_dot_v, _ = at
    light = minus(q, p)
    r2 = dot(light, light)
    light = scaled(light, 1.0 / math.sqrt(r2))
    n_dot_l = dot(n, light)
    if n_dot_l <= 0.0:
        return 0.0, 0.0
    weight = attenuated(1.0, panel, r2, dot(panel.outward, light))
    if is_lambert(form):
        diffuse = weight * lambert(n_dot_l)
    else:
        diffuse = weight * diffuse_term(n_dot_l, dot(n, v), dot(light, v), form)
    if n_dot_v <= 0.0:
        return diffuse, 0.0
    half = plus(light, v)
    length_squared = dot(half, half)
    if not _near_lobe(dot(n, half), length_squared, lobe):
        return diffuse, 0.0
    return diffuse, weight * (lobe_towards(n, v, light, lobe) / specular_divisor(n_dot_v, square_across(v, lobe), lobe))


@kernel
def round_lobe_numbers(n: Vector, v: Vector, light: Vector) -> tuple[float, float, float]:
    """|N − H|², N·L and |L + V|, on which a lobe depends that is alike all round; parameters as of `lobe_towards`."""
    half = plus(light, v)
    size = math.sqrt(dot(half, half))
    chord = minus(n, scaled(half, 1.0 / size))
    return dot(chord, chord), dot(n, light), size


@kernel
def lobe_towards(n: Vector, v: Vector, light: Vector, lobe: Lobe) -> float:
    """Specular component of light from a direction above the horizon per unit of R_s, but for the view's divisor.

    n, v, light: Unit normal, unit view direction, unit direction to the light
    """
    half = plus(light, v)
    size = math.sqrt(dot(half, half))
    chord = minus(n, scaled(half, 1.0 / size))
    if lobe.plain:
        return specular_lobe(dot(chord, chord), 0.0, lobe)
    factor = light_factor(dot(n, light), square_across(light, lobe), size, lobe)
    return specular_lobe(dot(chord, chord), square_across(chord, lobe), lobe) * factor


@kernel
def round_lobes(values: Float64, chord: Float64, n_dot_l: Float64, half_size: Float64, count: int, lobe: Lobe) -> None:
    """Set what :func:`lobe_towards` returns, for several directions of light and a lobe that is alike all round.

    The processor works on several of them at once. Far from Gaussian lobes, where only wide ones are not negligible,
    they are off by up to 3e-4 at the horizon.

    values, chord, n_dot_l, half_size: Results; |N − H|², N·L and |L + V|, of which the first `count` count
    """
    if lobe.ggx:
        for i in range(count):
            values[i] = round_ggx(chord[i], n_dot_l[i], lobe.inverse)
    else:
        for i in range(count):
            values[i] = lobe.share * narrow_gaussian(chord[i], lobe.inverse)
        for k in range(lobe.wider):
            for i in range(count):
                values[i] += lobe.shares[k] * narrow_gaussian(chord[i], lobe.inverses[k])
    for i in range(count if lobe.n > 0.0 else 0):
        values[i] *= fresnel_factor(half_size[i], lobe.n, lobe.k, lobe.normal_reflectance)


@kernel
def _near_lobe(n_dot_h: float, length_squared: float, lobe: Lobe) -> bool:
    # whether there is a specular term at all, from N·H' and |H'|² of the half vector H' = L + V: far from the lobe,
    # where most pixels of a glossy part are, not even its square root is needed
    least_cosine = 1.0 - 0.5 * lobe.farthest / lobe.inverse
    within = (n_dot_h > 0.0) & (n_dot_h * n_dot_h >= least_cosine * least_cosine * length_squared)
    return within | (least_cosine <= 0.0)


def shade_points(
    surface: SurfacePoints, light: PanelLight, *, points: int, reflectance: Reflectance, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a panel of m points, per unit of R_d and R_s; two arrays of shape (k,).

    light: Part frame
    points: m = k²
    """
    # points are independent of each other: chunks bound the memory whatever m is
    step = max(1, PAIRS_AT_ONCE // points)
    chunks = [
        _shade_chunk(surface.take(slice(start, start + step)), light, points, reflectance, caster)
        for start in range(0, max(1, len(surface)), step)
    ]
    if len(chunks) == 1:
        return chunks[0]
    diffuse, specular = zip(*chunks, strict=True)
    return np.concatenate(diffuse), np.concatenate(specular)


def _shade_chunk(
    surface: SurfacePoints, light: PanelLight, points: int, reflectance: Reflectance, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    end_if_stopped()
    grid = panel_grid(light, points)
    clear = clear_targets(surface, grid, caster, geometric=caster is not None)
    weight = light.total_weight / points
    return add_points(surface.rows, grid, clear, panel_numbers(light), weight, reflectance.lobe, reflectance.diffuse)


def facing_targets(surface: SurfacePoints, targets: Float64, *, geometric: bool) -> Bool:
    """Targets from which light can arrive at all at each surface point, shape (m, k).

    surface: k surface points
    targets: Point lights [mm], shape (m, 3)
    geometric: Whether the face's own plane, too, must face the light: below it, the face itself is in the way
    """
    found = np.empty((len(targets), len(surface)), np.bool_)
    _facing(surface.points, surface.normals, surface.facets, surface.front, targets, geometric, found)
    return found


def clear_targets(surface: SurfacePoints, targets: Float64, caster: RayCaster | None, *, geometric: bool) -> Bool:
    """The targets of :func:`facing_targets` with nothing in the way; all of them without a caster; shape (m, k)."""
    facing = facing_targets(surface, targets, geometric=geometric)
    if caster is None:
        return facing
    return caster.visible(surface.points, surface.facets, targets, candidates=facing, outside=surface.outside)


def clear_in_turn(surface: SurfacePoints, targets: Float64, caster: RayCaster) -> Bool:
    """Whether nothing is in the way of one target of each point, in turn of those above its horizons; shape (k,)."""
    chosen = _facing_in_turn(surface.points, surface.normals, surface.facets, surface.front, targets)
    return caster.sees_one(surface.points, surface.facets, targets, chosen=chosen, outside=surface.outside)


def visible_counts(surface: SurfacePoints, targets: Float64, caster: RayCaster) -> tuple[Index, Index]:
    """How many targets each point sees, and how many are above its interpolated horizon; two arrays of shape (k,).

    A target above that horizon but below the face's own plane is hidden by the face itself.
    """
    clear = clear_targets(surface, targets, caster, geometric=True)
    above = facing_targets(surface, targets, geometric=False)
    return clear.sum(axis=0), above.sum(axis=0)


@kernel
def _facing_in_turn(points: Float64, normals: Float64, facets: Float64, front: Bool, targets: Float64) -> Int32:
    # number i, in turn, of the targets from which light can arrive at point i; −1 where there is none
    found, facing = np.full(len(points), -1, np.int32), np.empty(len(targets), np.int32)
    for i in range(len(points)):
        p, n, facet, count = vector_at(points, i), vector_at(normals, i), vector_at(facets, i), 0
        for k in range(len(targets)):
            light = minus(vector_at(targets, k), p)
            facing[count] = k
            count += (dot(facet, light) > 0.0) & (dot(n, light) > 0.0)
        if front[i] and count > 0:
            found[i] = facing[i % count]
    return found


@kernel
def _facing(
    points: Float64, normals: Float64, facets: Float64, front: Bool, targets: Float64, geometric: bool, found: Bool
) -> None:
    for i in range(len(points)):
        p, n, facet = vector_at(points, i), vector_at(normals, i), vector_at(facets, i)
        for k in range(len(targets)):
            light = minus(vector_at(targets, k), p)
            above = not geometric or dot(facet, light) > 0.0
            found[k, i] = front[i] & above & (dot(n, light) > 0.0)


@kernel
def add_points(
    rows: PointRows, targets: Float64, clear: Bool, panel: PanelNumbers, weight: float, lobe: Lobe, form: DiffuseForm
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of point lights, per unit of R_d and R_s; two arrays of shape (k,).

    targets: The point lights [mm], shape (m, 3)
    clear: Whether nothing is on the way from a light to a point, shape (m, k)
    weight: Of each light
    form: Of the diffuse light
    """
    points, frames, views, _, _ = rows
    diffuse, specular = np.zeros(len(points)), np.zeros(len(points))
    # the processor works on several points at once in loops without branches over numbers that lie side by side
    p, n, v = np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE))
    n_dot_v, chord_squared = np.empty(_AT_ONCE), np.empty(_AT_ONCE)
    terms, r2, cosine = np.empty(_AT_ONCE), np.empty(_AT_ONCE), np.empty(_AT_ONCE)
    near, lobes, factors = np.empty(_AT_ONCE, np.bool_), np.empty(_AT_ONCE), np.ones(_AT_ONCE)
    lit_cosine, half_size, round_tails = np.empty(_AT_ONCE), np.empty(_AT_ONCE), lobe.ggx and lobe.widening == 1.0
    aside, across_view = np.zeros(_AT_ONCE), np.zeros(_AT_ONCE)  # squares across the brushing, of N − H and of V
    for first in range(0, len(points), _AT_ONCE):
        count = min(_AT_ONCE, len(points) - first)
        for j in range(count):
            i = first + j
            for axis in range(3):
                p[axis, j], n[axis, j], v[axis, j] = points[i, axis], frames[i, axis], views[i, axis]
            n_dot_v[j] = dot(column_at(n, j), column_at(v, j))
            if lobe.widening > 1.0:
                across_view[j] = square_across(column_at(v, j), lobe_at(lobe, frames, first + j))
        # of slices the compiler knows that no index counts from the end: it takes several at once
        own_diffuse, own_specular = diffuse[first : first + count], specular[first : first + count]
        for k in range(len(targets)):
            q, own_clear = vector_at(targets, k), clear[k, first : first + count]
            for j in range(count):
                normal = column_at(n, j)
                light = minus(q, column_at(p, j))
                r2[j] = dot(light, light)
                light = scaled(light, 1.0 / math.sqrt(r2[j]))
                cosine[j] = dot(panel.outward, light)
                n_dot_l = dot(normal, light)
                lit = own_clear[j] & (n_dot_l > 0.0)
                terms[j] = lambert(n_dot_l) if lit else 0.0
                half = plus(light, column_at(v, j))
                length_squared = dot(half, half)
                chord = minus(normal, scaled(half, 1.0 / math.sqrt(length_squared)))
                chord_squared[j] = dot(chord, chord)
                near[j] = lit & (n_dot_v[j] > 0.0) & _near_lobe(dot(normal, half), length_squared, lobe)
                lit_cosine[j], half_size[j] = max(n_dot_l, 0.0), math.sqrt(length_squared)
                if not (lobe.plain or round_tails):
                    turned = lobe_at(lobe, frames, first + j)
                    aside[j] = square_across(chord, turned)
                    towards = square_across(light, turned)
                    factors[j] = light_factor(lit_cosine[j], towards, half_size[j], lobe)
            if not is_lambert(form):
                for j in range(count):
                    if terms[j] > 0.0:
                        light, view = minus(q, column_at(p, j)), column_at(v, j)
                        l_dot_v = dot(light, view) / math.sqrt(r2[j])
                        terms[j] = diffuse_term(terms[j], n_dot_v[j], l_dot_v, form)
            for j in range(count):
                own_diffuse[j] += weight * (attenuated(1.0, panel, r2[j], cosine[j]) * terms[j])
            if round_tails:
                round_lobes(lobes, chord_squared, lit_cosine, half_size, count, lobe)
                for j in range(count):
                    value = lobes[j] / specular_divisor(n_dot_v[j], 0.0, lobe) if near[j] else 0.0
                    own_specular[j] += weight * (attenuated(1.0, panel, r2[j], cosine[j]) * value)
                continue
            all_at_once = lobe.plain and np.count_nonzero(near[:count]) > _LEAST_SHARE * count
            if all_at_once:
                for j in range(count):
                    chord = min(chord_squared[j], NARROW_CHORD_SQUARED)
                    lobes[j] = narrow_gaussian(chord, lobe.inverse)
            for j in range(count):
                if near[j]:
                    narrow = all_at_once and chord_squared[j] < NARROW_CHORD_SQUARED
                    value = lobes[j] if narrow else specular_lobe(chord_squared[j], aside[j], lobe) * factors[j]
                    value = value / specular_divisor(n_dot_v[j], across_view[j], lobe)
                    own_specular[j] += weight * (attenuated(1.0, panel, r2[j], cosine[j]) * value)
    return diffuse, specular
