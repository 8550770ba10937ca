"""Patches: the faces of a mesh cut into pieces no longer than the pixel's footprint."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from lightopt.core.arrays import Bool, Float64, Int32, UInt8
from lightopt.core.errors import InputError
from lightopt.geometry._bisection import build_pieces, count_pieces, find_pieces
from lightopt.geometry._triangle_mesh import TriangleMesh, face_areas, face_normals


@dataclass(frozen=True, eq=False)
class Patches:
    """Pieces of a mesh's faces, in the order of the faces, and the trees that find them.

    Each face is cut at the middle of its longest edge, then each half likewise, until no edge is too long. A
    cut is an inner node of the face's binary tree; a tree entry e ≥ 0 is node e, an entry e < 0 is patch −1 −
    e.

    vertices: The mesh's vertices, then one for each cut, part file's frame [mm], shape (n + c, 3)
    triangles: The patches' corners as indices into `vertices`, counterclockwise from outside, shape (p, 3), int32
    centroids: Centres of the patches [mm], shape (p, 3)
    normals: Unit outward normals at the centroids: the vertex normals interpolated, or the facet's, shape (p, 3)
    areas: [mm²], shape (p,). Those of a face sum up to the face's area.
    face: Face of the mesh that the patch lies on, ascending, shape (p,), int32
    roots: Tree entry of each face, shape (m,), int32
    children: Tree entries of the two halves of each cut, shape (c, 2), int32
    cut_edge: Which edge of its triangle was cut: k runs from corner k to corner k + 1, shape (c,), uint8
    """

    vertices: Float64
    triangles: Int32
    centroids: Float64
    normals: Float64
    areas: Float64
    face: Int32
    roots: Int32
    children: Int32
    cut_edge: UInt8

    def __post_init__(self) -> None:
        for field in fields(self):
            view = np.asarray(getattr(self, field.name)).view()
            view.flags.writeable = False
            object.__setattr__(self, field.name, view)

    def __len__(self) -> int:
        return len(self.triangles)

    @property
    def corners(self) -> Float64:
        """Corners of the patches [mm], shape (p, 3, 3); made anew on each call."""
        return self.vertices[self.triangles]

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
        if (
            faces.ndim != 1
            or faces.shape != us.shape
            or faces.shape != vs.shape
            or faces.dtype.kind not in "iu"
        ):
            raise InputError(
                "patch_at: expected integer faces and coordinates u, v of one shape (k,), found "
                f"{faces.dtype} {faces.shape}, {us.shape}, {vs.shape}"
            )
        if len(faces) and (int(faces.min()) < -1 or int(faces.max()) >= len(self.roots)):
            raise InputError(
                f"patch_at: faces from {faces.min()} to {faces.max()}, expected −1 to {len(self.roots) - 1}"
            )
        return find_pieces(self.roots, self.children, self.cut_edge, faces.astype(np.int32), us, vs)


def refine(
    mesh: TriangleMesh, *, max_edge_mm: float, max_patches: int, select: Bool | None = None
) -> Patches:
    """Patches of a mesh: every face bisected at its longest edge until no edge is longer than `max_edge_mm`.

    Longest-edge bisection (Rivara, Int. J. Numer. Meth. Eng. 20, 1984) bounds the smallest angle by half of
    the face's, so pieces do not become slivers. Neighbouring faces are cut independently of each other.

    max_edge_mm: Longest edge of a patch [mm]
    max_patches: More are refused
    select: Faces to refine, shape (m,); the others become one patch each. All by default.
    Raises InputError: A parameter is out of range, or there would be more than `max_patches`
    """
    selected = _checked(mesh, max_edge_mm, select)
    count = estimate_patch_count(mesh, max_edge_mm, select=select, limit=max_patches + 1)
    if count > max_patches:
        raise InputError(
            f"patches: at an edge of {max_edge_mm:g} mm the {len(mesh.faces):,} faces give {count:,} patches "
            f"or more, at most {max_patches:,} are accepted; take a longer edge"
        )
    vertices, triangles, weights, depth, face, roots, children, cut_edge = build_pieces(
        mesh.vertices, mesh.faces, selected, max_edge_mm, count
    )
    flat = face_normals(mesh)[face]
    normals = flat
    if mesh.normals is not None:
        normals = np.einsum("pk,pkj->pj", weights, mesh.normals[mesh.faces[face]])
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
        cancelled = length < 1e-9
        normals = np.where(cancelled[:, None], flat, normals / np.where(cancelled, 1.0, length)[:, None])
    corners = vertices[triangles]
    return Patches(
        vertices=vertices,
        triangles=triangles,
        centroids=(corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0,
        normals=normals,
        # a median halves the area, and halving a floating-point number is exact
        areas=np.ldexp(face_areas(mesh)[face], -depth),
        face=face,
        roots=roots,
        children=children,
        cut_edge=cut_edge,
    )


def estimate_patch_count(
    mesh: TriangleMesh, max_edge_mm: float, *, select: Bool | None = None, limit: int = 10_000_000
) -> int:
    """Count the patches that :func:`refine` would make, without making them.

    Exact below `limit`; where the number is certainly not below, some value of at least `limit` in little
    time.

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
    return int(count_pieces(mesh.vertices, mesh.faces, selected, max_edge_mm, limit))


def _checked(mesh: TriangleMesh, max_edge_mm: float, select: Bool | None) -> Bool:
    if not (math.isfinite(max_edge_mm) and max_edge_mm > 0.0):
        raise InputError(f"patches: expected an edge length above 0 mm, found {max_edge_mm}")
    if select is None:
        return np.ones(len(mesh.faces), dtype=np.bool_)
    if select.shape != (len(mesh.faces),) or select.dtype != np.bool_:
        raise InputError(
            f"patches: expected the selection as booleans of shape ({len(mesh.faces)},), found "
            f"{select.dtype} {select.shape}"
        )
    return select
