"""Light that the part's lobe throws on the part, where diffuse reflection shows it: caustics.

Rays of a diffuse point hardly ever meet the small mirror image of a lamp. So this light is followed from the other end:
from places all over the part, lit by places all over a light, along directions of the lobe, to where it lands. How
densely it lands is the irradiance (Jensen 1996, doi:10.1007/978-3-7091-7484-5_3). Places follow an additive sequence:
nothing is random.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Float64, Index, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import end_if_stopped, in_threads
from lightopt.core.vectors import dot, length, minus, vector_at
from lightopt.geometry import Hits, face_areas, resolve_hits
from lightopt.lights import PanelLight, PanelNumbers, SurfaceLight, attenuated, panel_numbers, panel_point
from lightopt.optics import DiffuseForm, diffuse_term
from lightopt.rendering._converged_panel import ConvergedPanel
from lightopt.rendering._interreflection import PartLight, lobe_rays
from lightopt.rendering._surface import SurfacePoints, surface_at
from lightopt.rendering._surface_light import all_diffuse_nodes
from lightopt.scene import PinholeCamera, pixel_directions, project

LEAST_RAYS, MOST_RAYS = 1 << 15, 1 << 18  # of a light
STRATA = 1024  # of the part's area, of which those that throw much light on the part get more rays
EXPLORING = 4  # one of so many rays looks for these
LEAST_DENSITY = 0.25  # of rays in the others, in the mean density
WINDOWS = (1, 3, 5, 9, 17, 33, 65)  # rows and columns of samples whose light is taken together
ENOUGH = 24  # rays in a window, by their light
FOOTPRINTS = 2.0  # of a sample, within which light that lands belongs to it
_RAYS_AT_ONCE = 1 << 15
_STEPS = 1.1127756842787055 ** -np.arange(1.0, 7.0)  # g⁷ = g + 1 (Roberts 2018)
_LEAST_COSINE = 0.02  # of light to the face, by which that to the normal is divided


@dataclass(frozen=True)
class LandedLight:
    """What landed on the part under one light, k rays, part frame."""

    points: Float64  # [mm], shape (k, 3)
    facets: Float64  # unit normals of the faces there, shape (k, 3)
    light: Float64  # diffuse level times the area that shows it [grey level · mm²], shape (k,)


def landed_light(part: PartLight, eye: Float64, rays: int, threads: int | None = None) -> list[LandedLight]:
    """Where the light of each light lands, by about so many rays for each.

    eye: That looks at it, part frame [mm], shape (3,)
    """
    R_d, R_s = (max(getattr(own, name) for own in part.scene.reflectances) for name in ("R_d", "R_s"))
    if part.scene.bounces == 0 or R_d * R_s == 0.0:
        return []
    ends = np.concatenate([[0.0], np.cumsum(face_areas(part.scene.mesh))])
    rays = min(max(rays, LEAST_RAYS), MOST_RAYS)
    return [_landed(part, light, eye, ends, rays, threads) for light in part.lights]


def _landed(
    part: PartLight, light: PanelLight | ConvergedPanel, eye: Float64, ends: Float64, rays: int, threads: int | None
) -> LandedLight:
    share = np.full(STRATA, 1.0 / STRATA)
    first, stratum = _followed(part, light, eye, ends, share, rays // EXPLORING, threads)
    # the light of rays that are as dense as the root of its mean square varies least
    found = np.sqrt(np.convolve(np.bincount(stratum, first.light**2, STRATA), np.ones(3), mode="same"))
    if not found.any():
        return first
    share = LEAST_DENSITY * share + (1.0 - LEAST_DENSITY) * found / found.sum()
    return _followed(part, light, eye, ends, share, rays, threads)[0]


def _followed(
    part: PartLight,
    light: PanelLight | ConvergedPanel,
    eye: Float64,
    ends: Float64,
    share: Float64,
    rays: int,
    threads: int | None,
) -> tuple[LandedLight, Index]:
    # light of so many rays, of which each stratum of the area gets a share, and the strata that it comes from
    before = np.concatenate([[0.0], np.cumsum(share)])

    def chunk(start: int) -> tuple[Float64, Float64, Float64, Index]:
        end_if_stopped()
        number = np.arange(start, min(start + _RAYS_AT_ONCE, rays))
        at = (number + 0.5) / rays
        stratum = np.clip(np.searchsorted(before, at, "right") - 1, 0, STRATA - 1)
        area = ends[-1] / STRATA * (stratum + (at - before[stratum]) / share[stratum])
        face = np.clip(np.searchsorted(ends, area, "right") - 1, 0, len(ends) - 2).astype(np.int32)
        places = 0.5 + _STEPS[:, None] * number
        places -= np.floor(places)
        weight = ends[-1] / (STRATA * share[stratum] * rays)
        points, facets, landed, ray = _thrown(part, light, eye, face, weight, places)
        return points, facets, landed, stratum[ray]

    parts = in_threads(chunk, range(0, rays, _RAYS_AT_ONCE), threads)
    points, facets, landed, stratum = (np.concatenate(some) for some in zip(*parts, strict=True))
    return LandedLight(points, facets, landed), stratum


def _thrown(
    part: PartLight, light: PanelLight | ConvergedPanel, eye: Float64, face: Int32, weight: Float64, places: Float64
) -> tuple[Float64, Float64, Float64, Index]:
    # points, facets and light of what lands, and by which of the rays. places: in the unit cube, shape (6, rays)
    mesh = part.scene.mesh
    u, v = np.sqrt(places[0]) * (1.0 - places[1]), np.sqrt(places[0]) * places[1]
    points = np.zeros((len(face), 3))
    for corner, share in zip(mesh.faces.take(face, axis=0).T, (1.0 - u - v, u, v), strict=True):
        points += share[:, None] * mesh.vertices.take(corner, axis=0)
    lamps, shining = _lamps(light, points, places[2], places[3])
    begins = Hits(np.arange(len(face), dtype=np.int32), face, u, v, points, np.zeros(len(face)))
    surface = surface_at(begins, mesh, lamps, outside=False)
    lit = np.flatnonzero(surface.front & (shining != 0.0))
    surface = surface.take(lit)
    ways, gathered = np.zeros((len(lit), 3)), np.zeros(len(lit))
    for index, some, own in surface.by_material(part.scene.reflectances):
        u, turn = places[4, lit][index], places[5, lit][index]
        ways[index], light_along = lobe_rays(some.rows, own.lobe, np.arange(len(some)), u, turn)
        gathered[index] = own.R_s * light_along
    # the lobe gathers light along a ray as it throws light the other way, but for Lambert's cosine
    cosine = np.einsum("ij,ij->i", surface.normals, surface.views)
    thrown = weight[lit] * shining[lit] * cosine * gathered
    kept = np.flatnonzero(thrown != 0.0)
    surface, ways, thrown, ray = surface.take(kept), ways[kept], thrown[kept], lit[kept]
    met = part.caster.next_hit(surface.points, surface.facets, ways)
    if part.blocker is not None:
        index = np.flatnonzero(met >= 0).astype(np.int32)
        hidden = part.blocker.occluded(
            surface.points, surface.facets, lamps[ray], point_index=index, target_index=index
        )
        met[index[hidden]] = -1
    hits = resolve_hits(met, surface.points, ways, mesh.vertices, mesh.faces)
    other = surface_at(hits, mesh, surface.points[hits.ray], outside=False)
    # per area of the face, of which the normal is that of shading
    steep = np.einsum("ij,ij->i", other.facets, other.views)
    shown = np.zeros(len(other))
    towards = eye - other.points
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    for index, some, own in other.by_material(part.scene.reflectances):
        shown[index] = own.R_d * _diffuse_terms(some.normals, some.views, towards[index], own.diffuse)
    shown *= other.front / (np.maximum(steep, _LEAST_COSINE) * math.pi * part.white)
    return hits.points, other.facets, thrown[hits.ray] * shown, ray[hits.ray]


@kernel
def _diffuse_terms(normals: Float64, lights: Float64, views: Float64, form: DiffuseForm) -> Float64:
    # of unit vectors towards what throws light and towards the eye, shape (k,)
    found = np.zeros(len(normals))
    for i in range(len(normals)):
        n, towards, v = vector_at(normals, i), vector_at(lights, i), vector_at(views, i)
        found[i] = diffuse_term(dot(n, towards), dot(n, v), dot(towards, v), form)
    return found


def _lamps(
    light: PanelLight | ConvergedPanel, points: Float64, first: Float64, second: Float64
) -> tuple[Float64, Float64]:
    # a place on a light for each point [mm], and its weight there, for which the mean is the light's
    if isinstance(light, ConvergedPanel):
        light = light.light
    elif light.points != "auto":
        k = math.isqrt(light.points)
        first, second = (np.floor(first * k) + 0.5) / k, (np.floor(second * k) + 0.5) / k
    if not isinstance(light, SurfaceLight):
        lamps, weights = _panel_places(panel_numbers(light), points, first, second)
        return lamps, light.total_weight * weights
    nodes, shining, weights = all_diffuse_nodes(light.elements, light.pattern)
    shining = shining * np.einsum("b,mbk->mk", light.pattern.terms[:, 0], weights)[..., None]
    nodes, shining = nodes.reshape(-1, 3), shining.reshape(-1, 3)
    strength = np.linalg.norm(shining, axis=1)
    ends = np.cumsum(strength / strength.sum())
    chosen = np.clip(np.searchsorted(ends, first, "right"), 0, len(ends) - 1)
    towards = nodes[chosen] - points
    r2 = np.einsum("ij,ij->i", towards, towards)
    facing = np.maximum(0.0, -np.einsum("ij,ij->i", shining[chosen], towards)) / (r2 * np.sqrt(r2))
    return nodes[chosen], light.total_weight * facing * (strength.sum() / strength[chosen])


@kernel
def _panel_places(panel: PanelNumbers, points: Float64, s: Float64, t: Float64) -> tuple[Float64, Float64]:
    places, weights = np.empty((len(points), 3)), np.empty(len(points))
    for i in range(len(points)):
        q = panel_point(panel, s[i] - 0.5, t[i] - 0.5)
        towards = minus(q, vector_at(points, i))
        r = length(towards)
        places[i, 0], places[i, 1], places[i, 2] = q
        weights[i] = attenuated(1.0, panel, r * r, dot(panel.outward, towards) / r)
    return places, weights


def caustic_levels(
    landed: list[LandedLight],
    camera: PinholeCamera,
    surface: SurfacePoints,
    at: Int32,
    first: tuple[float, float],
    spacing: float,
) -> Float64:
    """Diffuse levels that the landed light of each light adds to a grid of samples, shape (lights, k).

    surface: k points, part frame
    at: Number of each sample's point, −1 where there is none, shape (rows, columns)
    first: Column and row of the first sample [px]
    spacing: Of the samples [px]
    """
    areas, reach = footprints(camera, surface, at, first, spacing)
    image, seen = np.zeros(at.shape), at >= 0
    image[seen] = areas[at[seen]]
    around = [blurred(image, window) for window in WINDOWS]
    levels = np.zeros((len(landed), len(surface)))
    for own, light in zip(levels, landed, strict=True):
        column, row, depth = project(camera, light.points)
        x, y = np.rint((column - first[0]) / spacing), np.rint((row - first[1]) / spacing)
        index = np.flatnonzero((depth > 0.0) & (x >= 0) & (x < at.shape[1]) & (y >= 0) & (y < at.shape[0]))
        cell = y[index].astype(np.intp) * at.shape[1] + x[index].astype(np.intp)
        # of those that meet the part
        index, cell = index[at.ravel()[cell] >= 0], cell[at.ravel()[cell] >= 0]
        point = at.ravel()[cell]
        away = np.linalg.norm(light.points[index] - surface.points[point], axis=1)
        alike = np.einsum("ij,ij->i", light.facets[index], surface.facets[point]) > 0.0
        kept = np.flatnonzero(alike & (away <= reach[point]))
        index, cell = index[kept], cell[kept]
        image_light, squares = np.zeros(at.shape), np.zeros(at.shape)
        np.add.at(image_light.ravel(), cell, light.light[index])
        np.add.at(squares.ravel(), cell, light.light[index] ** 2)
        own[at[seen]] = np.where(image > 0.0, _spread(around, image_light, squares), 0.0)[seen]
    return levels


def footprints(
    camera: PinholeCamera, surface: SurfacePoints, at: Int32, first: tuple[float, float], spacing: float
) -> tuple[Float64, Float64]:
    """Area of the surface that each sample shows [mm²], 0 at backs, and how far from it light is still its own [mm].

    Parameters as in :func:`caustic_levels`; shape (k,) each
    """
    y, x = np.nonzero(at >= 0)
    column, row = (start + spacing * a.astype(np.float64) for start, a in zip(first, (x, y), strict=True))
    half = 0.5 * spacing
    ways = [
        pixel_directions(camera, column + half * right, row + half * down)
        for right, down in ((-1, 0), (1, 0), (0, -1), (0, 1))
    ]
    ways = [way / np.linalg.norm(way, axis=1)[:, None] for way in ways]
    own = at[y, x]
    angle = np.linalg.norm(np.cross(ways[1] - ways[0], ways[3] - ways[2]), axis=1)
    towards = camera.position - surface.points[own]
    cosine = np.einsum("ij,ij->i", surface.views[own], surface.facets[own])
    across = angle * np.einsum("ij,ij->i", towards, towards)
    areas, reach = np.zeros(len(surface)), np.zeros(len(surface))
    areas[own] = np.where(surface.front[own], across / np.maximum(cosine, _LEAST_COSINE), 0.0)
    reach[own] = FOOTPRINTS * np.sqrt(across) / np.maximum(cosine, _LEAST_COSINE)
    return areas, reach


def _spread(areas: Sequence[Float64], light: Float64, squares: Float64) -> Float64:
    # levels of samples, over which light is spread as far around each as enough rays are, so that its sum is kept;
    # areas: means over each of the windows
    whole = np.zeros(light.shape)
    lit = ndimage.find_objects((light != 0.0).astype(np.uint8))
    if not lit:
        return whole
    box = tuple(slice(max(0, side.start - WINDOWS[-1]), side.stop + WINDOWS[-1]) for side in lit[0])
    light, squares, levels = light[box], squares[box], whole[box]
    left = light != 0.0
    for window, area in zip(WINDOWS, areas, strict=True):
        total, off = (blurred(image, window) * window**2 for image in (light, squares))
        own = left if window == WINDOWS[-1] else left & (total**2 >= ENOUGH * off)
        if own.any():
            share = np.zeros(light.shape)
            share[own] = light[own] / area[box][own]
            levels += blurred(share, window)
            left &= ~own
    return whole


def blurred(image: Float64, window: int) -> Float64:
    """Means over so many rows and columns around each sample, taken twice, where there is nothing outside the image."""
    if window == 1:
        return image
    return ndimage.uniform_filter(ndimage.uniform_filter(image, window, mode="constant"), window, mode="constant")
