"""Patches: the faces of a mesh cut into triangles no longer than the pixel's footprint."""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lightopt.core.arrays import Bool, Float64, Int32, UInt8, read_only
from lightopt.core.errors import InputError
from lightopt.core.kernels import kernel
from lightopt.geometry._triangle_mesh import TriangleMesh, face_areas, face_normals

# Pending triangles of one face: one for each level of its tree. Two cuts at most halve the longest edge, so 512 levels
# outlast float64.
_LEVELS = 512


@dataclass(frozen=True, eq=False)
class Patches:
    """Pieces of a mesh's faces, in the order of the faces, and the trees that find them.

    Each face is cut at the middle of its longest edge, then each half likewise, until no edge is too long. A cut is an
    inner node of the face's binary tree; a tree entry e ≥ 0 is node e, an entry e < 0 is patch −1 − e.
    """

    vertices: Float64  # the mesh's vertices, then one for each cut, part file's frame [mm], shape (n + c, 3)
    triangles: Int32  # the patches' corners, indices into `vertices`, counterclockwise from outside, shape (p, 3)
    centroids: Float64  # centres of the patches [mm], shape (p, 3)
    normals: Float64  # unit outward normals at the centroids: vertex normals interpolated, or the facet's, (p, 3)
    areas: Float64  # [mm²], shape (p,). Those of a face sum up to the face's area
    face: Int32  # face of the mesh that the patch lies on, ascending, shape (p,)
    roots: Int32  # tree entry of each face, shape (m,)
    children: Int32  # tree entries of the two halves of each cut, shape (c, 2)
    cut_edge: UInt8  # which edge of its triangle was cut: k runs from corner k to corner k + 1, shape (c,)

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, read_only(np.asarray(getattr(self, field.name))))

    def __len__(self) -> int:
        return len(self.triangles)

    def patch_at(self, face: ArrayLike, u: ArrayLike, v: ArrayLike) -> Int32:
        """Patch that holds each point of the mesh's surface; every point of a face belongs to exactly one.

        face: Face index of each point, −1 where a ray missed, integers of shape (k,)
        u, v: Barycentric coordinates of the point (1 − u − v)·A + u·B + v·C, where A, B, C are the face's vertices in
            order, shape (k,)
        Returns: Patch index, −1 where `face` is −1, shape (k,), int32.
        Raises InputError: Shapes differ, or a face does not exist
        """
        faces = np.asarray(face)
        us, vs = np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        if faces.ndim != 1 or faces.shape != us.shape or faces.shape != vs.shape or faces.dtype.kind not in "iu":
            found = f"{faces.dtype} {faces.shape}, {us.shape}, {vs.shape}"
            raise InputError(f"patch_at: expected integer faces and coordinates u, v of one shape (k,), found {found}")
        if len(faces) and (int(faces.min()) < -1 or int(faces.max()) >= len(self.roots)):
            expected = f"expected −1 to {len(self.roots) - 1}"
            raise InputError(f"patch_at: faces from {faces.min()} to {faces.max()}, {expected}")
        return _find(self.roots, self.children, self.cut_edge, faces.astype(np.int32), us, vs)


def refine(mesh: TriangleMesh, *, max_edge_mm: float, max_patches: int, select: Bool | None = None) -> Patches:
    """Patches of a mesh: every face bisected at its longest edge until no edge is longer than `max_edge_mm`.

    Longest-edge bisection (Rivara, Int. J. Numer. Meth. Eng. 20, 1984) bounds the smallest angle by half of
    the face's, so patches do not become slivers. Neighbouring faces are cut independently of each other.

    max_edge_mm: Longest edge of a patch [mm]
    max_patches: More are refused
    select: Faces to refine, shape (m,); the others become one patch each. All by default.
    Raises InputError: A parameter is out of range, or there would be more than `max_patches`
    """
    selected = _checked(mesh, max_edge_mm, select)
    count = estimate_patch_count(mesh, max_edge_mm, select=select, limit=max_patches + 1)
    if count > max_patches:
        many = f"the {len(mesh.faces):,} faces give {count:,} patches or more, at most {max_patches:,} are accepted"
        raise InputError(f"patches: at an edge of {max_edge_mm:g} mm {many}; take a longer edge")
    smooth = np.zeros((0, 3)) if mesh.normals is None else mesh.normals
    of_faces = smooth, face_normals(mesh), face_areas(mesh)
    return Patches(*_build(mesh.vertices, mesh.faces, of_faces, selected, max_edge_mm, count))


def estimate_patch_count(
    mesh: TriangleMesh, max_edge_mm: float, *, select: Bool | None = None, limit: int = 10_000_000
) -> int:
    """Count the patches that :func:`refine` would make, without making them.

    Exact below `limit`; where the number is certainly not below, some value of at least `limit` in little time.

    mesh, max_edge_mm, select: As for :func:`refine`
    Raises InputError: A parameter is out of range
    """
    selected = _checked(mesh, max_edge_mm, select)
    if limit < 1:
        raise InputError(f"patches: the limit must be at least 1, found {limit}")
    # no triangle without an edge over e is larger than the equilateral one
    largest = math.sqrt(3.0) / 4.0 * max_edge_mm**2
    least = float(face_areas(mesh)[selected].sum()) / largest * (1.0 - 1e-9) if largest > 0.0 else math.inf
    if least >= limit:
        return max(limit, math.ceil(least)) if math.isfinite(least) else limit
    return int(_count(mesh.vertices, mesh.faces, selected, max_edge_mm, limit))


def _checked(mesh: TriangleMesh, max_edge_mm: float, select: Bool | None) -> Bool:
    if not (math.isfinite(max_edge_mm) and max_edge_mm > 0.0):
        raise InputError(f"patches: expected an edge length above 0 mm, found {max_edge_mm}")
    if select is None:
        return np.ones(len(mesh.faces), dtype=np.bool_)
    if select.shape != (len(mesh.faces),) or select.dtype != np.bool_:
        found = f"{select.dtype} {select.shape}"
        raise InputError(f"patches: expected the selection as booleans of shape ({len(mesh.faces)},), found {found}")
    return select


@kernel
def _longest_edge(a: Float64, b: Float64, c: Float64, limit: float) -> int:
    """Edge k (from corner k to k + 1) that is longest, the first of equals; −1 if none is over the limit."""
    best, edge = limit * limit, -1
    for k in range(3):
        p, q = (a, b) if k == 0 else ((b, c) if k == 1 else (c, a))
        x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        square = x * x + y * y + z * z
        if square > best:
            best, edge = square, k
    return edge


@kernel
def longest_edges(vertices: Float64, faces: Int32, selected: Bool) -> Float64:
    """Squared length of the longest edge of each face [mm²], shape (m,); 0 for faces that are not selected."""
    longest = np.zeros(len(faces))
    for f in range(len(faces)):
        if selected[f]:
            for k in range(3):
                p, q = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]]
                x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
                longest[f] = max(longest[f], x * x + y * y + z * z)
    return longest


@kernel
def _count(vertices: Float64, faces: Int32, selected: Bool, limit: float, enough: int) -> int:
    """Number of patches of all faces, up to `enough`."""
    stack = np.empty((_LEVELS, 3, 3))
    total = len(faces)
    longest = longest_edges(vertices, faces, selected)
    for f in range(len(faces)):
        if longest[f] <= limit * limit:
            continue
        for k in range(3):
            for axis in range(3):
                stack[0, k, axis] = vertices[faces[f, k], axis]
        top = 1
        while top > 0:
            top -= 1
            # numbers and not arrays: most of the time of a large mesh is spent here
            best, edge = limit * limit, -1
            for k in range(3):
                after = (k + 1) % 3
                x = stack[top, after, 0] - stack[top, k, 0]
                y = stack[top, after, 1] - stack[top, k, 1]
                z = stack[top, after, 2] - stack[top, k, 2]
                square = x * x + y * y + z * z
                if square > best:
                    best, edge = square, k
            if edge < 0 or top + 2 > _LEVELS:
                continue
            after = (edge + 1) % 3
            for axis in range(3):
                middle = 0.5 * (stack[top, edge, axis] + stack[top, after, axis])
                for k in range(3):
                    stack[top + 1, k, axis] = stack[top, k, axis]
                stack[top + 1, after, axis] = middle
                stack[top, edge, axis] = middle
            top += 2
            total += 1
            if total >= enough:
                return total
    return total


@kernel
def _build(
    vertices: Float64,
    faces: Int32,
    of_faces: tuple[Float64, Float64, Float64],
    selected: Bool,
    limit: float,
    count: int,
) -> tuple[NDArray[Any], ...]:
    """Cut all faces, exactly as `_count` does: the fields of `Patches`, in their order.

    A child's tree entry is written into its parent when the child is taken up. `of_faces` are normals at the vertices,
    none of them for facets, and normals and areas of the faces.
    """
    smooth, flat, face_area = of_faces
    n, m = len(vertices), len(faces)
    cuts = count - m
    points = np.empty((n + cuts, 3))
    for i in range(n):  # loops where array expressions would take seconds to compile
        for axis in range(3):
            points[i, axis] = vertices[i, axis]
    triangles, centroids, normals = np.empty((count, 3), np.int32), np.empty((count, 3)), np.empty((count, 3))
    middles = triangles, centroids, normals
    areas, face, roots = np.empty(count), np.empty(count, np.int32), np.empty(m, np.int32)
    children, cut_edge = np.empty((cuts, 2), np.int32), np.empty(cuts, np.uint8)
    stack, stack_weights = np.empty((_LEVELS, 3), np.int32), np.empty((_LEVELS, 3, 3))
    stack_depth, stack_parent = np.empty(_LEVELS, np.int32), np.empty((_LEVELS, 2), np.int32)
    triangle, corner_weights = np.empty(3, np.int32), np.empty((3, 3))
    middle, mean, third = np.empty(3), np.empty(3), np.full(3, 1.0 / 3.0)
    patch, node = 0, 0
    longest = longest_edges(vertices, faces, selected)
    for f in range(m):
        if longest[f] <= limit * limit:
            roots[f] = -1 - patch
            for k in range(3):
                triangle[k] = faces[f, k]
            _store_middle(patch, points, triangle, (smooth, faces[f], third, flat[f]), middles)
            areas[patch] = face_area[f]
            face[patch] = f
            patch += 1
            continue
        for k in range(3):
            stack[0, k] = faces[f, k]
            for axis in range(3):
                stack_weights[0, k, axis] = 1.0 if k == axis else 0.0
        stack_depth[0] = 0
        stack_parent[0, 0] = -1
        top = 1
        while top > 0:
            top -= 1
            for k in range(3):
                triangle[k] = stack[top, k]
                for axis in range(3):
                    corner_weights[k, axis] = stack_weights[top, k, axis]
            depth, parent, side = stack_depth[top], stack_parent[top, 0], stack_parent[top, 1]
            edge = -1
            if selected[f] and top + 2 <= _LEVELS:
                edge = _longest_edge(points[triangle[0]], points[triangle[1]], points[triangle[2]], limit)
            entry = -1 - patch if edge < 0 else node
            if parent < 0:
                roots[f] = entry
            else:
                children[parent, side] = entry
            if edge < 0:
                for axis in range(3):
                    mean[axis] = (corner_weights[0, axis] + corner_weights[1, axis] + corner_weights[2, axis]) / 3.0
                _store_middle(patch, points, triangle, (smooth, faces[f], mean, flat[f]), middles)
                # a median halves the area, and halving a floating-point number is exact
                areas[patch] = math.ldexp(face_area[f], -depth)
                face[patch] = f
                patch += 1
                continue
            new = n + node
            after = (edge + 1) % 3
            for axis in range(3):
                points[new, axis] = 0.5 * (points[triangle[edge], axis] + points[triangle[after], axis])
                middle[axis] = 0.5 * (corner_weights[edge, axis] + corner_weights[after, axis])
            # both halves keep the sense of rotation; the one that is next holds the start of the cut edge
            for k in range(3):
                stack[top, k] = stack[top + 1, k] = triangle[k]
                for axis in range(3):
                    stack_weights[top, k, axis] = stack_weights[top + 1, k, axis] = corner_weights[k, axis]
            stack[top, edge] = stack[top + 1, after] = new
            for axis in range(3):
                stack_weights[top, edge, axis] = stack_weights[top + 1, after, axis] = middle[axis]
            for half in range(2):
                stack_depth[top + half] = depth + 1
                stack_parent[top + half, 0] = node
                stack_parent[top + half, 1] = 1 - half
            cut_edge[node] = edge
            node += 1
            top += 2
    return points, triangles, centroids, normals, areas, face, roots, children, cut_edge


@kernel
def _store_middle(
    patch: int,
    points: Float64,
    triangle: Int32,
    shading: tuple[Float64, Int32, Float64, Float64],
    middles: tuple[Int32, Float64, Float64],
) -> None:
    # the corners of a patch, its centroid, and its normal there: the vertex normals interpolated, of unit length, or
    # that of the facet where there are none or they cancel
    (smooth, face, weights, flat), (triangles, centroids, normals) = shading, middles
    x = y = z = 0.0
    for k in range(3):
        triangles[patch, k] = triangle[k]
        if len(smooth):
            x += weights[k] * smooth[face[k], 0]
            y += weights[k] * smooth[face[k], 1]
            z += weights[k] * smooth[face[k], 2]
    length = math.sqrt(x * x + z * z + y * y)
    if length < 1e-9:
        x, y, z, length = flat[0], flat[1], flat[2], 1.0
    normals[patch, 0], normals[patch, 1], normals[patch, 2] = x / length, y / length, z / length
    for axis in range(3):
        summed = points[triangle[0], axis] + points[triangle[1], axis] + points[triangle[2], axis]
        centroids[patch, axis] = summed / 3.0


@kernel
def _find(roots: Int32, children: Int32, cut_edge: UInt8, faces: Int32, us: Float64, vs: Float64) -> Int32:
    # Down the tree the weights of the corners choose the half: the point is nearer to the end of the cut edge that
    # weighs more, and against the half's own corners it has weights w_near − w_far, 2·w_far (the middle) and the third
    # as it was. −1 for face −1
    found = np.full(len(faces), -1, dtype=np.int32)
    weight = np.empty(3)
    for i in range(len(faces)):
        if faces[i] < 0:
            continue
        weight[0], weight[1], weight[2] = 1.0 - us[i] - vs[i], us[i], vs[i]
        entry = roots[faces[i]]
        while entry >= 0:
            start = cut_edge[entry]
            end = (start + 1) % 3
            if weight[start] >= weight[end]:
                weight[start] -= weight[end]
                weight[end] *= 2.0
                entry = children[entry, 0]
            else:
                weight[end] -= weight[start]
                weight[start] *= 2.0
                entry = children[entry, 1]
        found[i] = -1 - entry
    return found
