"""A panel of very many points, added up one by one: slow, plain, and what ``points: auto`` has to meet."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, panel_grid
from lightopt.optics import MIN_COS_VIEW, Reflectance
from lightopt.rendering import SurfacePoints

Float64 = NDArray[np.float64]

RAYS_AT_ONCE = 1_000_000


@dataclass(frozen=True)
class ManyPoints:
    """Points on a panel [mm], shape (m, 3), and their weights, which add up to the panel's; part frame."""

    positions: Float64
    weights: Float64


def equally_spaced(light: PanelLight, side: int) -> ManyPoints:
    """The grid of side² cell centres with equal weights: what m = side² means."""
    return ManyPoints(panel_grid(light, side**2), np.full(side**2, light.total_weight / side**2))


def gauss_legendre(light: PanelLight, side: int) -> ManyPoints:
    """The Gauss–Legendre product rule of side² points: exact to many digits where the whole panel is seen."""
    x, w = np.polynomial.legendre.leggauss(side)
    across = (0.5 * x * light.size[0])[None, :, None] * light.across
    along = (0.5 * x * light.size[1])[:, None, None] * light.along
    weights = 0.25 * w[:, None] * w[None, :] * light.total_weight
    return ManyPoints((light.centre + across + along).reshape(-1, 3), weights.ravel())


def sum_of_points(
    surface: SurfacePoints, panel: ManyPoints, *, reflectance: Reflectance, caster: RayCaster, threads: int
) -> tuple[Float64, NDArray[np.bool_]]:
    """Level of each surface point under a panel of points [grey level], and whether it is in a penumbra.

    In a penumbra a part of the panel is seen and another, above the interpolated horizon, is hidden by the mesh.
    Without fall-off and emission, as in the case that is measured.
    """
    level = np.zeros(len(surface))
    crossed = np.zeros(len(surface), np.bool_)
    step = max(1, RAYS_AT_ONCE // len(panel.weights))

    def block(start: int) -> None:
        some = surface.take(np.arange(start, min(start + step, len(surface)), dtype=np.intp))
        above, facing = _facing(some.points, some.normals, some.facets, some.front, panel.positions)
        point, target = (index.astype(np.int32) for index in np.nonzero(facing))
        blocked = caster.occluded(some.points, some.facets, panel.positions, point_index=point, target_index=target)
        visible = facing
        visible[point[blocked], target[blocked]] = False
        own = slice(start, start + len(some))
        level[own] = _add_up(
            some.points,
            some.normals,
            some.views,
            visible,
            panel.positions,
            panel.weights,
            reflectance.R_d,
            reflectance.R_s,
            reflectance.sigma,
        )
        crossed[own] = visible.any(axis=1) & (above & ~visible).any(axis=1)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, range(0, len(surface), step)))
    return level, crossed


@numba.njit(nogil=True, cache=True)
def _facing(
    points: Float64, normals: Float64, facets: Float64, front: NDArray[np.bool_], targets: Float64
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    # whether each target is above the interpolated horizon, and whether it is above the face's own plane, too
    above = np.zeros((len(points), len(targets)), np.bool_)
    facing = np.zeros((len(points), len(targets)), np.bool_)
    for i in range(len(points)):
        for k in range(len(targets)):
            height = plane = 0.0
            for a in range(3):
                towards = targets[k, a] - points[i, a]
                height += normals[i, a] * towards
                plane += facets[i, a] * towards
            above[i, k] = front[i] and height > 0.0
            facing[i, k] = above[i, k] and plane > 0.0
    return above, facing


@numba.njit(nogil=True, cache=True)
def _add_up(
    points: Float64,
    normals: Float64,
    views: Float64,
    visible: NDArray[np.bool_],
    targets: Float64,
    weights: Float64,
    R_d: float,
    R_s: float,
    sigma: float,
) -> Float64:
    level = np.zeros(len(points))
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        vx, vy, vz = views[i, 0], views[i, 1], views[i, 2]
        cos_view = nx * vx + ny * vy + nz * vz
        gain = R_s / max(cos_view, MIN_COS_VIEW) if cos_view > 0.0 else 0.0
        total = 0.0
        for k in range(len(targets)):
            if not visible[i, k]:
                continue
            lx, ly, lz = targets[k, 0] - px, targets[k, 1] - py, targets[k, 2] - pz
            r = math.sqrt(lx * lx + ly * ly + lz * lz)
            lx, ly, lz = lx / r, ly / r, lz / r
            hx, hy, hz = lx + vx, ly + vy, lz + vz
            h = math.sqrt(hx * hx + hy * hy + hz * hz)
            chord = math.sqrt((nx - hx / h) ** 2 + (ny - hy / h) ** 2 + (nz - hz / h) ** 2)
            term = R_d * (nx * lx + ny * ly + nz * lz)  # equation (2)
            if chord < 12.0 * sigma:  # beyond, e⁻⁷² of the lobe
                delta = 2.0 * math.asin(min(1.0, 0.5 * chord))
                term += gain * math.exp(-0.5 * (delta / sigma) ** 2)  # equation (3)
            total += weights[k] * term
        level[i] = total
    return level
