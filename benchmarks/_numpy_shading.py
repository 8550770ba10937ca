"""The reflection model in plain NumPy around someone else's ray caster: what one writes without lightopt.

Written to be fast: float32, blocks of pixels on a pool of threads, nothing computed or cast below the horizon.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.lights import panel_grid
from lightopt.optics import MIN_COS_VIEW, Reflectance
from lightopt.scene import PinholeCamera, Scene, pixel_directions, screen_window

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]

BLOCK = 32_768
OFFSET_MM = 1e-3
"""Shadow rays start this far off the surface."""


class Backend(Protocol):
    """A ray caster."""

    def first_hit(self, origin: Float32, directions: Float32) -> tuple[Int32, Float32, Float32]:
        """Face (−1 where none) and barycentric coordinates of each ray's first hit."""
        ...

    def occluded(self, origins: Float32, directions: Float32) -> NDArray[np.bool_]:
        """Whether anything is in the way between each origin and origin + direction."""
        ...


def camera_rays(scene: Scene) -> tuple[NDArray[np.intp], Float32]:
    """Raveled pixel index and direction of the rays that lightopt casts: those of the part's window in the image."""
    camera: PinholeCamera = scene.camera
    left, top, right, bottom = screen_window(camera, scene.mesh)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(left, right), np.arange(top, bottom)))
    directions = pixel_directions(camera, column + 0.5, row + 0.5).astype(np.float32)
    return row * camera.width + column, directions


def render_numpy(scene: Scene, backend: Backend, *, threads: int) -> list[Float32]:
    """One float image per light, shape (height, width) each [grey level]; posture (0, 0), m point lights, shadows."""
    pixels, directions = camera_rays(scene)
    images = [np.zeros((scene.camera.height, scene.camera.width), np.float32) for _ in scene.lights]
    vertices, normals = scene.mesh.vertices.astype(np.float32), scene.mesh.normals
    assert normals is not None
    mesh = (vertices, normals.astype(np.float32), scene.mesh.faces)
    eye = scene.camera.position.astype(np.float32)
    grids = [
        (panel_grid(light, int(light.points)).astype(np.float32), light.total_weight / int(light.points))
        for light in scene.lights
    ]

    def block(start: int) -> None:
        own = slice(start, start + BLOCK)
        face, u, v = backend.first_hit(eye, directions[own])
        hit = np.flatnonzero(face >= 0)
        points, normal, facet = _surface(*mesh, face[hit], u[hit], v[hit])
        view = _unit(eye - points)
        front = _dot(facet, view) > 0.0
        points, normal, facet, view = points[front], normal[front], facet[front], view[front]
        place = pixels[own][hit[front]]
        start_points = points + np.float32(OFFSET_MM) * facet
        for image, (grid, weight) in zip(images, grids, strict=True):
            level = _panel(points, normal, facet, view, start_points, grid, scene.reflectance, backend.occluded)
            image.ravel()[place] = np.float32(weight) * level

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, range(0, len(pixels), BLOCK)))
    return images


def _surface(
    vertices: Float32, normals: Float32, faces: Int32, face: Int32, u: Float32, v: Float32
) -> tuple[Float32, Float32, Float32]:
    a, b, c = faces[face].T
    u, v = u[:, None], v[:, None]
    va, vb, vc = vertices[a], vertices[b], vertices[c]
    facet = _unit(np.cross(vb - va, vc - va))
    normal = _unit((1 - u - v) * normals[a] + u * normals[b] + v * normals[c])
    return (1 - u - v) * va + u * vb + v * vc, normal, facet


def _panel(
    points: Float32,
    normal: Float32,
    facet: Float32,
    view: Float32,
    start_points: Float32,
    grid: Float32,
    reflectance: Reflectance,
    occluded: Callable[[Float32, Float32], NDArray[np.bool_]],
) -> Float32:
    # sum over the point lights of a panel, not yet weighted
    level = np.zeros(len(points), np.float32)
    n_dot_v = _dot(normal, view)
    gain = np.float32(reflectance.R_s) / np.maximum(n_dot_v, np.float32(MIN_COS_VIEW)) * (n_dot_v > 0.0)
    k = np.float32(0.5 / reflectance.sigma**2)
    for q in grid:
        to_light = q - points
        facing = np.flatnonzero((_dot(normal, to_light) > 0.0) & (_dot(facet, to_light) > 0.0))
        lit = facing[~occluded(start_points[facing], q - start_points[facing])]
        light = _unit(to_light[lit])
        n, v = normal[lit], view[lit]
        chord = n - _unit(light + v)
        delta = 2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(_dot(chord, chord)), np.float32(1.0)))
        level[lit] += np.float32(reflectance.R_d) * _dot(n, light) + gain[lit] * np.exp(-k * delta * delta)
    return level


def _dot(a: Float32, b: Float32) -> Float32:
    return np.einsum("ij,ij->i", a, b)


def _unit(a: Float32) -> Float32:
    return a / np.sqrt(_dot(a, a))[:, None]
