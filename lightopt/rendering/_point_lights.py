"""The panel as m point lights (paper, section 4.1, equation 4)."""

from __future__ import annotations

import math

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped
from lightopt.geometry import RayCaster
from lightopt.optics import MAX_LOBE_EXPONENT, lambert, specular_cosine, specular_lobe
from lightopt.rendering._panel_light import PanelNumbers, attenuated, panel_numbers
from lightopt.rendering._surface import SurfacePoints
from lightopt.rendering._vectors import Vector, dot, minus, plus, scaled, vector_at
from lightopt.scene import PanelLight, panel_grid

PAIRS_AT_ONCE = 1 << 20
"""Pairs of surface point and point light that are shaded at once: some 60 MiB, and 0.2 s that Ctrl-C waits."""


@kernel
def point_terms(
    p: Vector, n: Vector, v: Vector, n_dot_v: float, q: Vector, panel: PanelNumbers, inverse_two_sigma_squared: float
) -> tuple[float, float]:
    """Diffuse and specular terms, per unit of R_d and R_s, of one point light of weight 1 (paper, equations 2 and 3).

    p, n, v: Surface point [mm], its unit normal and unit view direction
    n_dot_v: cosθ_o; 0 leaves the specular term out
    q: The point light [mm], a point of the panel
    inverse_two_sigma_squared: 1/(2σ²) [rad⁻²]
    """
    light = minus(q, p)
    r2 = dot(light, light)
    light = scaled(light, 1.0 / math.sqrt(r2))
    n_dot_l = dot(n, light)
    if n_dot_l <= 0.0:
        return 0.0, 0.0
    weight = attenuated(1.0, panel, r2, dot(panel.outward, light))
    diffuse = weight * lambert(n_dot_l)
    if n_dot_v <= 0.0:
        return diffuse, 0.0
    half = plus(light, v)
    length_squared = dot(half, half)
    # far from the lobe, where most pixels of a glossy part are, not even the square root is needed
    n_dot_h = dot(n, half)
    least_cosine = 1.0 - 0.5 * MAX_LOBE_EXPONENT / inverse_two_sigma_squared
    if least_cosine > 0.0 and (n_dot_h <= 0.0 or n_dot_h * n_dot_h < least_cosine * least_cosine * length_squared):
        return diffuse, 0.0
    chord = minus(n, scaled(half, 1.0 / math.sqrt(length_squared)))
    lobe = specular_lobe(dot(chord, chord), inverse_two_sigma_squared)
    return diffuse, weight * (lobe / specular_cosine(n_dot_v))


def shade_points(
    surface: SurfacePoints, light: PanelLight, *, points: int, sigma: float, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a panel of m points, per unit of R_d and R_s; two arrays of shape (k,).

    light: Part frame
    points: m = k²
    sigma: Of the specular lobe [rad]
    """
    # points are independent of each other: chunks bound the memory whatever m is
    step = max(1, PAIRS_AT_ONCE // points)
    chunks = [
        _shade_chunk(surface.take(np.arange(start, min(start + step, len(surface)))), light, points, sigma, caster)
        for start in range(0, len(surface), step)
    ]
    if len(chunks) == 1:
        return chunks[0]
    empty = [np.zeros(0)]
    return np.concatenate([d for d, _ in chunks] or empty), np.concatenate([s for _, s in chunks] or empty)


def _shade_chunk(
    surface: SurfacePoints, light: PanelLight, points: int, sigma: float, caster: RayCaster | None
) -> tuple[Float64, Float64]:
    end_if_stopped()
    grid = panel_grid(light, points)
    point, target = clear_pairs(surface, grid, caster, geometric=caster is not None)
    return _accumulate(
        surface.points,
        surface.normals,
        surface.views,
        grid,
        point,
        target,
        panel_numbers(light),
        light.total_weight / points,
        0.5 / sigma**2,
    )


def facing_pairs(surface: SurfacePoints, targets: Float64, *, geometric: bool) -> tuple[Int32, Int32]:
    """Pairs (surface point, target) for which light can arrive at all, as two index arrays of the same length.

    surface: k surface points
    targets: Point lights [mm], shape (m, 3)
    geometric: Whether the face's own plane, too, must face the light: below it, the face itself is in the way
    """
    return _facing(surface.points, surface.normals, surface.facets, surface.front, targets, geometric)


def clear_pairs(
    surface: SurfacePoints, targets: Float64, caster: RayCaster | None, *, geometric: bool
) -> tuple[Int32, Int32]:
    """The pairs of :func:`facing_pairs` with nothing in the way; all of them without a caster."""
    point, target = facing_pairs(surface, targets, geometric=geometric)
    if caster is None:
        return point, target
    clear = ~caster.occluded(
        surface.points, surface.facets, targets, point_index=point, target_index=target, outside=surface.outside
    )
    return point[clear], target[clear]


def visible_counts(surface: SurfacePoints, targets: Float64, caster: RayCaster) -> tuple[Index, Index]:
    """How many targets each point sees, and how many are above its interpolated horizon; two arrays of shape (k,).

    A target above that horizon but below the face's own plane is hidden by the face itself.
    """
    point, _ = clear_pairs(surface, targets, caster, geometric=True)
    above, _ = facing_pairs(surface, targets, geometric=False)
    return np.bincount(point, minlength=len(surface)), np.bincount(above, minlength=len(surface))


@kernel
def _facing(
    points: Float64, normals: Float64, facets: Float64, front: Bool, targets: Float64, geometric: bool
) -> tuple[Int32, Int32]:
    point = np.empty(len(points) * len(targets), np.int32)
    target = np.empty(len(points) * len(targets), np.int32)
    count = 0
    for i in range(len(points)):
        if not front[i]:
            continue
        p, n = vector_at(points, i), vector_at(normals, i)
        for k in range(len(targets)):
            light = minus(vector_at(targets, k), p)
            if dot(n, light) <= 0.0:
                continue
            if geometric and dot(vector_at(facets, i), light) <= 0.0:
                continue
            point[count] = i
            target[count] = k
            count += 1
    return point[:count].copy(), target[:count].copy()


@kernel
def _accumulate(
    points: Float64,
    normals: Float64,
    views: Float64,
    targets: Float64,
    point: Int32,
    target: Int32,
    panel: PanelNumbers,
    weight: float,
    inverse_two_sigma_squared: float,
) -> tuple[Float64, Float64]:
    diffuse = np.zeros(len(points))
    specular = np.zeros(len(points))
    for j in range(len(point)):
        i, k = point[j], target[j]
        n, v = vector_at(normals, i), vector_at(views, i)
        q = vector_at(targets, k)
        d, s = point_terms(vector_at(points, i), n, v, dot(n, v), q, panel, inverse_two_sigma_squared)
        diffuse[i] += weight * d
        specular[i] += weight * s
    return diffuse, specular
