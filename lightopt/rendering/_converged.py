"""``points: auto``: the panel as the continuous surface it is.

Per pixel and light five rays, to the panel's corners and centre, tell lit from shaded. Where they agree among
themselves and with those of the neighbouring pixels, the panel is wholly visible or wholly hidden; the penumbrae that
remain are worked out by :mod:`lightopt.rendering._penumbra`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.kernels import kernel
from lightopt.raycast import RayCaster
from lightopt.reflectance import Reflectance
from lightopt.rendering._cells import HORIZON_NODES
from lightopt.rendering._lobe import (
    gauss_legendre_table,
    out_of_reach,
    rectangle_diffuse,
    rectangle_specular,
)
from lightopt.rendering._panel import PanelNumbers, panel_numbers
from lightopt.rendering._penumbra import PenumbraLight, shade_penumbra
from lightopt.rendering._points import facing_pairs
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import PanelLight

__all__ = ["ConvergedPanel", "converged_panel", "shade_converged"]

Float64 = NDArray[np.float64]

DIFFUSE_TOLERANCE = 2e-4
"""Error of the diffuse quadrature per unit of R_d: 0.05 level of 255."""

PROBE_INSET = 0.98
"""The rays to the corners go this far from the panel's centre towards them."""

PENUMBRA_BATCH = 2048
"""Penumbra pixels that are worked on at once: some 10 MiB of rays."""

# what the coarse rays of a pixel and a light say
_DARK, _CLEAR, _HIDDEN, _MIXED = 0, 1, 2, 3


@dataclass(frozen=True)
class ConvergedPanel:
    """A panel with the quadrature that it needs for a part.

    Attributes
    ----------
    light
        The panel, part frame.
    nodes
        Gauss–Legendre nodes a side for diffuse light.
    rules
        From :func:`gauss_legendre_table`.
    """

    light: PanelLight
    nodes: int
    rules: tuple[Float64, Float64]


def converged_panel(light: PanelLight, *, centre: Float64, radius: float) -> ConvergedPanel:
    """Choose the diffuse quadrature of a panel by trying it on surface points all over a part.

    Parameters
    ----------
    light
        Part frame.
    centre, radius
        Sphere around the part, part frame [mm].
    """
    panel = panel_numbers(light)
    nodes, weights = gauss_legendre_table()
    towards = light.centre - centre
    towards = towards / np.linalg.norm(towards)
    positions = [centre + radius * np.array(d) for d in itertools.product((-0.57, 0.57), repeat=3)]
    tilts = [towards, towards + 1.5 * light.across, towards + 1.5 * light.along]
    normals = [tilt / np.linalg.norm(tilt) for tilt in tilts]
    for count in (2, 3, 4, 6, 8, 12, 16, 20):
        error = max(
            abs(
                rectangle_diffuse(p, n, n, panel, -0.5, 0.5, -0.5, 0.5, count, nodes, weights)
                - rectangle_diffuse(p, n, n, panel, -0.5, 0.5, -0.5, 0.5, 24, nodes, weights)
            )
            for p in positions
            for n in normals
        )
        if error <= DIFFUSE_TOLERANCE:
            break
    return ConvergedPanel(light, count, (nodes, weights))


def shade_converged(
    surface: SurfacePoints,
    converged: ConvergedPanel,
    *,
    sample: NDArray[np.intp],
    shape: tuple[int, int],
    reflectance: Reflectance,
    caster: RayCaster | None,
) -> tuple[Float64, Float64]:
    """Diffuse and specular light of a whole panel, per unit of R_d and R_s; two arrays of shape (k,).

    Parameters
    ----------
    surface
        k surface points, part frame.
    converged
        The panel and its quadrature.
    sample
        Index of each point in the raveled grid of image samples that was traced, shape (k,): shadows are refined where
        neighbours in this grid disagree.
    shape
        Rows and columns of that grid; the grid's own border has no neighbours beyond it.
    reflectance
        Its σ shapes the lobe; how finely penumbrae are worked out depends on R_d and R_s, too.
    caster
        For shadows; None for none.
    """
    panel = panel_numbers(converged.light)
    inverse = 0.5 / reflectance.sigma**2
    nodes, weights = converged.rules
    if caster is None:
        verdict = np.where(surface.front, _CLEAR, _DARK).astype(np.uint8)
        uncertain = np.zeros(len(surface), np.bool_)
    else:
        verdict = _coarse_verdict(surface, converged.light, caster)
        uncertain = _disagreeing(verdict, sample, shape)
    diffuse, specular = _whole_panel(
        surface.points,
        surface.normals,
        surface.views,
        verdict,
        panel,
        converged.nodes,
        inverse,
        nodes,
        weights,
    )
    total = converged.light.total_weight
    if caster is not None:
        light = PenumbraLight(
            panel, total * reflectance.R_d, total * reflectance.R_s, inverse, converged.rules
        )
        looked_at = np.zeros(len(surface), np.bool_)
        while uncertain.any():
            penumbra = np.zeros(len(surface), np.bool_)
            index = np.flatnonzero(uncertain)
            for start in range(0, len(index), PENUMBRA_BATCH):
                batch = index[start : start + PENUMBRA_BATCH]
                some = surface.take(batch)
                diffuse[batch], specular[batch], penumbra[batch] = shade_penumbra(some, light, caster)
            # a penumbra goes on until its neighbours, too, see the whole panel or none of it
            looked_at |= uncertain
            uncertain = _neighbours(penumbra, sample, shape) & ~looked_at & (verdict != _DARK)
    return total * diffuse, total * specular


def _coarse_verdict(surface: SurfacePoints, light: PanelLight, caster: RayCaster) -> NDArray[np.uint8]:
    half = 0.5 * PROBE_INSET
    targets = np.array(
        [
            light.centre + s * light.size[0] * light.across + t * light.size[1] * light.along
            for s, t in ((0.0, 0.0), (-half, -half), (-half, half), (half, -half), (half, half))
        ]
    )
    point, target = facing_pairs(surface, targets, geometric=True)
    blocked = caster.occluded(surface.points, surface.facets, targets, point_index=point, target_index=target)
    clear = np.bincount(point[~blocked], minlength=len(surface))
    # a point above the interpolated horizon but below the face's own plane is hidden by the face itself
    above, _ = facing_pairs(surface, targets, geometric=False)
    all_above = np.bincount(above, minlength=len(surface))
    verdict = np.full(len(surface), _MIXED, np.uint8)
    verdict[clear == 0] = _HIDDEN
    verdict[clear == all_above] = _CLEAR
    verdict[all_above == 0] = _DARK
    return verdict


def _disagreeing(
    verdict: NDArray[np.uint8], sample: NDArray[np.intp], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    # points whose rays disagree among themselves or with those of a neighbouring sample
    near_clear = _neighbours((verdict == _CLEAR) | (verdict == _MIXED), sample, shape)
    near_hidden = _neighbours((verdict == _HIDDEN) | (verdict == _MIXED), sample, shape)
    return near_clear & near_hidden & (verdict != _DARK)


def _neighbours(
    flags: NDArray[np.bool_], sample: NDArray[np.intp], shape: tuple[int, int]
) -> NDArray[np.bool_]:
    # whether any of the 3 × 3 samples around each point is flagged
    grid = np.zeros((shape[0] + 2, shape[1] + 2), np.bool_)
    inner = grid[1:-1, 1:-1]
    inner[np.unravel_index(sample, shape)] = flags
    near = np.zeros(shape, np.bool_)
    for dy, dx in itertools.product(range(3), repeat=2):
        near |= grid[dy : dy + shape[0], dx : dx + shape[1]]
    return near.ravel()[sample]


@kernel
def _whole_panel(
    points: Float64,
    normals: Float64,
    views: Float64,
    verdict: NDArray[np.uint8],
    panel: PanelNumbers,
    diffuse_nodes: int,
    inverse_two_sigma_squared: float,
    nodes: Float64,
    weights: Float64,
) -> tuple[Float64, Float64]:
    diffuse = np.zeros(len(points))
    specular = np.zeros(len(points))
    for i in range(len(points)):
        if verdict[i] != _CLEAR:
            continue
        p, n, v = points[i], normals[i], views[i]
        least, most = _horizon(p, n, panel)
        if most <= 0.0:
            continue
        count = diffuse_nodes if least > 0.0 else HORIZON_NODES
        diffuse[i] = rectangle_diffuse(p, n, v, panel, -0.5, 0.5, -0.5, 0.5, count, nodes, weights)
        n_dot_v = n[0] * v[0] + n[1] * v[1] + n[2] * v[2]
        if out_of_reach(p, n, v, panel, inverse_two_sigma_squared):
            continue
        specular[i] = rectangle_specular(
            p, n, v, n_dot_v, panel, -0.5, 0.5, -0.5, 0.5, inverse_two_sigma_squared, nodes, weights
        )
    return diffuse, specular


@kernel
def _horizon(p: Float64, n: Float64, panel: PanelNumbers) -> tuple[float, float]:
    # height of the panel's lowest and highest corner above the surface's tangent plane
    middle = n[0] * (panel.centre_x - p[0]) + n[1] * (panel.centre_y - p[1]) + n[2] * (panel.centre_z - p[2])
    across = n[0] * panel.across_x + n[1] * panel.across_y + n[2] * panel.across_z
    along = n[0] * panel.along_x + n[1] * panel.along_y + n[2] * panel.along_z
    half = 0.5 * (abs(across) + abs(along))
    return middle - half, middle + half
