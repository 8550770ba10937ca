"""The place of a mesh's surface that is nearest to a point."""

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.geometry._triangle_mesh import TriangleMesh


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfacePlace:
    """A place on a mesh."""

    point: Float64  # [mm], shape (3,), frame of the mesh
    normal: Float64  # unit normal there as shading has it: interpolated, or the facet's, shape (3,)
    face: int


def surface_place(mesh: TriangleMesh, face: int, u: float, v: float) -> SurfacePlace:
    """The place (1−u−v)·A + u·B + v·C of a face."""
    corners = mesh.faces[face]
    weights = np.array([1.0 - u - v, u, v])
    a, b, c = mesh.vertices[corners]
    normal = np.zeros(3) if mesh.normals is None else weights @ mesh.normals[corners]
    if math.hypot(*normal) <= 1e-12:
        normal = np.cross(b - a, c - a)
    return SurfacePlace(point=weights @ mesh.vertices[corners], normal=normal / np.linalg.norm(normal), face=face)


class SurfaceFinder:
    """Finds the place of a mesh that is nearest to a point; centres and radii of its faces are computed once."""

    def __init__(self, mesh: TriangleMesh) -> None:
        self._mesh = mesh
        corners = mesh.vertices[mesh.faces]
        self._middles: Float64 = corners.mean(axis=1)
        self._radii: Float64 = np.sqrt(((corners - self._middles[:, None]) ** 2).sum(axis=2).max(axis=1))

    def nearest(self, point: Float64) -> SurfacePlace:
        """The place nearest to a point [mm], shape (3,), frame of the mesh.

        The nearest place of a triangle is one inside, the foot of the perpendicular, or one of its three sides
        (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5).
        """
        offset = self._middles - point
        distance = np.sqrt(np.einsum("ij,ij->i", offset, offset))
        # a face has no place nearer than its middle less its radius, and its middle is one of them
        near = np.flatnonzero(distance - self._radii <= distance.min())
        faces = self._mesh.faces[near]
        a, b, c = (self._mesh.vertices[faces[:, k]] for k in range(3))
        weights = np.concatenate([_on_sides(a, b, c, point), _inside(a, b, c, point)])
        places = np.einsum("skw,wkj->skj", weights, np.stack([a, b, c]))
        off = np.linalg.norm(places - point, axis=2)
        kind, k = np.unravel_index(int(np.argmin(off)), off.shape)
        _, u, v = weights[kind, k]
        return surface_place(self._mesh, int(near[k]), float(u), float(v))


def _on_sides(a: Float64, b: Float64, c: Float64, point: Float64) -> Float64:
    # barycentric coordinates of the nearest place of each side, shape (3, k, 3)
    result = np.zeros((3, len(a), 3))
    for side, (start, end) in enumerate(((a, b), (b, c), (c, a))):
        run = end - start
        square = np.einsum("ij,ij->i", run, run)
        share = np.einsum("ij,ij->i", point - start, run) / np.where(square > 0.0, square, 1.0)
        share = np.clip(share, 0.0, 1.0)
        result[side, :, side] = 1.0 - share
        result[side, :, (side + 1) % 3] = share
    return result


def _inside(a: Float64, b: Float64, c: Float64, point: Float64) -> Float64:
    # barycentric coordinates of the foot of the perpendicular, or of corner A where it is outside; shape (1, k, 3)
    p, q, w = b - a, c - a, point - a
    n = np.cross(p, q)
    square = np.einsum("ij,ij->i", n, n)
    safe = np.where(square > 0.0, square, 1.0)
    v = np.einsum("ij,ij->i", np.cross(p, w), n) / safe
    u = np.einsum("ij,ij->i", np.cross(w, q), n) / safe
    inside = (square > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    return np.stack([1.0 - u - v, u, v], axis=1)[None]
