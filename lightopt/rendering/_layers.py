"""The light of a panel at chosen surface points, per unit of R_d and R_s: what a fit tries reflectances on.

The rays are cast before; a specular layer for another σ costs the lobe's integral over the panel at the points that it
can reach, and nothing else.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.geometry import RayCaster
from lightopt.rendering._converged import converged_panel
from lightopt.rendering._lobe import (
    gauss_legendre_table,
    mirror_point,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._panel import PanelNumbers, panel_numbers, terms_at
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import PanelLight, panel_grid

_PIECE = 8192


@dataclass(frozen=True, kw_only=True)
class LightLayer:
    """Light of one panel at n surface points that see all of it.

    Attributes
    ----------
    surface: The points, part frame
    diffuse: Per unit of R_d, shape (n,)
    deflection: About the least angle δ between the normal and the half vectors of the panel's points [rad], shape (n,):
        nothing narrower than this reaches the camera as a highlight
    grid: The panel's point lights [mm], shape (m, 3); none of them for the converged panel
    nodes: Gauss–Legendre nodes a side that the converged panel needs for its fall-off and emission; 0 with point lights
    """

    surface: SurfacePoints
    light: PanelLight
    diffuse: Float64
    deflection: Float64
    grid: Float64
    nodes: int
    rules: tuple[Float64, Float64]

    def take(self, index: Index) -> LightLayer:
        """The points at `index`, shape (j,)."""
        return replace(
            self,
            surface=self.surface.take(index),
            diffuse=self.diffuse[index],
            deflection=self.deflection[index],
        )

    def specular(self, sigma: float, *, threads: int | None = None) -> Float64:
        """Specular light per unit of R_s for a lobe of width σ [rad], shape (n,) (paper, equations 3 and 4)."""
        inverse = 0.5 / sigma**2
        panel = panel_numbers(self.light)
        grid, rules = self.grid, self.rules
        s = self.surface
        result = np.zeros(len(s))

        def piece(start: int) -> None:
            end = min(start + _PIECE, len(s))
            _specular(
                s.points, s.normals, s.views, grid, panel, inverse, self.nodes, *rules, start, end, result
            )

        in_threads(piece, range(0, len(s), _PIECE), threads)
        result *= self.light.total_weight
        return result


def light_layer(
    surface: SurfacePoints, light: PanelLight, caster: RayCaster, *, threads: int | None = None
) -> LightLayer:
    """The diffuse layer of a panel, and what its specular layers need.

    Parameters
    ----------
    surface: Points that see the whole panel, part frame
    light: Part frame; with its own number of points
    caster: Of the part, whose bounding sphere the diffuse quadrature is chosen for
    """
    panel = panel_numbers(light)
    if light.points == "auto":
        converged = converged_panel(light, centre=caster.centre, radius=caster.radius)
        grid, nodes, rules = np.zeros((0, 3)), converged.nodes, converged.rules
    else:
        grid, nodes, rules = panel_grid(light, light.points), 0, gauss_legendre_table()
    diffuse = np.zeros(len(surface))
    deflection = np.zeros(len(surface))

    def piece(start: int) -> None:
        end = min(start + _PIECE, len(surface))
        s = surface
        _diffuse(s.points, s.normals, s.views, grid, panel, nodes, *rules, start, end, diffuse)
        _deflection(s.points, s.normals, s.views, panel, start, end, deflection)

    in_threads(piece, range(0, len(surface), _PIECE), threads)
    diffuse *= light.total_weight
    return LightLayer(
        surface=surface,
        light=light,
        diffuse=diffuse,
        deflection=deflection,
        grid=grid,
        nodes=nodes,
        rules=rules,
    )


@kernel
def _specular(
    points: Float64,
    normals: Float64,
    views: Float64,
    grid: Float64,
    panel: PanelNumbers,
    inverse_two_sigma_squared: float,
    panel_nodes: int,
    nodes: Float64,
    weights: Float64,
    start: int,
    end: int,
    result: Float64,
) -> None:
    for i in range(start, end):
        p, n, v = points[i], normals[i], views[i]
        if out_of_reach(p, n, v, panel, inverse_two_sigma_squared):
            continue
        n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        if len(grid) == 0:
            result[i] = rectangle_specular(
                p,
                n,
                v,
                n_dot_v,
                panel,
                -0.5,
                0.5,
                -0.5,
                0.5,
                inverse_two_sigma_squared,
                panel_nodes,
                nodes,
                weights,
            )
            continue
        total = 0.0
        for k in range(len(grid)):
            _, s = terms_at(
                p, n, v, n_dot_v, grid[k, 0], grid[k, 1], grid[k, 2], panel, inverse_two_sigma_squared
            )
            total += s
        result[i] = total / len(grid)


@kernel
def _diffuse(
    points: Float64,
    normals: Float64,
    views: Float64,
    grid: Float64,
    panel: PanelNumbers,
    count: int,
    nodes: Float64,
    weights: Float64,
    start: int,
    end: int,
    result: Float64,
) -> None:
    for i in range(start, end):
        p, n, v = points[i], normals[i], views[i]
        if len(grid) == 0:
            result[i] = rectangle_diffuse(p, n, v, panel, -0.5, 0.5, -0.5, 0.5, count, nodes, weights)
            continue
        total = 0.0
        for k in range(len(grid)):
            # a view from below (n_dot_v = 0) leaves out the specular term
            d, _ = terms_at(p, n, v, 0.0, grid[k, 0], grid[k, 1], grid[k, 2], panel, 0.0)
            total += d
        result[i] = total / len(grid)


@kernel
def _deflection(
    points: Float64,
    normals: Float64,
    views: Float64,
    panel: PanelNumbers,
    start: int,
    end: int,
    result: Float64,
) -> None:
    for i in range(start, end):
        p, n, v = points[i], normals[i], views[i]
        n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        # the place of the panel nearest to it
        s, t = mirror_point(p, n, v, n_dot_v, panel)
        s, t = min(max(s, -0.5), 0.5), min(max(t, -0.5), 0.5)
        lx = panel.centre_x + s * panel.across_x + t * panel.along_x - p[0]
        ly = panel.centre_y + s * panel.across_y + t * panel.along_y - p[1]
        lz = panel.centre_z + s * panel.across_z + t * panel.along_z - p[2]
        r = math.sqrt(lx * lx + ly * ly + lz * lz)
        hx, hy, hz = lx / r + v[0], ly / r + v[1], lz / r + v[2]
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        dx, dy, dz = n[0] - hx / length, n[1] - hy / length, n[2] - hz / length
        result[i] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(dx * dx + dy * dy + dz * dz)))
