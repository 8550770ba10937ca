"""Load a part's mesh from a file: read, check, repair, and give it normals."""

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.errors import InputError, counted
from lightopt.geometry._glb import MeshPiece
from lightopt.geometry._mesh_formats import RawMesh, check_budget, read_glb, read_obj, read_ply, read_stl
from lightopt.geometry._normals import carried_normals, smooth_normals
from lightopt.geometry._patches import longest_edges
from lightopt.geometry._step import read_step
from lightopt.geometry._topology import merge_rows, repair_winding
from lightopt.geometry._triangle_mesh import TriangleMesh, face_crosses

_log = logging.getLogger("lightopt.geometry")

UNITLESS_SUFFIXES: tuple[str, ...] = (".stl", ".ply", ".obj")
"""Formats that carry no unit, so that one has to be given."""

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
    """A mesh, and what was repaired or is odd."""

    mesh: TriangleMesh
    warnings: tuple[str, ...]
    pieces: tuple[MeshPiece, ...] = ()  # of the file, where they were asked for and it has any
    piece: Int32 | None = None  # index of the piece of each face of the mesh, shape (m,)


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
    pieces: Whether to keep which faces are of which group, CAD face or colour of the file
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
    """Repaired mesh with normals; facets where there is no crease angle."""
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
    if crease_angle is None:
        mesh = _compact(vertices, repaired.faces)
        merged = merged if raw.normals is None else 0
    elif raw.normals is None:
        mesh, cancelled = smooth_normals(vertices, repaired.faces, repaired.pairs, crease_angle=crease_angle)
        if cancelled:
            warnings.append(f"{cancelled} vertex normals cancelled out: taken from a face")
    else:
        own = raw.faces[keep].astype(np.int32)
        turned = repaired.faces[:, 1] != faces[keep][:, 1]
        own[turned] = own[turned][:, (0, 2, 1)]
        bend, points = None if raw.format == "STEP" else crease_angle, np.multiply(placed, scale, dtype=np.float64)
        mesh, replaced, merged = carried_normals(points, own, repaired.pairs, raw.normals, crease_angle=bend)
        warnings += replaced
    warnings += _vertex_warnings(raw, merged)
    _log.info("mesh of %s triangles", f"{len(mesh.faces):,}")
    return LoadedMesh(mesh, tuple(warnings), raw.pieces, None if raw.piece is None else raw.piece[keep])


def _check_triangles(name: str, raw: RawMesh, unit_mm: float) -> None:
    """Refuse triangles that cannot be repaired."""
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
