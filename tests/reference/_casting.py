"""Möller–Trumbore against every triangle.

Rays of one call share their origin (pinhole or point light), so that the triple products of the method become
matrix products; nothing else is clever.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BLOCK = 100_000  # ray-triangle pairs in flight: what a processor's cache has room for


def _edges(triangles):
    return triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]


def _pairs(origin, directions, triangles):
    """Yield (slice of rays, t, u, v, crossed) of blocks of rays; t in lengths of the direction."""
    v0, e1, e2 = _edges(triangles)
    offset = origin - v0
    det_by = np.cross(e2, e1)  # D·(e2 × e1) = e1·(D × e2)
    u_by = np.cross(e2, offset)  # D·(e2 × T) = T·(D × e2)
    v_by = np.cross(offset, e1)  # D·(T × e1)
    t_top = np.einsum("ij,ij->i", e2, v_by)  # e2·(T × e1)
    step = max(1, BLOCK // max(1, len(triangles)))
    for start in range(0, len(directions), step):
        block = slice(start, start + step)
        d = directions[block]
        det = d @ det_by.T
        with np.errstate(divide="ignore", invalid="ignore"):
            u, v, t = (d @ u_by.T) / det, (d @ v_by.T) / det, t_top / det
            crossed = (det != 0) & (u >= -1e-12) & (v >= -1e-12) & (u + v <= 1 + 1e-12) & (t > 0)
        yield block, t, u, v, crossed


def closest(origin, directions, triangles):
    """Face (-1: none), distance and barycentric u, v of the first triangle each ray meets, on either side."""
    n = len(directions)
    face, t_hit = np.full(n, -1), np.full(n, np.inf)
    u_hit, v_hit = np.zeros(n), np.zeros(n)
    for block, t, u, v, crossed in _pairs(origin, directions, triangles):
        t = np.where(crossed, t, np.inf)
        best = np.argmin(t, axis=1)
        rows = np.arange(len(t))
        found = np.isfinite(t[rows, best])
        face[block] = np.where(found, best, -1)
        t_hit[block] = t[rows, best]
        u_hit[block] = np.where(found, u[rows, best], 0)
        v_hit[block] = np.where(found, v[rows, best], 0)
    return face, t_hit, u_hit, v_hit


def blocked(light, points, triangles):
    """Whether a triangle crosses the open segment from a point light to each of the points (N, 3)."""
    result = np.zeros(len(points), dtype=bool)
    for block, t, _, _, crossed in _pairs(light, points - light, triangles):
        result[block] = (crossed & (t < 1)).any(axis=1)
    return result


def crossed_between(point, targets, triangles):
    """How many triangles cross the open segments from a point to each of the targets (N, 3)."""
    result = np.zeros(len(targets), dtype=int)
    for block, t, _, _, crossed in _pairs(point, targets - point, triangles):
        result[block] = (crossed & (t < 1)).sum(axis=1)
    return result


@dataclass(frozen=True)
class Hits:
    """What the rays of a camera meet: one entry per ray; black where `face` is -1 or `back`."""

    face: np.ndarray
    back: np.ndarray
    distance: np.ndarray
    point: np.ndarray
    normal: np.ndarray  # interpolated
    geometric: np.ndarray  # of the face, by its winding
    view: np.ndarray  # unit, towards the camera

    @property
    def front(self):
        return (self.face >= 0) & ~self.back

    def __getitem__(self, rays):
        return Hits(**{name: getattr(self, name)[rays] for name in self.__dataclass_fields__})


def trace(camera, triangles, normals, pixels=None):
    """Cast the rays of a camera through pixel coordinates (default: every pixel centre, row by row)."""
    pixels = camera.pixel_centres() if pixels is None else pixels
    directions = camera.directions(pixels)
    face, t, u, v = closest(camera.position, directions, triangles)
    weights = np.stack([1 - u - v, u, v], axis=1)[:, :, None]
    point = (triangles[face] * weights).sum(axis=1)
    normal = (normals[face] * weights).sum(axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    _, e1, e2 = _edges(triangles[face])
    geometric = np.cross(e1, e2)
    geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
    back = np.einsum("ij,ij->i", geometric, -directions) <= 0
    return Hits(face, back & (face >= 0), t, point, normal, geometric, -directions)
