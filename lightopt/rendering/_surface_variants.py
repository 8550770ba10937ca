"""A surface tried as several others at once: with its normal leaning, or another reflectance, in the same shadows.

What a defect would make of each point: it stays where it is, sees what it would see and is in the shadows that it
would be in; only normal, R_d, R_s and σ are others, as in :mod:`lightopt.rendering._defect_shading`. Rays are cast
once for all variants: towards every light that the facet faces, since a leaning wall may face one that the surface
does not.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped
from lightopt.core.vectors import Vector, cross, dot, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, PanelNumbers, SurfaceLight, attenuated, panel_grid, panel_numbers
from lightopt.optics import (
    MIN_COS_VIEW,
    NARROW_CHORD_SQUARED,
    DiffuseForm,
    Lobe,
    Reflectance,
    diffuse_term,
    farthest_exponent,
    is_lambert,
    lambert,
    light_factor,
    lobe_across,
    lobe_beside,
    lobe_of_width,
    narrow_gaussian,
    specular_divisor,
    specular_lobe,
    square_across,
)
from lightopt.rendering._converged_panel import ConvergedPanel, channel_groups
from lightopt.rendering._converged_variants import VariantNumbers, panel_variants
from lightopt.rendering._point_lights import PAIRS_AT_ONCE, add_points, clear_targets
from lightopt.rendering._surface import PointRows, SurfacePoints
from lightopt.rendering._surface_light_variants import surface_light_variants

# surface points under a converged panel that are shaded at once: some 0.1 s, the longest that Ctrl-C waits
CONVERGED_AT_ONCE = 1 << 13

# lobes are left out of variants where they are nowhere more than this [grey level]: 0.26 of a level of 16 bits
NEGLIGIBLE_LEVEL = 1e-3

# Points whose terms are computed together, in loops without branches over numbers that lie side by side: the processor
# takes several at once. Rows of so many numbers lie one after the other in flat arrays, since the compiler knows only
# from constant distances that none overlaps another.
_AT_ONCE = 128
# share of these near a variant's lobe from which on all their lobes are computed at once, and not one by one
_LEAST_SHARE = 0.1


Levels = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfaceVariants:
    """What each point of a surface is tried as, t ways."""

    # components of each variant's normal along the point's normal, its reference direction and the direction across,
    # which with the first two makes a right-handed frame; shape (t, 3)
    lean: Float64
    R_d: Float64  # of each, shape (t,)
    R_s: Float64  # of each, shape (t,)
    sigma: Float64  # of each, shape (t,)
    reflectance: Reflectance  # of the surface as it is


class VariantLevels(NamedTuple):
    """Light of a panel from k surface points [grey level]."""

    good: Float64  # of the surface as it is, from the same points or cells of the panel, shape (k,)
    varied: Levels  # of the variants, shape (t, k); of the type that was wanted


def surface_variants(
    *,
    slope: Float64,
    direction: Float64,
    R_d_factor: Float64,
    sigma_factor: Float64,
    reflectances: Sequence[Reflectance],
) -> tuple[SurfaceVariants, ...]:
    """Variants of each reflectance by slope and direction of the lean [rad] and factors, each of shape (t,)."""
    lean = np.stack([np.cos(slope), np.sin(slope) * np.cos(direction), np.sin(slope) * np.sin(direction)], axis=1)
    factors = list(zip(R_d_factor.tolist(), sigma_factor.tolist(), strict=True))

    def variants(reflectance: Reflectance) -> SurfaceVariants:
        some = {(d, s): reflectance.changed(R_d_factor=d, sigma_factor=s) for d, s in set(factors)}
        changed = [some[pair] for pair in factors]
        return SurfaceVariants(
            lean=lean,
            R_d=np.array([one.R_d for one in changed]),
            R_s=np.array([one.R_s for one in changed]),
            sigma=np.array([one.sigma for one in changed]),
            reflectance=reflectance,
        )

    return tuple(map(variants, reflectances))


def shade_variants(
    surface: SurfacePoints,
    references: Float64,
    panels: Sequence[PanelLight | ConvergedPanel],
    variants: Sequence[SurfaceVariants],
    *,
    caster: RayCaster | None,
    dtype: type[np.floating[Any]] = np.float64,
    threads: int = 1,
) -> list[VariantLevels]:
    """The light of each of some lights on a surface and on its variants.

    A few points stand for a converged panel where they resolve the lobe; channels of one light are worked out together.

    surface: k points that the camera sees from the front, none of them another's neighbour; part frame
    references: Unit vectors in the tangent planes that directions count from, shape (k, 3)
    panels: Part frame, as from :func:`lightopt.rendering.panel_to_shade`
    variants: Of each material
    dtype: Of the variants' levels
    threads: That work on the points of lights that are no panels
    """
    groups = [[panels[i] for i in group] for group in channel_groups(panels)]

    def levels(some: SurfacePoints, own_references: Float64, own: SurfaceVariants) -> list[VariantLevels]:
        of_groups = (_group_variants(some, own_references, group, own, caster, dtype, threads) for group in groups)
        return list(itertools.chain.from_iterable(of_groups))

    if surface.material is None:
        return levels(surface, references, variants[0])
    shape = len(variants[0].lean), len(surface)
    merged = [VariantLevels(np.empty(len(surface)), np.empty(shape, dtype)) for _ in panels]
    for index, some, own in surface.by_material(variants):
        for whole, found in zip(merged, levels(some, references[index], own), strict=True):
            whole.good[index], whole.varied[:, index] = found
    return merged


def _group_variants(
    surface: SurfacePoints,
    references: Float64,
    panels: Sequence[PanelLight | ConvergedPanel],
    variants: SurfaceVariants,
    caster: RayCaster | None,
    dtype: type[np.floating[Any]],
    threads: int,
) -> list[VariantLevels]:
    channels = [panel for panel in panels if isinstance(panel, SurfaceLight)]
    if channels:
        numbers = _with_plain(variants, channels[0].total_weight)
        found = surface_light_variants(surface, references, channels, numbers, caster, threads)
        return [VariantLevels(one[0], one[1:].astype(dtype)) for one in found]
    (panel,) = panels
    if isinstance(panel, ConvergedPanel) and (points := panel.points_for(float(variants.sigma.min()))):
        panel = replace(panel.light, points=points, normalisation="mean")

    def shade(start: int) -> VariantLevels:
        end_if_stopped()
        some, own = surface.take(slice(start, start + step)), references[start : start + step]
        if isinstance(panel, ConvergedPanel):
            return _converged_variants(some, own, panel, variants, caster, dtype)
        return _point_variants(some, own, panel, variants, caster, dtype)

    step = CONVERGED_AT_ONCE if isinstance(panel, ConvergedPanel) else max(1, PAIRS_AT_ONCE // int(panel.points))
    good, varied = zip(*map(shade, range(0, max(1, len(surface)), step)), strict=True)
    if len(good) == 1:
        return [VariantLevels(good[0], varied[0])]
    return [VariantLevels(np.concatenate(good), np.concatenate(varied, axis=1))]


def _point_variants(
    surface: SurfacePoints,
    references: Float64,
    light: PanelLight,
    variants: SurfaceVariants,
    caster: RayCaster | None,
    dtype: type[np.floating[Any]],
) -> VariantLevels:
    reflectance = variants.reflectance
    assert light.points != "auto"
    grid = panel_grid(light, light.points)
    if caster is None:
        # nothing is in the way, not even the point's own face
        clear = np.ones((len(grid), len(surface)), np.bool_)
    else:
        # towards every light that the facet faces, whatever the normals
        clear = clear_targets(replace(surface, normals=surface.facets), grid, caster, geometric=False)
    numbers, weight, rows = panel_numbers(light), light.total_weight / light.points, surface.rows
    diffuse, specular = add_points(rows, grid, clear, numbers, weight, reflectance.lobe, reflectance.diffuse)
    # large arrays that NumPy makes have large pages
    varied = np.empty((len(variants.lean), len(surface)), dtype)
    own = VariantNumbers(
        variants.lean,
        variants.R_d,
        variants.R_s,
        0.5 / variants.sigma**2,
        _most_exponents(variants.R_s, light.total_weight, MIN_COS_VIEW),
        reflectance.lobe,
        reflectance.diffuse,
    )
    _point_kernel(rows, references, grid, clear, numbers, weight, own, varied)
    return VariantLevels(reflectance.R_d * diffuse + reflectance.R_s * specular, varied)


def _most_exponents(R_s: Float64, weight: float, least_cosine: float) -> Float64:
    # where the lobe's exponent is more than this, the lobe is negligible for any cosθ_o that is not less
    return np.log(np.maximum(R_s * weight / least_cosine / NEGLIGIBLE_LEVEL, 1.0))


def _with_plain(variants: SurfaceVariants, weight: float) -> VariantNumbers:
    # the surface as it is comes first; coefficients times the light's weight
    reflectance = variants.reflectance
    R_s = weight * np.concatenate([[reflectance.R_s], variants.R_s])
    return VariantNumbers(
        lean=np.concatenate([[[1.0, 0.0, 0.0]], variants.lean]),
        R_d=weight * np.concatenate([[reflectance.R_d], variants.R_d]),
        R_s=R_s,
        inverse=0.5 / np.concatenate([[reflectance.sigma], variants.sigma]) ** 2,
        most=_most_exponents(R_s, 1.0, 1.0),
        lobe=reflectance.lobe,
        diffuse=reflectance.diffuse,
    )


def _converged_variants(
    surface: SurfacePoints,
    references: Float64,
    converged: ConvergedPanel,
    variants: SurfaceVariants,
    caster: RayCaster | None,
    dtype: type[np.floating[Any]],
) -> VariantLevels:
    numbers = _with_plain(variants, converged.light.total_weight)
    levels = panel_variants(surface, references, converged, caster, numbers)
    return VariantLevels(levels[:, 0], np.ascontiguousarray(levels[:, 1:].T, dtype))


@kernel
def _point_kernel(
    rows: PointRows,
    references: Float64,
    grid: Float64,
    clear: Bool,
    panel: PanelNumbers,
    weight: float,
    variants: VariantNumbers,
    varied: Levels,
) -> None:
    # levels of the variants, shape (t, k)
    count, lights = len(references), len(grid)
    lean, R_d, R_s, inverse, most, form, diffuse = variants  # taken from a tuple, an array's references are counted
    frames, sums, towards = np.zeros(21 * _AT_ONCE), np.zeros(4 * _AT_ONCE), np.zeros(3 * _AT_ONCE)
    rays, boxes, lit = np.zeros((lights, 8 * _AT_ONCE)), np.zeros((lights + 1, 2, 3)), np.zeros(lights, np.bool_)
    for first in range(0, count, _AT_ONCE):
        number = min(_AT_ONCE, count - first)
        some = False
        for k in range(lights):
            lit[k] = clear[k, first : first + number].any()
            some |= lit[k]
        if some:
            _fill_frames(rows, references, form, first, number, frames)
            towards[:], boxes[lights, 0], boxes[lights, 1] = 0.0, np.inf, -np.inf
            for k in range(lights):
                if lit[k]:
                    _fill_rays(frames, vector_at(grid, k), panel, weight, clear, k, first, number, rays, boxes, towards)
            for t in range(len(varied)):
                normal, lobe = vector_at(lean, t), lobe_of_width(form, inverse[t])
                least_chord = farthest_exponent(most[t], lobe) / inverse[t]
                # of a row's slice the compiler knows that no index counts from the end: it takes several at once
                own = varied[t, first : first + number]
                # Lambert's light is linear in the normal where all that arrives is above the horizon
                above, shiny = is_lambert(diffuse) and _extreme(normal, boxes, lights, 0) > 0.0, False
                for k in range(lights):
                    shiny |= lit[k] and 2.0 - 2.0 * _extreme(normal, boxes, k, 1) <= least_chord + 1e-9
                if above and not shiny:
                    _fill_products(normal, R_d[t], towards, own)
                else:
                    variant = normal, R_d[t], R_s[t], diffuse, lobe, least_chord
                    _fill_variant(rays, boxes, lit, frames, variant, sums, own)
        else:
            varied[:, first : first + number] = 0.0


@kernel
def _extreme(normal: Vector, boxes: Float64, k: int, most: int) -> float:
    # bound of the product of a normal with the vectors in a box: the least, or the greatest
    x = normal.x * boxes[k, most if normal.x > 0.0 else 1 - most, 0]
    y = normal.y * boxes[k, most if normal.y > 0.0 else 1 - most, 1]
    return x + y + normal.z * boxes[k, most if normal.z > 0.0 else 1 - most, 2]


@kernel
def _fill_products(normal: Vector, R_d: float, towards: Float64, varied: Levels) -> None:
    for j in range(len(varied)):
        varied[j] = R_d * dot(normal, _vector(towards, 0, j))


@kernel
def _vector(rows: Float64, row: int, j: int) -> Vector:
    return Vector(rows[row * _AT_ONCE + j], rows[(row + 1) * _AT_ONCE + j], rows[(row + 2) * _AT_ONCE + j])


@kernel
def _ray_vector(rays: Float64, k: int, row: int, j: int) -> Vector:
    return Vector(rays[k, row * _AT_ONCE + j], rays[k, (row + 1) * _AT_ONCE + j], rays[k, (row + 2) * _AT_ONCE + j])


@kernel
def _lobe_in_frame(lobe: Lobe, frames: Float64, j: int, normal: Vector) -> Lobe:
    # the lobe of point j, of a normal in its frame
    if lobe.widening == 1.0:
        return lobe
    return lobe_beside(lobe_across(lobe, _vector(frames, 18, j)), normal)


@kernel
def _fill_frames(rows: PointRows, references: Float64, form: Lobe, first: int, number: int, frames: Float64) -> None:
    # three rows each: points, normals n, references r, n × r, views, and in the frames (n, r, n × r) the views and what
    # a lobe has across the brushing
    points, surface_frames, views, _, _ = rows
    for j in range(number):
        for axis in range(3):
            frames[axis * _AT_ONCE + j] = points[first + j, axis]
            frames[(3 + axis) * _AT_ONCE + j] = surface_frames[first + j, axis]
            frames[(6 + axis) * _AT_ONCE + j] = references[first + j, axis]
            frames[(12 + axis) * _AT_ONCE + j] = views[first + j, axis]
    for j in range(number):
        n, r, v = _vector(frames, 3, j), _vector(frames, 6, j), _vector(frames, 12, j)
        a = cross(n, r)
        frames[9 * _AT_ONCE + j], frames[10 * _AT_ONCE + j], frames[11 * _AT_ONCE + j] = a
        own = Vector(dot(n, v), dot(r, v), dot(a, v))
        frames[15 * _AT_ONCE + j], frames[16 * _AT_ONCE + j], frames[17 * _AT_ONCE + j] = own
        if form.widening > 1.0 and surface_frames.shape[1] == 6:
            i = first + j
            across = Vector(surface_frames[i, 3], surface_frames[i, 4], surface_frames[i, 5])
            own = Vector(dot(n, across), dot(r, across), dot(a, across))
            frames[18 * _AT_ONCE + j], frames[19 * _AT_ONCE + j], frames[20 * _AT_ONCE + j] = own


@kernel
def _fill_rays(
    frames: Float64,
    q: Vector,
    panel: PanelNumbers,
    weight: float,
    clear: Bool,
    k: int,
    first: int,
    number: int,
    rays: Float64,
    boxes: Float64,
    towards: Float64,
) -> None:
    # towards point light k, in the frames of the points: three rows each of directions and of half vectors, then the
    # light that arrives, and its sum times the directions; and the least and the greatest of each component of the
    # half vectors, and of the directions to all lights, of the points that it arrives at
    for j in range(number):
        light = minus(q, _vector(frames, 0, j))
        r2 = dot(light, light)
        light = scaled(light, 1.0 / math.sqrt(r2))
        half = plus(light, _vector(frames, 12, j))
        h = 1.0 / math.sqrt(dot(half, half))
        n, r, a = _vector(frames, 3, j), _vector(frames, 6, j), _vector(frames, 9, j)
        rays[k, j], rays[k, _AT_ONCE + j], rays[k, 2 * _AT_ONCE + j] = dot(n, light), dot(r, light), dot(a, light)
        own = Vector(dot(n, half) * h, dot(r, half) * h, dot(a, half) * h)
        rays[k, 3 * _AT_ONCE + j], rays[k, 4 * _AT_ONCE + j], rays[k, 5 * _AT_ONCE + j] = own
        rays[k, 6 * _AT_ONCE + j], rays[k, 7 * _AT_ONCE + j] = r2, dot(panel.outward, light)
    own_clear = clear[k, first : first + number]
    for j in range(number):
        arriving = attenuated(weight, panel, rays[k, 6 * _AT_ONCE + j], rays[k, 7 * _AT_ONCE + j])
        rays[k, 6 * _AT_ONCE + j] = arriving if own_clear[j] else 0.0
    for row in range(6):
        low, high = np.inf, -np.inf
        for j in range(number):
            arrives, component = rays[k, 6 * _AT_ONCE + j] > 0.0, rays[k, row * _AT_ONCE + j]
            low, high = min(low, component if arrives else np.inf), max(high, component if arrives else -np.inf)
        boxes[k, 0, row % 3], boxes[k, 1, row % 3] = low, high
        if row < 3:
            boxes[len(rays), 0, row] = min(boxes[len(rays), 0, row], low)
            boxes[len(rays), 1, row] = max(boxes[len(rays), 1, row], high)
    for axis in range(3):
        for j in range(number):
            towards[axis * _AT_ONCE + j] += rays[k, 6 * _AT_ONCE + j] * rays[k, axis * _AT_ONCE + j]


@kernel
def _fill_variant(
    rays: Float64,
    boxes: Float64,
    lit: Bool,
    frames: Float64,
    variant: tuple[Vector, float, float, DiffuseForm, Lobe, float],
    sums: Float64,
    varied: Levels,
) -> None:
    # levels of a variant, by its normal, R_d, R_s, form of diffuse light, lobe and the least |N − H|² without a lobe.
    # Rows of `sums`: diffuse and specular light, N·V, and |N − H|², infinite where there is no lobe
    number = len(varied)
    normal, R_d, R_s, diffuse, lobe, least_chord = variant
    for j in range(number):
        sums[j] = sums[_AT_ONCE + j] = 0.0
        sums[2 * _AT_ONCE + j] = dot(normal, _vector(frames, 15, j))
    for k in range(len(rays)):
        if not lit[k]:
            continue
        if is_lambert(diffuse):
            for j in range(number):
                sums[j] += rays[k, 6 * _AT_ONCE + j] * lambert(dot(normal, _ray_vector(rays, k, 0, j)))
        else:
            for j in range(number):
                light = _ray_vector(rays, k, 0, j)
                l_dot_v = dot(light, _vector(frames, 15, j))
                term = diffuse_term(dot(normal, light), sums[2 * _AT_ONCE + j], l_dot_v, diffuse)
                sums[j] += rays[k, 6 * _AT_ONCE + j] * term
        if 2.0 - 2.0 * _extreme(normal, boxes, k, 1) > least_chord + 1e-9:
            continue
        some = 0
        for j in range(number):
            n_dot_l, arriving = dot(normal, _ray_vector(rays, k, 0, j)), rays[k, 6 * _AT_ONCE + j]
            # |N − H|² of unit vectors; in float64 it is off by 1e-16 where it is 1e-6 and more that matter
            chord = max(0.0, 2.0 - 2.0 * dot(normal, _ray_vector(rays, k, 3, j)))
            near = (arriving > 0.0) & (n_dot_l > 0.0) & (sums[2 * _AT_ONCE + j] > 0.0) & (chord < least_chord)
            sums[3 * _AT_ONCE + j] = chord if near else np.inf
            some += near
        all_at_once = lobe.plain and some > _LEAST_SHARE * number
        if all_at_once:
            for j in range(number):
                chord = sums[3 * _AT_ONCE + j]
                value = narrow_gaussian(min(chord, NARROW_CHORD_SQUARED), lobe.inverse)
                sums[_AT_ONCE + j] += rays[k, 6 * _AT_ONCE + j] * value if chord < NARROW_CHORD_SQUARED else 0.0
        if some > 0 and (not all_at_once or least_chord > NARROW_CHORD_SQUARED):
            for j in range(number):
                chord = sums[3 * _AT_ONCE + j]
                if chord < np.inf and not (all_at_once and chord < NARROW_CHORD_SQUARED):
                    own = _lobe_in_frame(lobe, frames, j, normal)
                    value = specular_lobe(chord, square_across(minus(normal, _ray_vector(rays, k, 3, j)), own), lobe)
                    if not lobe.plain:
                        # N·L + N·V = (N·H)·|L + V|
                        light = _ray_vector(rays, k, 0, j)
                        n_dot_l = dot(normal, light)
                        size = (n_dot_l + sums[2 * _AT_ONCE + j]) / (1.0 - 0.5 * chord)
                        value *= light_factor(n_dot_l, square_across(light, own), size, lobe)
                    sums[_AT_ONCE + j] += rays[k, 6 * _AT_ONCE + j] * value
    for j in range(number):
        across = square_across(_vector(frames, 15, j), _lobe_in_frame(lobe, frames, j, normal))
        specular = R_s * sums[_AT_ONCE + j] / specular_divisor(sums[2 * _AT_ONCE + j], across, lobe)
        varied[j] = R_d * sums[j] + specular
