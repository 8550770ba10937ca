"""What the camera sees of the part: surface points with normals and view directions, in the part's frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Index, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, cross, divided, dot, length, minus, vector_at
from lightopt.geometry import Hits, RayCaster, TriangleMesh, resolve_hits
from lightopt.scene import PinholeCamera, pixel_directions

Of = TypeVar("Of")

GRAZING_DEG = 80.0
"""Surface that is seen at more than this angle to its normal is left out of every score and share [°].

A pixel's footprint there is six times as long as where the surface faces the camera, and more: it mixes with its
neighbours', and an error of the placement by a pixel shows another place of the part. A nearly vertical wall can make
up a quarter of the area that is seen and a pixel or two of the image; whether its patches are seen at all changes with
the mesh. It is left out of pixels whose light is predicted, of patches that are scored, and of the surface that an
inspection covers."""

GRAZING_COSINE = math.cos(math.radians(GRAZING_DEG))
"""Cosine of :data:`GRAZING_DEG`: a place with a smaller cosine between normal and view is seen at a grazing angle."""


class PointRows(NamedTuple):
    """Surface points in the form that kernels take; arrays as :class:`SurfacePoints` has them."""

    points: Float64
    frames: Float64
    views: Float64
    facets: Float64
    front: Bool


class SurfacePoint(NamedTuple):
    """One of them: p [mm], unit normal n, unit view direction v, cosθ_o, and the unit normal of its own face.

    The face hides what is below its own plane; n itself where that does not matter.
    """

    p: Vector
    n: Vector
    v: Vector
    n_dot_v: float
    facet: Vector


@kernel
def surface_point(p: Vector, n: Vector, v: Vector) -> SurfacePoint:
    return SurfacePoint(p, n, v, dot(n, v), n)


@kernel
def point_at(points: Float64, frames: Float64, views: Float64, i: int) -> SurfacePoint:
    return surface_point(vector_at(points, i), vector_at(frames, i), vector_at(views, i))


@dataclass(frozen=True)
class SurfacePoints:
    """Points of the surface that a camera looks at, k of them, part frame."""

    points: Float64  # [mm], shape (k, 3)
    normals: Float64  # interpolated unit normals N that shading uses, shape (k, 3)
    facets: Float64  # unit geometric normals of the faces, shape (k, 3)
    views: Float64  # unit vectors V towards the camera, shape (k, 3)
    front: Bool  # False where the camera sees the back of a face, which is black; shape (k,)
    outside: bool = False  # whether the camera stands outside the part's bounding sphere
    material: UInt8 | None = None  # number of the reflectance of each, shape (k,); None: one reflectance, number 0
    # unit tangents across the brushing, 0 where it has no direction, shape (k, 3); None: nothing is brushed
    across: Float64 | None = None

    @cached_property
    def frames(self) -> Float64:
        """The normals, and of a brushed surface the unit tangents across its brushing; shape (k, 3) or (k, 6)."""
        if self.across is None:
            return self.normals
        # of normals that lean, the brushing leans with the surface
        part = np.einsum("ij,ij->i", self.normals, self.across)[:, None]
        aside = self.across - part * self.normals
        size = np.linalg.norm(aside, axis=1, keepdims=True)
        return np.concatenate([self.normals, aside / np.where(size > 0.0, size, 1.0)], axis=1)

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: Index | slice) -> SurfacePoints:
        """The points at `index`, shape (j,), or those of a slice, which are not copied."""
        if isinstance(index, slice) or np.asarray(index).dtype == np.bool_:
            return self._mapped(lambda _, value: value[index])
        return self._mapped(lambda _, value: value.take(index, axis=0))  # quicker than by brackets

    @classmethod
    def joined(cls, parts: Sequence[SurfacePoints]) -> SurfacePoints:
        """The points of one or more surfaces of a part, one after the other."""
        return parts[0]._mapped(lambda name, _: np.concatenate([getattr(part, name) for part in parts]))

    def _mapped(self, work: Callable[[str, NDArray[Any]], NDArray[Any]]) -> SurfacePoints:
        # with arrays that are made from the name and the value of each
        arrays = {
            name: value for name, value in vars(self).items() if isinstance(value, np.ndarray) and name != "frames"
        }
        return replace(self, **{name: work(name, value) for name, value in arrays.items()})

    @property
    def rows(self) -> PointRows:
        """In the form that kernels take."""
        return PointRows(self.points, self.frames, self.views, self.facets, self.front)

    def by_material(self, belonging: Sequence[Of]) -> Iterator[tuple[Index | slice, SurfacePoints, Of]]:
        """Indices of the points of each material, these points, and what belongs to it; none without points."""
        if self.material is None:
            yield slice(None), self, belonging[0]
            return
        for number in np.unique(self.material).tolist():
            index = np.flatnonzero(self.material == number)
            yield index, self.take(index), belonging[number]


def trace_hits(
    caster: RayCaster,
    mesh: TriangleMesh,
    camera: PinholeCamera,
    columns: Float64,
    rows: Float64,
    *,
    neighbours: bool = False,
) -> Hits:
    """Where camera rays through image points meet the part; parameters as in :func:`trace_samples`."""
    directions = pixel_directions(camera, columns, rows)
    face = caster.first_hit(camera.position, directions, neighbours=neighbours)
    hits = resolve_hits(face, camera.position, directions, mesh.vertices, mesh.faces)
    if camera.obstructions is None:
        return hits
    face[hits.ray[hidden_by(camera.obstructions, camera.position, hits.points)]] = -1
    return resolve_hits(face, camera.position, directions, mesh.vertices, mesh.faces)


def hidden_by(triangles: Float64, eye: Float64, points: Float64) -> Bool:
    """Whether triangles hide points from a place, shape (n,).

    triangles: Their corners [mm], shape (t, 3, 3)
    eye: Place that the points are seen from [mm], shape (3,)
    points: [mm], shape (n, 3)
    """
    faces = np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)
    vertices, towards = triangles.reshape(-1, 3), points - eye
    met = RayCaster(vertices, faces, rays=len(points)).first_hit(eye, towards)
    before = resolve_hits(met, eye, towards, vertices, faces)
    hidden = np.zeros(len(points), np.bool_)
    hidden[before.ray] = before.distance < np.linalg.norm(towards[before.ray], axis=1)
    return hidden


def trace_samples(
    caster: RayCaster,
    mesh: TriangleMesh,
    camera: PinholeCamera,
    columns: Float64,
    rows: Float64,
    *,
    neighbours: bool = False,
) -> tuple[Hits, SurfacePoints]:
    """Cast camera rays through image points and describe the surface where they meet the part.

    caster, mesh: The part, in its own frame
    camera: Part frame
    columns, rows: Image points [px], shape (n,)
    neighbours: Whether points that follow each other are close to each other: they are then traced together
    """
    hits = trace_hits(caster, mesh, camera, columns, rows, neighbours=neighbours)
    return hits, surface_at(hits, mesh, camera.position, outside=caster.is_outside(camera.position))


def surface_at(hits: Hits, mesh: TriangleMesh, eyes: Float64, *, outside: bool) -> SurfacePoints:
    """The surface where rays meet it.

    eyes: Where the rays come from [mm], a common place of shape (3,), or one for each hit, shape (k, 3)
    outside: Whether they come from outside the part's bounding sphere, or from points that were seen from there
    """
    smooth = mesh.normals if mesh.normals is not None else np.zeros((0, 3))
    found = _interpolate(mesh.vertices, mesh.faces, smooth, hits, np.atleast_2d(eyes))
    material = None if mesh.material is None else mesh.material[hits.face]
    across = mesh.across_brushing(hits.points, found[0], hits.face)
    return SurfacePoints(hits.points, *found, outside=outside, material=material, across=across)


@kernel
def _interpolate(
    vertices: Float64, faces: Int32, vertex_normals: Float64, hits: Hits, eyes: Float64
) -> tuple[Float64, Float64, Float64, Bool]:
    # normals, those of the facets, directions to the eyes, and whether these are in front
    _, face, u, v, points, _ = hits
    k = len(face)
    normals, facets, views, front = np.empty((k, 3)), np.empty((k, 3)), np.empty((k, 3)), np.empty(k, np.bool_)
    for i in range(k):
        a, b, c = faces[face[i], 0], faces[face[i], 1], faces[face[i], 2]
        corner = vector_at(vertices, a)
        facet = cross(minus(vector_at(vertices, b), corner), minus(vector_at(vertices, c), corner))
        facet = divided(facet, length(facet))
        view = minus(vector_at(eyes, i if len(eyes) > 1 else 0), vector_at(points, i))
        view = divided(view, length(view))
        normal = facet
        if len(vertex_normals) > 0:
            w = 1.0 - u[i] - v[i]
            na, nb, nc = vector_at(vertex_normals, a), vector_at(vertex_normals, b), vector_at(vertex_normals, c)
            mean = Vector(
                w * na.x + u[i] * nb.x + v[i] * nc.x,
                w * na.y + u[i] * nb.y + v[i] * nc.y,
                w * na.z + u[i] * nb.z + v[i] * nc.z,
            )
            size = length(mean)
            if size > 1e-12:
                normal = divided(mean, size)
        normals[i, 0], normals[i, 1], normals[i, 2] = normal
        facets[i, 0], facets[i, 1], facets[i, 2] = facet
        views[i, 0], views[i, 1], views[i, 2] = view
        front[i] = dot(facet, view) > 0.0
    return normals, facets, views, front
