"""The triangle mesh that everything above casts rays at: places nearest to points, and how it is brushed."""

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from lightopt.core.arrays import Float64, Index, Int32, UInt8, read_only
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.core.vectors import dot, minus, scaled, vector_at

LEAST_SINE = 0.02  # sine of the angle between brushing and normal below which a point has no direction of brushing


class Brushing(Protocol):
    """A field of directions; their lengths and signs do not count."""

    def along(self, points: Float64, face: Int32 | Index, /) -> Float64:
        """Vectors along the brushing at points [mm] of some faces, shape (k, 3); 0 where there is no direction."""
        ...

    def moved(self, rotation: Float64, translation: Float64, /) -> "Brushing":
        """The field of a part after the rigid motion p' = R·p + t."""
        ...


@dataclass(frozen=True, eq=False)
class StraightBrushing:
    """Brushed along a line, as sheet metal is: a direction of shape (3,)."""

    direction: Float64

    def along(self, points: Float64, _face: Int32 | Index) -> Float64:
        return np.broadcast_to(self.direction, points.shape)

    def moved(self, rotation: Float64, _translation: Float64) -> "StraightBrushing":
        return StraightBrushing(rotation @ self.direction)


@dataclass(frozen=True, eq=False)
class RoundBrushing:
    """Brushed around an axis, as turned parts are: a point [mm] and a direction of it, shape (3,) each."""

    point: Float64
    axis: Float64

    def along(self, points: Float64, _face: Int32 | Index) -> Float64:
        # none on the axis itself
        return np.cross(self.axis, points - self.point)

    def moved(self, rotation: Float64, translation: Float64) -> "RoundBrushing":
        return RoundBrushing(rotation @ self.point + translation, rotation @ self.axis)


@dataclass(frozen=True, eq=False)
class CurvedBrushing:
    """Brushed along a curve, as it runs where it is nearest: its corners [mm], shape (n, 3), n ≥ 2.

    At a corner it runs half as before and half as after it, and turns evenly from one corner to the next.
    """

    corners: Float64

    def along(self, points: Float64, _face: Int32 | Index) -> Float64:
        pieces = np.diff(self.corners, axis=0)
        pieces /= np.linalg.norm(pieces, axis=1, keepdims=True)
        at_corners = np.concatenate([pieces[:1], pieces[:-1] + pieces[1:], pieces[-1:]])
        # the curve may turn back on itself
        size = np.linalg.norm(at_corners, axis=1, keepdims=True)
        at_corners /= np.where(size > 0.0, size, 1.0)
        piece, share = _nearest_place(self.corners, np.ascontiguousarray(points))
        return (1.0 - share[:, None]) * at_corners[piece] + share[:, None] * at_corners[piece + 1]

    def moved(self, rotation: Float64, translation: Float64) -> "CurvedBrushing":
        return CurvedBrushing(self.corners @ rotation.T + translation)


@kernel
def _nearest_place(corners: Float64, points: Float64) -> tuple[Int32, Float64]:
    # number of the nearest piece of a curve, and the share of it before the nearest place
    piece, share = np.zeros(len(points), np.int32), np.zeros(len(points))
    for i in range(len(points)):
        least = np.inf
        for j in range(len(corners) - 1):
            start = vector_at(corners, j)
            side, away = minus(vector_at(corners, j + 1), start), minus(vector_at(points, i), start)
            along = min(max(dot(away, side) / dot(side, side), 0.0), 1.0)
            left = minus(away, scaled(side, along))
            if dot(left, left) < least:
                piece[i], share[i], least = j, along, dot(left, left)
    return piece, share


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh with one normal per vertex, or none for facet shading.

    Faces are counterclockwise seen from outside. Vertices are split where the normal jumps (at a crease), so two faces
    that share a vertex also share its normal. Arrays of the right type are not copied; they are read-only here.

    Raises InputError: A shape is wrong, a coordinate is not finite, an index is out of range, or a normal is not of
        unit length
    """

    vertices: Float64  # positions in the part file's frame [mm], shape (n, 3)
    faces: Int32  # vertex indices, shape (m, 3), int32
    normals: Float64 | None = None  # unit outward normals at the vertices, shape (n, 3); None shades flat facets
    material: UInt8 | None = None  # number of each face's material, shape (m,); None: one material, number 0
    brushing: tuple[Brushing | None, ...] = ()  # of each material; none of them if empty

    def __post_init__(self) -> None:
        vertices = _rows_of_three("vertices", self.vertices)
        faces = np.asarray(self.faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
            raise InputError(f"mesh faces: expected integers of shape (m, 3), found {faces.dtype} {faces.shape}")
        if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
            numbers = f"from {faces.min()} to {faces.max()} for {len(vertices)} vertices"
            raise InputError(f"mesh faces: vertex indices {numbers}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", read_only(np.ascontiguousarray(faces, dtype=np.int32)))
        if self.material is not None:
            if self.material.shape != (len(faces),):
                raise InputError(f"mesh materials: expected shape ({len(faces)},), found {self.material.shape}")
            object.__setattr__(self, "material", read_only(self.material))
        if self.normals is None:
            return
        normals = _rows_of_three("normals", self.normals)
        if normals.shape != vertices.shape:
            raise InputError(f"mesh normals: expected shape {vertices.shape}, found {normals.shape}")
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
        if np.any(np.abs(length - 1.0) > 1e-6):
            worst = int(np.argmax(np.abs(length - 1.0)))
            raise InputError(f"mesh normals: expected unit length, found {length[worst]:.6g} at vertex {worst}")
        object.__setattr__(self, "normals", normals)

    def across_brushing(self, points: Float64, normals: Float64, face: Int32 | Index) -> Float64 | None:
        """Unit tangents across the brushing, 0 where there is none, shape (k, 3); None of a mesh without any.

        points, normals, face: Points of the surface [mm], unit normals, shape (k, 3), and their faces, shape (k,)
        """
        if not any(self.brushing):
            return None
        across = np.zeros(points.shape)
        for number, own in enumerate(self.brushing):
            if own is None:
                continue
            index = slice(None) if self.material is None else np.flatnonzero(self.material[face] == number)
            along = own.along(points[index], face[index])
            size = np.linalg.norm(along, axis=1, keepdims=True)
            aside = np.cross(normals[index], along / np.where(size > 0.0, size, 1.0))
            sine = np.linalg.norm(aside, axis=1, keepdims=True)
            across[index] = np.where(sine >= LEAST_SINE, aside / np.maximum(sine, LEAST_SINE), 0.0)
        return across

    @property
    def bounds(self) -> Float64:
        """Lowest and highest corner of the bounding box of all vertices [mm], shape (2, 3)."""
        if not len(self.vertices):
            raise InputError("mesh: no vertices, so no bounding box")
        return bounding_box(self.vertices)

    @property
    def box_corners(self) -> Float64:
        """The corners of that box [mm], shape (8, 3)."""
        return np.array(list(itertools.product(*self.bounds.T)))


def bounding_box(vertices: Float64) -> Float64:
    """Lowest and highest corner of the bounding box of some points, shape (2, 3)."""
    return np.stack([vertices.min(axis=0), vertices.max(axis=0)])


def face_normals(mesh: TriangleMesh) -> Float64:
    """Outward unit normals of the facets, part file's frame, shape (m, 3); zero for faces without area."""
    return unit_crosses(mesh.vertices, mesh.faces)


def unit_crosses(vertices: Float64, faces: Int32) -> Float64:
    """Unit normals of the facets, shape (m, 3); zero for faces without area."""
    cross = face_crosses(vertices, faces)
    length = np.sqrt(np.einsum("ij,ij->i", cross, cross))
    return cross / np.where(length > 0.0, length, 1.0)[:, None]


def face_areas(mesh: TriangleMesh) -> Float64:
    """Areas of the flat facets [mm²], shape (m,)."""
    cross = face_crosses(mesh.vertices, mesh.faces)
    return 0.5 * np.sqrt(np.einsum("ij,ij->i", cross, cross))


def transformed(mesh: TriangleMesh, rotation: ArrayLike, translation: ArrayLike) -> TriangleMesh:
    """Mesh after the rigid motion p' = R·p + t; normals are turned with it.

    Raises InputError: R is not a rotation (a scaling or a mirror would falsify normals and winding), or t is not finite
    """
    R, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
        raise InputError(f"mesh rotation: expected a rotation matrix of shape (3, 3), found {R.tolist()}")
    if t.shape != (3,) or not np.isfinite(t).all():
        raise InputError(f"mesh translation: expected three finite numbers in mm, found {t.tolist()}")
    normals = None if mesh.normals is None else _turned(mesh.normals, R)
    brushing = tuple(own and own.moved(R, t) for own in mesh.brushing)
    return TriangleMesh(_turned(mesh.vertices, R) + t, mesh.faces, normals, mesh.material, brushing)


def _turned(rows: Float64, R: Float64) -> Float64:
    # most parts are only shifted; adding 0.0 turns −0.0 into 0.0, as the product would
    return rows + 0.0 if np.array_equal(R, np.eye(3)) else rows @ R.T


@kernel
def face_crosses(vertices: Float64, faces: Int32) -> Float64:
    """Normals of the facets as long as twice their areas, shape (m, 3)."""
    result = np.empty((len(faces), 3))
    for i in range(len(faces)):
        x, y, z = face_cross(vertices[faces[i, 0]], vertices[faces[i, 1]], vertices[faces[i, 2]])
        result[i, 0], result[i, 1], result[i, 2] = x, y, z  # a row at once takes a second to compile
    return result


@kernel
def face_cross(a: Float64, b: Float64, c: Float64) -> tuple[float, float, float]:
    """(b − a) × (c − a)."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


def _rows_of_three(name: str, values: Float64) -> Float64:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"mesh {name}: expected shape (n, 3), found {array.shape}")
    if not np.isfinite(array).all():
        odd = np.flatnonzero(~np.isfinite(array).all(axis=1))
        raise InputError(f"mesh {name}: {len(odd)} rows are not finite, the first is row {odd[0]}")
    return read_only(array)


@dataclass(frozen=True, eq=False, kw_only=True)
class SurfacePlace:
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
