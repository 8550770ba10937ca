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
from lightopt.core.vectors import Vector, divided, dot, length, minus, plus, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, PanelNumbers, SurfaceLight, panel_grid, panel_numbers, panel_point
from lightopt.optics import LAMBERT, DiffuseForm, Lobe, Reflectance, lobe_at
from lightopt.rendering._converged_panel import channel_groups, converged_panel
from lightopt.rendering._panel_quadrature import (
    NO_LOBE,
    WHOLE_PANEL,
    mirror_point,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._point_lights import point_terms
from lightopt.rendering._surface import SurfacePoints
from lightopt.rendering._surface_light import least_deflection, light_of_channels

_CHUNK = 8192


@dataclass(frozen=True, kw_only=True)
class LightLayer:
    """Light of one panel at n surface points that see all of it.

    surface: The points, part frame
    diffuse: Per unit of R_d, shape (n,)
    form: Of the diffuse light
    deflection: About the least angle δ between the normal and the half vectors of the panel's points [rad], shape (n,):
        nothing narrower than this reaches the camera as a highlight
    grid: The panel's point lights [mm], shape (m, 3); none of them for the converged panel
    nodes: Gauss–Legendre nodes a side that the converged panel needs for its fall-off and emission; 0 with point lights
    """

    surface: SurfacePoints
    light: PanelLight
    diffuse: Float64
    form: DiffuseForm
    deflection: Float64
    grid: Float64
    nodes: int

    def take(self, index: Index) -> LightLayer:
        """The points at `index`, shape (j,)."""
        return replace(
            self, surface=self.surface.take(index), diffuse=self.diffuse[index], deflection=self.deflection[index]
        )

    def specular(self, reflectance: Reflectance, *, threads: int | None = None) -> Float64:
        """Specular light per unit of R_s, whatever R_s is, shape (n,) (paper, equations 3 and 4)."""
        if isinstance(self.light, SurfaceLight):
            return light_of_channels(self.surface, [self.light], reflectance, diffuse=False, threads=threads)[1][0]
        panel, lobe = panel_numbers(self.light), reflectance.lobe
        s = self.surface
        result = np.zeros(len(s))

        def chunk(start: int) -> None:
            end = min(start + _CHUNK, len(s))
            _specular(s.points, s.frames, s.views, self.grid, panel, lobe, self.nodes, start, end, result)

        in_threads(chunk, range(0, len(s), _CHUNK), threads)
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
            same = [i for i in left if np.array_equal(layers[i].surface.points, first.surface.points)]
            lights = [light for i in same if isinstance(light := layers[i].light, SurfaceLight)]
            if lights:
                levels = light_of_channels(first.surface, lights, reflectance, diffuse=False, threads=threads)[1]
                found |= dict(zip(same, levels, strict=True))
            else:
                found[left[0]] = first.specular(reflectance, threads=threads)
            left = [i for i in left if i not in found]
    return [found[i] for i in range(len(layers))]


def light_layer(
    surface: SurfacePoints, light: PanelLight, caster: RayCaster, *, form: DiffuseForm, threads: int | None = None
) -> LightLayer:
    """The diffuse layer of a panel, and what its specular layers need.

    surface: Points that see the whole panel, part frame
    light: Part frame; with its own number of points
    caster: Of the part, whose bounding sphere the diffuse quadrature is chosen for
    form: Of the diffuse light
    """
    if isinstance(light, SurfaceLight):
        (diffuse,), _ = light_of_channels(surface, [light], form, threads=threads)
        none = np.zeros((0, 3))
        return LightLayer(
            surface=surface,
            light=light,
            diffuse=diffuse,
            form=form,
            deflection=least_deflection(surface, light),
            grid=none,
            nodes=0,
        )
    panel = panel_numbers(light)
    if light.points == "auto":
        converged = converged_panel(light, centre=caster.centre, radius=caster.radius)
        grid, nodes = np.zeros((0, 3)), converged.nodes
    else:
        grid, nodes = panel_grid(light, light.points), 0
    diffuse = np.zeros(len(surface))
    deflection = np.zeros(len(surface))

    geometry = surface.points, surface.normals, surface.views

    def chunk(start: int) -> None:
        end = min(start + _CHUNK, len(surface))
        _diffuse_and_deflection(*geometry, grid, panel, form, nodes, start, end, diffuse, deflection)

    in_threads(chunk, range(0, len(surface), _CHUNK), threads)
    diffuse *= light.total_weight
    return LightLayer(
        surface=surface, light=light, diffuse=diffuse, form=form, deflection=deflection, grid=grid, nodes=nodes
    )


@kernel
def _specular(
    points: Float64,
    frames: Float64,
    views: Float64,
    grid: Float64,
    panel: PanelNumbers,
    lobe: Lobe,
    panel_nodes: int,
    start: int,
    end: int,
    result: Float64,
) -> None:
    for i in range(start, end):
        p, n, v = vector_at(points, i), vector_at(frames, i), vector_at(views, i)
        if out_of_reach(p, n, v, panel, lobe):
            continue
        n_dot_v, turned = dot(n, v), lobe_at(lobe, frames, i)
        if len(grid) == 0:
            result[i] = rectangle_specular(p, n, v, n_dot_v, panel, WHOLE_PANEL, turned, panel_nodes)
            continue
        total = 0.0
        for k in range(len(grid)):
            _, s = point_terms(p, n, v, n_dot_v, vector_at(grid, k), panel, turned, LAMBERT)
            total += s
        result[i] = total / len(grid)


@kernel
def _diffuse_and_deflection(
    points: Float64,
    normals: Float64,
    views: Float64,
    grid: Float64,
    panel: PanelNumbers,
    form: DiffuseForm,
    panel_nodes: int,
    start: int,
    end: int,
    diffuse: Float64,
    deflection: Float64,
) -> None:
    for i in range(start, end):
        p, n, v = vector_at(points, i), vector_at(normals, i), vector_at(views, i)
        deflection[i] = _deflection(p, n, v, panel)
        if len(grid) == 0:
            diffuse[i] = rectangle_diffuse(p, n, v, panel, WHOLE_PANEL, form, panel_nodes)
            continue
        total = 0.0
        for k in range(len(grid)):
            d, _ = point_terms(p, n, v, 0.0, vector_at(grid, k), panel, NO_LOBE, form)
            total += d
        diffuse[i] = total / len(grid)


@kernel
def _deflection(p: Vector, n: Vector, v: Vector, panel: PanelNumbers) -> float:
    # at the place of the panel nearest to the mirrored view
    s, t = mirror_point(p, n, v, dot(n, v), panel)
    s, t = min(max(s, -0.5), 0.5), min(max(t, -0.5), 0.5)
    light = minus(panel_point(panel, s, t), p)
    half = plus(divided(light, length(light)), v)
    chord = length(minus(n, divided(half, length(half))))
    return 2.0 * math.asin(min(1.0, 0.5 * chord))
