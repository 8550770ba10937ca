"""The triangle mesh that everything above casts rays at."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lightopt.core.arrays import Float64, Int32, read_only
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel


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

    @property
    def bounds(self) -> Float64:
        """Lowest and highest corner of the bounding box of all vertices [mm], shape (2, 3)."""
        if not len(self.vertices):
            raise InputError("mesh: no vertices, so no bounding box")
        return bounding_box(self.vertices)


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
    return TriangleMesh(_turned(mesh.vertices, R) + t, mesh.faces, normals)


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
