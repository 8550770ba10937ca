"""Vertex normals: smooth ones for faceted formats, and those that a file carries."""

import math

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import side_by_side
from lightopt.geometry._topology import EdgePairs, join, merge_rows, next_corner
from lightopt.geometry._triangle_mesh import TriangleMesh, face_cross, face_crosses, unit_crosses

_ANGLE_ROUNDING = 1e-9  # facet normals of coordinates in float64 are good to about this [rad]
_SAME_NORMAL = 1e-5  # components of one normal written twice in float32 or with six decimals differ by less


def smooth_normals(
    vertices: Float64, faces: Int32, pairs: EdgePairs, *, crease_angle: float
) -> tuple[TriangleMesh, int]:
    """Mesh with angle-weighted vertex normals, split where the surface bends by more than the crease angle.

    The corners at a vertex that are connected through edges of two faces bent by at most the crease angle share one
    normal; every other edge is sharp. Weights are the corners' angles (Thürmer and Wüthrich, Computing vertex normals
    from polygonal facets, J. Graphics Tools 3, 1998), so the normal does not depend on how the surface is cut.

    vertices: Positions without coinciding ones [mm], shape (n, 3)
    faces: Vertex indices with an agreeing winding, shape (m, 3)
    crease_angle: Largest angle between the normals of two faces across a smooth edge [rad]
    """

    def groups() -> tuple[Float64, Int32]:
        flat = unit_crosses(vertices, faces)
        smooth = ~pairs.same_direction & (_bends(flat, pairs.corners) <= crease_angle + _ANGLE_ROUNDING)
        return flat, _join_corners(3 * len(faces), pairs.corners[smooth])

    (flat, group), angles = side_by_side(groups, lambda: _corner_angles(vertices, faces))
    members = np.flatnonzero(group == np.arange(len(group), dtype=np.int32))
    number = np.empty(len(group), dtype=np.int32)
    number[members] = np.arange(len(members), dtype=np.int32)
    new_faces = number[group].reshape(-1, 3)
    summed = _sums((angles[:, :, None] * flat[:, None]).reshape(-1, 3), new_faces.ravel(), len(members))
    normals, cancelled = _unit_or(summed, flat[members // 3])
    return TriangleMesh(vertices[faces.reshape(-1)[members]], new_faces, normals), cancelled


def carried_normals(
    vertices: Float64, faces: Int32, pairs: EdgePairs, normals: Float64, *, crease_angle: float | None
) -> tuple[TriangleMesh, tuple[str, ...], int]:
    """Mesh with the normals that its file carries, vertices of equal position and normal merged.

    The file's normals are kept even where they are smooth across an edge sharper than the crease angle (a coarse sphere
    with exact normals needs that); as many programs average them over true creases, a warning counts such edges.

    vertices: Positions as in the file [mm], shape (n, 3)
    faces: Vertex indices after repair, shape (m, 3)
    pairs: Edges of these faces, coinciding vertices taken as one
    normals: Vertex normals as in the file, shape (n, 3)
    crease_angle: Largest bend of an edge that is expected to be smooth [rad]; None accepts the normals everywhere
    Returns: The mesh, warnings about normals that had to be replaced or turned, and the number of vertices merged.
    """
    # triangle edges are long against rounding, so sums over the faces around a vertex point to its outside
    flat = unit_crosses(vertices, faces)
    corners, any_flat = faces.ravel(), np.zeros_like(vertices)
    any_flat[corners] = np.repeat(flat, 3, axis=0)
    outside = _sums(np.repeat(face_crosses(vertices, faces), 3, axis=0), corners, len(vertices))
    unit, _ = _unit_or(outside, any_flat, least=0.0)
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    given = np.where(np.isfinite(normals).all(axis=1, keepdims=True), normals, 0.0)
    given, _ = _unit_or(given, np.zeros_like(given))
    missing = used & ~given.any(axis=1)
    given[missing] = unit[missing]
    inward = used & (np.einsum("ij,ij->i", given, unit) < 0.0)
    given[inward] *= -1.0
    what = {"were zero or not finite: taken from the faces": missing, "pointed into the part: turned": inward}
    warnings = [
        f"{np.count_nonzero(some)} of {np.count_nonzero(used)} vertex normals {text}"
        for text, some in what.items()
        if some.any()
    ]
    if crease_angle is not None:
        warnings += _smeared_creases(given, corners, flat, pairs, crease_angle)
    first, number = merge_rows(np.concatenate([vertices, given], axis=1)[used])
    compact = np.full(len(vertices), -1, dtype=np.int32)
    compact[used] = number
    keep = np.flatnonzero(used)[first]
    merged = int(np.count_nonzero(used)) - len(first)
    return TriangleMesh(vertices[keep], compact[faces], given[keep]), tuple(warnings), merged


def _smeared_creases(given: Float64, vertex: Int32, flat: Float64, pairs: EdgePairs, crease_angle: float) -> list[str]:
    # vertex: of each corner
    sharp = pairs.corners[_bends(flat, pairs.corners) > crease_angle + _ANGLE_ROUNDING]
    c, d = sharp[:, 0], sharp[:, 1]
    level = (np.abs(given[vertex[c]] - given[vertex[next_corner(d)]]) < _SAME_NORMAL).all(axis=1)
    level &= (np.abs(given[vertex[d]] - given[vertex[next_corner(c)]]) < _SAME_NORMAL).all(axis=1)
    message = (
        f"the file's vertex normals are smooth across {np.count_nonzero(level)} of {len(sharp)} edges bent by more "
        f"than the crease angle ({np.degrees(crease_angle):g}°): kept; for sharp creases save it without normals"
    )
    return [message] if level.any() else []


@kernel
def _bends(flat: Float64, pairs: Int32) -> Float64:
    """Angle between the facets' normals across each edge of two corners [rad], shape (e,)."""
    angles = np.empty(len(pairs))
    for e in range(len(pairs)):
        a, b = flat[pairs[e, 0] // 3], flat[pairs[e, 1] // 3]
        # the sine from the cross product and the cosine from the dot product: accurate near 0 and near π
        x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        angles[e] = math.atan2(math.sqrt(x * x + y * y + z * z), a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return angles


def _sums(rows: Float64, vertex: Int32, count: int) -> Float64:
    # of the rows of each vertex, shape (count, 3)
    return np.stack([np.bincount(vertex, column, count) for column in rows.T], axis=1, dtype=np.float64)


def _unit_or(vectors: Float64, fallback: Float64, *, least: float = 1e-9) -> tuple[Float64, int]:
    """Vectors at unit length, the fallback where they are too short, and the number of those."""
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    short = length <= least
    return np.where(short[:, None], fallback, vectors / np.where(short, 1.0, length)[:, None]), int(short.sum())


@kernel
def _join_corners(corner_count: int, pairs: Int32) -> Int32:
    """Lowest corner of the group that each corner belongs to (union-find with path halving)."""
    parent = np.arange(corner_count).astype(np.int32)
    for e in range(len(pairs)):
        c, d = pairs[e, 0], pairs[e, 1]
        # the faces run along the edge in opposite directions: the start in one is the end in the other
        join(parent, c, next_corner(d))
        join(parent, d, next_corner(c))
    for x in range(corner_count):
        parent[x] = parent[parent[x]]
    return parent


@kernel
def _corner_angles(vertices: Float64, faces: Int32) -> Float64:
    angles = np.empty((len(faces), 3))
    for f in range(len(faces)):
        for k in range(3):
            a, b, c = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]], vertices[faces[f, (k + 2) % 3]]
            x, y, z = face_cross(a, b, c)
            dot = (b[0] - a[0]) * (c[0] - a[0]) + (b[1] - a[1]) * (c[1] - a[1]) + (b[2] - a[2]) * (c[2] - a[2])
            angles[f, k] = np.arctan2(np.sqrt(x * x + y * y + z * z), dot)
    return angles
