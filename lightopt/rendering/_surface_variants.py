"""A surface tried as several others at once: with its normal leaning, or another reflectance, in the same shadows.

What a defect would make of each point: it stays where it is, sees what it would see and is in the shadows that it
would be in; only normal, R_d, R_s and σ are others, as in :mod:`lightopt.rendering._defect_shading`. Rays are cast
once for all variants: towards every light that the facet faces, since a leaning wall may face one that the surface
does not.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped
from lightopt.core.vectors import cross, dot, minus, plus, scaled, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, PanelNumbers, attenuated, panel_grid, panel_numbers
from lightopt.optics import (
    MIN_COS_VIEW,
    NARROW_CHORD_SQUARED,
    Reflectance,
    lambert,
    narrow_specular_lobe,
    specular_cosine,
    specular_lobe,
)
from lightopt.rendering._converged_panel import (
    ConvergedPanel,
    classify_probes,
    panel_probes,
    probe_targets,
    shade_converged,
)
from lightopt.rendering._converged_variants import VariantNumbers, panel_variants
from lightopt.rendering._point_lights import PAIRS_AT_ONCE, clear_targets, point_terms
from lightopt.rendering._surface import SurfacePoints

# surface points under a converged panel that are shaded at once: some 0.1 s, the longest that Ctrl-C waits
CONVERGED_AT_ONCE = 1 << 13

# lobes are left out of variants where they are nowhere more than this [grey level]: 0.26 of a level of 16 bits
NEGLIGIBLE_LEVEL = 1e-3

# share of variants near the lobe from which on all lobes are computed at once, and not one by one
_LEAST_SHARE = 0.25


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfaceVariants:
    """What each point of a surface is tried as, t ways.

    lean: Components of each variant's normal along the point's normal, its reference direction and the direction
        across, which with the first two makes a right-handed frame; shape (t, 3)
    R_d, R_s, sigma: Of each, shape (t,)
    """

    lean: Float64
    R_d: Float64
    R_s: Float64
    sigma: Float64


@dataclass(frozen=True, eq=False, kw_only=True)
class VariantLevels:
    """Light of a panel from k surface points [grey level].

    plain: Of the surface as it is, as :func:`lightopt.rendering.shade_points` or ``shade_converged`` has it, float32,
        shape (k,)
    good: The same for comparison with the variants, in penumbrae from the same cells of the panel; shape (k,)
    varied: Of the variants, shape (k, t)
    """

    plain: Float32
    good: Float64
    varied: Float64


def surface_variants(
    *, slope: Float64, direction: Float64, R_d_factor: Float64, sigma_factor: Float64, reflectance: Reflectance
) -> SurfaceVariants:
    """Variants of a reflectance by slope and direction of the lean [rad] and factors, each of shape (t,)."""
    changed = [
        reflectance.changed(R_d_factor=float(d), sigma_factor=float(s))
        for d, s in zip(R_d_factor, sigma_factor, strict=True)
    ]
    lean = [np.cos(slope), np.sin(slope) * np.cos(direction), np.sin(slope) * np.sin(direction)]
    return SurfaceVariants(
        lean=np.stack(lean, axis=1),
        R_d=np.array([one.R_d for one in changed]),
        R_s=np.array([one.R_s for one in changed]),
        sigma=np.array([one.sigma for one in changed]),
    )


def shade_variants(
    surface: SurfacePoints,
    references: Float64,
    panel: PanelLight | ConvergedPanel,
    variants: SurfaceVariants,
    *,
    reflectance: Reflectance,
    caster: RayCaster | None,
) -> VariantLevels:
    """The light of a panel on a surface and on its variants.

    surface: k points that the camera sees from the front, none of them another's neighbour; part frame
    references: Unit vectors in the tangent planes that directions count from, shape (k, 3)
    panel: Part frame: as point lights, or converged
    """

    def shade(start: int, end: int) -> VariantLevels:
        end_if_stopped()
        some, own = surface.take(slice(start, end)), references[start:end]
        if isinstance(panel, ConvergedPanel):
            return _converged_variants(some, own, panel, variants, reflectance, caster)
        return _point_variants(some, own, panel, variants, reflectance, caster)

    if isinstance(panel, ConvergedPanel):
        step = CONVERGED_AT_ONCE
    else:
        assert panel.points != "auto"
        step = max(1, PAIRS_AT_ONCE // panel.points)
    chunks = [shade(start, min(start + step, len(surface))) for start in range(0, len(surface), step)]
    return VariantLevels(
        plain=np.concatenate([chunk.plain for chunk in chunks] or [np.zeros(0, np.float32)]),
        good=np.concatenate([chunk.good for chunk in chunks] or [np.zeros(0)]),
        varied=np.concatenate([chunk.varied for chunk in chunks] or [np.zeros((0, len(variants.lean)))]),
    )


def _float32(reflectance: Reflectance, diffuse: Float64, specular: Float64) -> Float32:
    return (reflectance.R_d * diffuse + reflectance.R_s * specular).astype(np.float32)


def _point_variants(
    surface: SurfacePoints,
    references: Float64,
    light: PanelLight,
    variants: SurfaceVariants,
    reflectance: Reflectance,
    caster: RayCaster | None,
) -> VariantLevels:
    assert light.points != "auto"
    grid = panel_grid(light, light.points)
    if caster is None:
        # nothing is in the way, not even the point's own face
        clear = np.ones((len(grid), len(surface)), np.bool_)
    else:
        # towards every light that the facet faces, whatever the normals
        clear = clear_targets(replace(surface, normals=surface.facets), grid, caster, geometric=False)
    diffuse, specular, varied = _point_kernel(
        surface.points,
        surface.normals,
        references,
        surface.views,
        grid,
        clear,
        panel_numbers(light),
        light.total_weight / light.points,
        0.5 / reflectance.sigma**2,
        VariantNumbers(
            variants.lean,
            variants.R_d,
            variants.R_s,
            0.5 / variants.sigma**2,
            _most_exponents(variants.R_s, light.total_weight, MIN_COS_VIEW),
        ),
    )
    good = reflectance.R_d * diffuse + reflectance.R_s * specular
    return VariantLevels(plain=_float32(reflectance, diffuse, specular), good=good, varied=varied)


def _most_exponents(R_s: Float64, weight: float, least_cosine: float) -> Float64:
    # where the lobe's exponent is more than this, the lobe is negligible for any cosθ_o that is not less
    return np.log(np.maximum(R_s * weight / least_cosine / NEGLIGIBLE_LEVEL, 1.0))


def _converged_variants(
    surface: SurfacePoints,
    references: Float64,
    converged: ConvergedPanel,
    variants: SurfaceVariants,
    reflectance: Reflectance,
    caster: RayCaster | None,
) -> VariantLevels:
    targets = probe_targets(converged.light)
    if caster is None:
        clear = np.ones((len(surface), len(targets)), np.bool_)
        coarse = None
    else:
        clear = panel_probes(surface, targets, caster)
        coarse = classify_probes(surface, targets, clear)
    diffuse, specular, _ = shade_converged(
        surface,
        converged,
        # every second place of a row: no point is another's neighbour
        sample=2 * np.arange(len(surface)),
        shape=(1, 2 * len(surface)),
        reflectance=reflectance,
        caster=caster,
        coarse=coarse,
    )
    total = converged.light.total_weight
    # the surface as it is comes first
    R_s = total * np.concatenate([[reflectance.R_s], variants.R_s])
    numbers = VariantNumbers(
        lean=np.concatenate([[[1.0, 0.0, 0.0]], variants.lean]),
        R_d=total * np.concatenate([[reflectance.R_d], variants.R_d]),
        R_s=R_s,
        inverse=0.5 / np.concatenate([[reflectance.sigma], variants.sigma]) ** 2,
        most=_most_exponents(R_s, 1.0, 1.0),
    )
    levels = panel_variants(surface, references, converged, clear, caster, numbers)
    good, varied = levels[:, 0], levels[:, 1:]
    return VariantLevels(plain=_float32(reflectance, diffuse, specular), good=good, varied=varied)


@kernel
def _point_kernel(
    points: Float64,
    normals: Float64,
    references: Float64,
    views: Float64,
    grid: Float64,
    clear: Bool,
    panel: PanelNumbers,
    weight: float,
    inverse_good: float,
    variants: VariantNumbers,
) -> tuple[Float64, Float64, Float64]:
    lean, R_d, R_s, inverse, most = variants
    count, tries = len(points), len(lean)
    diffuse, specular = np.zeros(count), np.zeros(count)
    varied = np.zeros((count, tries))
    # the processor takes several variants at once in loops without branches over numbers that lie side by side
    c0, c1, c2 = lean[:, 0].copy(), lean[:, 1].copy(), lean[:, 2].copy()
    least_chord = most / inverse
    n_dot_v, n_dot_l, chord = np.empty(tries), np.empty(tries), np.empty(tries)
    d_sums, s_sums, near = np.empty(tries), np.empty(tries), np.empty(tries, np.bool_)
    for i in range(count):
        if not clear[:, i].any():
            continue
        p, n, r, v = (vector_at(points, i), vector_at(normals, i), vector_at(references, i), vector_at(views, i))
        a = cross(n, r)
        v0, v1, v2 = dot(n, v), dot(r, v), dot(a, v)
        for t in range(tries):
            n_dot_v[t] = c0[t] * v0 + c1[t] * v1 + c2[t] * v2
            d_sums[t] = s_sums[t] = 0.0
        d_sum = s_sum = 0.0
        for k in range(len(grid)):
            if not clear[k, i]:
                continue
            q = vector_at(grid, k)
            d, s = point_terms(p, n, v, v0, q, panel, inverse_good)
            d_sum += weight * d
            s_sum += weight * s
            light = minus(q, p)
            r2 = dot(light, light)
            light = scaled(light, 1.0 / math.sqrt(r2))
            half = plus(light, v)
            h = 1.0 / math.sqrt(dot(half, half))
            # components of light and half vector in the point's frame
            l0, l1, l2 = dot(n, light), dot(r, light), dot(a, light)
            h0, h1, h2 = dot(n, half) * h, dot(r, half) * h, dot(a, half) * h
            arriving = attenuated(weight, panel, r2, dot(panel.outward, light))
            for t in range(tries):
                n_dot_l[t] = c0[t] * l0 + c1[t] * l1 + c2[t] * l2
            for t in range(tries):
                d_sums[t] += arriving * lambert(n_dot_l[t])
            for t in range(tries):
                # |N − H|² of unit vectors; in float64 it is off by 1e-16 where it is 1e-6 and more that matter
                chord[t] = max(0.0, 2.0 - 2.0 * (c0[t] * h0 + c1[t] * h1 + c2[t] * h2))
            some = wide = 0
            for t in range(tries):
                near[t] = (n_dot_l[t] > 0.0) & (n_dot_v[t] > 0.0) & (chord[t] < least_chord[t])
                some += near[t]
                wide += near[t] & (chord[t] >= NARROW_CHORD_SQUARED)
            all_at_once = some > _LEAST_SHARE * tries
            if all_at_once:
                for t in range(tries):
                    lobe = arriving * narrow_specular_lobe(min(chord[t], NARROW_CHORD_SQUARED), inverse[t])
                    s_sums[t] += lobe if near[t] & (chord[t] < NARROW_CHORD_SQUARED) else 0.0
            if wide > 0 or (some > 0 and not all_at_once):
                for t in range(tries):
                    if near[t] and not (all_at_once and chord[t] < NARROW_CHORD_SQUARED):
                        s_sums[t] += arriving * specular_lobe(chord[t], inverse[t])
        diffuse[i], specular[i] = d_sum, s_sum
        for t in range(tries):
            varied[i, t] = R_d[t] * d_sums[t] + R_s[t] * s_sums[t] / specular_cosine(n_dot_v[t])
    return diffuse, specular, varied
