"""The light of a panel at chosen surface points, per unit of R_d and R_s: what a fit tries reflectances on.

The rays are cast before; a specular layer for another σ costs the lobe's integral over the panel at the points that it
can reach, and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.core.vectors import divided, length, minus, plus, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, PanelNumbers, SurfaceLight, panel_grid, panel_numbers, panel_point
from lightopt.optics import LAMBERT, DiffuseForm, Reflectance, lobe_at
from lightopt.rendering._converged_panel import channel_groups, converged_panel
from lightopt.rendering._panel_quadrature import (
    NO_LOBE,
    WHOLE_PANEL,
    mirror_point,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._penumbra import ConvergedLight
from lightopt.rendering._point_lights import diffuse_only, point_terms
from lightopt.rendering._surface import PointRows, SurfacePoint, SurfacePoints, point_at
from lightopt.rendering._surface_light import least_deflection, light_of_channels

_CHUNK = 8192


@dataclass(frozen=True, kw_only=True)
class LightLayer:
    """Light of one light at n surface points that see all of it, or some of one that is no panel."""

    surface: SurfacePoints  # the points, part frame
    light: PanelLight
    diffuse: Float64  # per unit of R_d, shape (n,)
    form: DiffuseForm  # of the diffuse light
    # about the least angle δ between the normal and the half vectors of the panel's points [rad], shape (n,): nothing
    # narrower than this reaches the camera as a highlight
    deflection: Float64
    grid: Float64  # the panel's point lights [mm], shape (m, 3); none of them for the converged panel
    # Gauss–Legendre nodes a side that the converged panel needs for its fall-off and emission; 0 with point lights
    nodes: int
    caster: RayCaster | None = None  # of the part where it hides some of the light

    def take(self, index: Index) -> LightLayer:
        """The points at `index`, shape (j,)."""
        return replace(
            self, surface=self.surface.take(index), diffuse=self.diffuse[index], deflection=self.deflection[index]
        )

    def specular(self, reflectance: Reflectance, *, threads: int | None = None) -> Float64:
        """Specular light per unit of R_s, whatever R_s is, shape (n,) (paper, equations 3 and 4)."""
        if isinstance(self.light, SurfaceLight):
            return specular_of_layers([self], reflectance, threads=threads)[0]
        light = ConvergedLight(panel_numbers(self.light), 0.0, 0.0, reflectance.lobe, LAMBERT, self.nodes)
        rows, count = self.surface.rows, len(self.surface)
        result = np.zeros(count)

        def chunk(start: int) -> None:
            _specular(rows, self.grid, light, (start, min(start + _CHUNK, count)), result)

        in_threads(chunk, range(0, count, _CHUNK), threads)
        result *= self.light.total_weight
        return result


def specular_of_layers(
    layers: Sequence[LightLayer], reflectance: Reflectance, *, threads: int | None = None
) -> list[Float64]:
    """As :meth:`LightLayer.specular` of each; channels of one light at the same points are worked out together."""
    found: dict[int, Float64] = {}
    for group in channel_groups([layer.light for layer in layers]):
        left = group
        while left:
            first = layers[left[0]]
            same = [i for i in left if _alike(layers[i], first)]
            lights = [light for i in same if isinstance(light := layers[i].light, SurfaceLight)]
            if lights:
                _, levels = light_of_channels(
                    first.surface, lights, reflectance, diffuse=False, caster=first.caster, threads=threads
                )
                found |= dict(zip(same, levels, strict=True))
            else:
                found[left[0]] = first.specular(reflectance, threads=threads)
            left = [i for i in left if i not in found]
    return [found[i] for i in range(len(layers))]


def _alike(a: LightLayer, b: LightLayer) -> bool:
    # the part may hide some of one channel, and nothing of another, from the same points
    return a.caster is b.caster and np.array_equal(a.surface.points, b.surface.points)


def light_layer(
    surface: SurfacePoints,
    light: PanelLight,
    caster: RayCaster,
    *,
    form: DiffuseForm,
    shadows: bool = False,
    threads: int | None = None,
) -> LightLayer:
    """The diffuse layer of a light, and what its specular layers need.

    surface: Points that see the whole light, part frame
    light: Part frame; with its own number of points
    caster: Of the part, whose bounding sphere the diffuse quadrature is chosen for
    form: Of the diffuse light
    shadows: Whether points see only some of the light, which is no panel
    """
    grid, nodes, (diffuse, deflection) = np.zeros((0, 3)), 0, np.zeros((2, len(surface)))
    layer = LightLayer(
        surface=surface, light=light, diffuse=diffuse, form=form, deflection=deflection, grid=grid, nodes=nodes
    )
    if isinstance(light, SurfaceLight):
        hiding = caster if shadows else None
        (diffuse,), _ = light_of_channels(surface, [light], form, caster=hiding, threads=threads)
        return replace(layer, diffuse=diffuse, deflection=least_deflection(surface, light), caster=hiding)
    if light.points == "auto":
        nodes = converged_panel(light, centre=caster.centre, radius=caster.radius).nodes
    else:
        grid = panel_grid(light, light.points)
    rows, own = surface.rows, ConvergedLight(panel_numbers(light), 0.0, 0.0, NO_LOBE, form, nodes)

    def chunk(start: int) -> None:
        part = start, min(start + _CHUNK, len(surface))
        _diffuse_and_deflection(rows, grid, own, part, diffuse, deflection)

    in_threads(chunk, range(0, len(surface), _CHUNK), threads)
    diffuse *= light.total_weight
    return replace(layer, grid=grid, nodes=nodes)


@kernel
def _specular(rows: PointRows, grid: Float64, light: ConvergedLight, part: tuple[int, int], result: Float64) -> None:
    # of points [start, end)
    points, frames, views, _, _ = rows
    panel, lobe = light.panel, light.lobe
    for i in range(*part):
        at = point_at(points, frames, views, i)
        if out_of_reach(at, panel, lobe):
            continue
        turned = lobe_at(lobe, frames, i)
        if len(grid) == 0:
            result[i] = rectangle_specular(at, panel, WHOLE_PANEL, turned, light.nodes)
            continue
        total = 0.0
        for k in range(len(grid)):
            total += point_terms(at, vector_at(grid, k), panel, turned, LAMBERT)[1]
        result[i] = total / len(grid)


@kernel
def _diffuse_and_deflection(
    rows: PointRows, grid: Float64, light: ConvergedLight, part: tuple[int, int], diffuse: Float64, deflection: Float64
) -> None:
    points, frames, views, _, _ = rows
    panel, form = light.panel, light.form
    for i in range(*part):
        at = point_at(points, frames, views, i)
        deflection[i] = _deflection(at, panel)
        if len(grid) == 0:
            diffuse[i] = rectangle_diffuse(at, panel, WHOLE_PANEL, form, light.nodes)
            continue
        total = 0.0
        for k in range(len(grid)):
            total += point_terms(diffuse_only(at), vector_at(grid, k), panel, light.lobe, form)[0]
        diffuse[i] = total / len(grid)


@kernel
def _deflection(at: SurfacePoint, panel: PanelNumbers) -> float:
    # at the place of the panel nearest to the mirrored view
    s, t = mirror_point(at, panel)
    s, t = min(max(s, -0.5), 0.5), min(max(t, -0.5), 0.5)
    light = minus(panel_point(panel, s, t), at.p)
    half = plus(divided(light, length(light)), at.v)
    chord = length(minus(at.n, divided(half, length(half))))
    return 2.0 * math.asin(min(1.0, 0.5 * chord))
