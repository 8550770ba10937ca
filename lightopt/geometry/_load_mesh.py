"""Load a part's mesh from a file: read, check, repair, and give it normals.

Normals are smooth ones for faceted formats, and those that a file carries.
"""

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.errors import InputError, counted
from lightopt.core.kernels import kernel
from lightopt.core.threads import side_by_side
from lightopt.geometry._glb import MeshPiece
from lightopt.geometry._mesh_formats import RawMesh, check_budget, read_glb, read_obj, read_ply, read_stl
from lightopt.geometry._patches import longest_edges
from lightopt.geometry._step import read_step
from lightopt.geometry._topology import EdgePairs, join, merge_rows, next_corner, repair_winding
from lightopt.geometry._triangle_mesh import TriangleMesh, face_cross, face_crosses, unit_crosses

_log = logging.getLogger("lightopt.geometry")

UNITLESS_SUFFIXES: tuple[str, ...] = (".stl", ".ply", ".obj")  # formats that carry no unit, so that one has to be given

MESH_SUFFIXES: tuple[str, ...] = (*UNITLESS_SUFFIXES, ".glb", ".step", ".stp")  # file name endings that can be loaded
_READERS = {".stl": read_stl, ".ply": read_ply, ".obj": read_obj, ".glb": read_glb}

# Text takes at most about this much for a triangle; a file beyond it is over the budget whatever it holds.
_FILE_BYTES_PER_TRIANGLE = 1000
_MOST_TRIANGLES = 700_000_000  # corner numbers are int32

# A height below this part of the longest edge is rounding of the coordinates, not a surface: it has no direction.
_FLAT = 1e-12
_FARTHEST_MM = 1e9  # farther from the origin rounding eats the part, and no part is that large


@dataclass(frozen=True, eq=False)
class LoadedMesh:
    mesh: TriangleMesh
    warnings: tuple[str, ...]
    pieces: tuple[MeshPiece, ...] = ()  # of the file, where they were asked for and it has any
    piece: Int32 | None = None  # index of the piece of each face of the mesh, shape (m,)
    texture: Float64 | None = None  # u, v of the corners of each face, NaN where it has none, (m, 3, 2); with pieces
    unnamed: tuple[str, ...] = ()  # why pieces have no names: some of the warnings


def load_mesh(
    path: Path | str,
    *,
    unit_mm: float | None,
    normals: Literal["smooth", "facet"],
    crease_angle: float,
    chord_tolerance_mm: float = 0.01,
    angular_tolerance: float = 0.1,
    max_triangles: int = 20_000_000,
    pieces: bool = False,
) -> LoadedMesh:
    """Mesh of a part from an STL, PLY, OBJ, GLB or STEP file, repaired and with normals.

    Coinciding vertices are one vertex, triangles without area are left out, triangles that wind against their
    neighbours and closed surfaces that are inside out are turned; each with a warning that says how many. Open and
    non-manifold meshes are fine. STEP keeps the normals of the CAD surface, PLY, OBJ and GLB the vertex normals that
    they carry; anything else is smoothed within the crease angle. GLB is turned from Y up to Z up.

    path: File; its ending gives the format (`MESH_SUFFIXES`)
    unit_mm: Length of one unit of the file [mm]. Required for formats that carry none (`UNITLESS_SUFFIXES`). STEP
        declares its own. GLB is metres by its specification; a value is believed over that, as many programs write
        other units.
    normals: "smooth" for vertex normals, "facet" for none
    crease_angle: Largest bend between two facets across an edge that is smooth [rad], 0 to π; for meshes without own
        normals
    chord_tolerance_mm: STEP: largest distance between triangles and the surface [mm]
    angular_tolerance: STEP: largest bend between neighbouring tangents along an edge [rad]
    max_triangles: More are refused, before loading where the header gives their number
    pieces: Whether to keep which faces are of which group, CAD face or colour of the file, and texture coordinates
    Raises InputError: The file is missing, of an unknown format, empty, cut off or damaged; it needs a unit; it has no
        triangles, coordinates that are not finite, or indices out of range; or a limit was reached
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"{path}: unknown mesh format '{path.suffix}', expected one of {', '.join(MESH_SUFFIXES)}")
    if unit_mm is None and suffix in UNITLESS_SUFFIXES:
        raise InputError(f"{path}: {suffix[1:].upper()} files carry no unit of length; give it (mm, inch, …)")
    data = _read(path, max_triangles)
    if suffix in (".step", ".stp"):
        tolerances = {"chord_tolerance_mm": chord_tolerance_mm, "angular_tolerance": angular_tolerance}
        raw = read_step(path, data, **tolerances, max_triangles=max_triangles, pieces=pieces)
        unit_mm = 1.0
    else:
        kept = {"pieces": True} if pieces and suffix != ".stl" else {}
        raw = _READERS[suffix](str(path), data, max_triangles, **kept)
        unit_mm = 1000.0 if unit_mm is None else unit_mm
    del data
    check_budget(str(path), len(raw.faces), min(max_triangles, _MOST_TRIANGLES))
    _check_triangles(str(path), raw, unit_mm)
    return _finish(str(path), raw, unit_mm, crease_angle if normals == "smooth" else None)


def _finish(name: str, raw: RawMesh, unit_mm: float, crease_angle: float | None) -> LoadedMesh:
    warnings = list(raw.warnings)
    # rounding may merge float64 positions that are scaled; float32 ones stay as distinct as they are
    placed, scale = (raw.vertices, unit_mm) if raw.vertices.dtype == np.float32 else (raw.vertices * unit_mm, 1.0)
    first, number = merge_rows(placed)
    vertices, faces = np.multiply(placed[first], scale, dtype=np.float64), number[raw.faces]
    cross, longest = face_crosses(vertices, faces), longest_edges(vertices, faces, np.ones(len(faces), np.bool_))
    keep = np.sqrt(np.einsum("ij,ij->i", cross, cross)) > _FLAT * longest
    if not keep.any():
        raise InputError(f"{name}: none of the {len(faces)} triangles of the {raw.format} file has an area")
    # a tessellator closes poles with empty triangles: true of every dome in STEP, and nothing to act on
    if not keep.all() and raw.format != "STEP":
        warnings.append(f"{np.count_nonzero(~keep)} of {len(faces)} triangles have no area: left out")
    repaired = repair_winding(vertices, faces[keep])
    warnings += repaired.warnings
    merged = len(placed) - len(first)
    turned = repaired.faces[:, 1] != faces[keep][:, 1]
    if crease_angle is None:
        mesh = _compact(vertices, repaired.faces)
        merged = merged if raw.normals is None else 0
    elif raw.normals is None:
        mesh, cancelled = smooth_normals(vertices, repaired.faces, repaired.pairs, crease_angle=crease_angle)
        if cancelled:
            warnings.append(f"{cancelled} vertex normals cancelled out: taken from a face")
    else:
        own = raw.faces[keep].astype(np.int32)
        own[turned] = own[turned][:, (0, 2, 1)]
        bend, points = None if raw.format == "STEP" else crease_angle, np.multiply(placed, scale, dtype=np.float64)
        mesh, replaced, merged = carried_normals(points, own, repaired.pairs, raw.normals, crease_angle=bend)
        warnings += replaced
    warnings += _vertex_warnings(raw, merged)
    _log.info("mesh of %s triangles", f"{len(mesh.faces):,}")
    texture = None if raw.texture is None else raw.texture[keep]
    if texture is not None:
        texture[turned] = texture[turned][:, (0, 2, 1)]
    piece = None if raw.piece is None else raw.piece[keep]
    return LoadedMesh(mesh, tuple(warnings), raw.pieces, piece, texture, raw.unnamed)


def _check_triangles(name: str, raw: RawMesh, unit_mm: float) -> None:
    if not len(raw.faces):
        raise InputError(f"{name}: the {raw.format} file has no triangles ({len(raw.vertices)} vertices)")
    low, high = int(raw.faces.min()), int(raw.faces.max())
    if low < 0 or high >= len(raw.vertices):
        bad = (raw.faces < 0) | (raw.faces >= len(raw.vertices))
        count = counted(int(np.count_nonzero(bad.any(axis=1))), "triangle")
        raise InputError(
            f"{name}: {count} with vertices that do not exist: indices {low} to {high} (counted from 0) for "
            f"{len(raw.vertices)} vertices. The file is damaged; export it again"
        )
    farthest = max(-float(raw.vertices.min()), float(raw.vertices.max()))
    if not math.isfinite(farthest):
        bad = np.flatnonzero(~np.isfinite(raw.vertices).all(axis=1))
        raise InputError(
            f"{name}: {len(bad)} vertices have coordinates that are not finite, the first is vertex {bad[0]} (counted "
            f"from 0): {raw.vertices[bad[0]].tolist()}. Export the file again"
        )
    if farthest > _FARTHEST_MM / unit_mm:
        raise InputError(
            f"{name}: coordinates up to {farthest:g} units of {unit_mm:g} mm, at most {_FARTHEST_MM:g} mm "
            "are accepted; the file is damaged or its unit is wrong"
        )


def _vertex_warnings(raw: RawMesh, merged: int) -> list[str]:
    used = np.zeros(len(raw.vertices), dtype=np.bool_)
    used[raw.faces] = True
    unused = int(np.count_nonzero(~used))
    warnings: list[str] = []
    if unused:
        warnings.append(f"{unused} of {len(used)} vertices belong to no triangle: left out")
    if merged and not raw.repeats_vertices:
        warnings.append(f"{merged} of {len(used)} vertices repeat another one: merged")
    return warnings


def _compact(vertices: Float64, faces: Int32) -> TriangleMesh:
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return TriangleMesh(vertices[used], number[faces])


def _read(path: Path, max_triangles: int) -> bytes:
    try:
        size = path.stat().st_size
        if size > max_triangles * _FILE_BYTES_PER_TRIANGLE + 1_000_000:
            much = f"{size / 1e9:.1f} GB, too much for the {max_triangles:,} triangles that are accepted"
            raise InputError(f"{path}: {much}. Export the part with a coarser tolerance")
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such mesh file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not data:
        raise InputError(f"{path}: the mesh file is empty (0 bytes)")
    return data


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

    (flat, group), angles = side_by_side(groups, lambda: corner_angles(vertices, faces))
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
def corner_angles(vertices: Float64, faces: Int32) -> Float64:
    angles = np.empty((len(faces), 3))
    for f in range(len(faces)):
        for k in range(3):
            a, b, c = vertices[faces[f, k]], vertices[faces[f, (k + 1) % 3]], vertices[faces[f, (k + 2) % 3]]
            x, y, z = face_cross(a, b, c)
            dot = (b[0] - a[0]) * (c[0] - a[0]) + (b[1] - a[1]) * (c[1] - a[1]) + (b[2] - a[2]) * (c[2] - a[2])
            angles[f, k] = np.arctan2(np.sqrt(x * x + y * y + z * z), dot)
    return angles
