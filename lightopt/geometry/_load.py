"""Load a part's mesh from a file: read, check, repair, give it normals, and describe what was done."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.errors import InputError
from lightopt.geometry._formats import read_glb, read_obj, read_ply, read_stl
from lightopt.geometry._normals import carried_normals, smooth_normals
from lightopt.geometry._soup import Soup, check_budget, check_soup, keep_faces_with_area
from lightopt.geometry._step import StepLimits, read_step
from lightopt.geometry._topology import merge_rows
from lightopt.geometry._triangle_mesh import TriangleMesh
from lightopt.geometry._winding import Repaired, repair_winding

UNITLESS_SUFFIXES: tuple[str, ...] = (".stl", ".ply", ".obj")
"""Formats that carry no unit, so that one has to be given."""

MESH_SUFFIXES: tuple[str, ...] = (*UNITLESS_SUFFIXES, ".glb", ".step", ".stp")
"""File name endings that can be loaded."""

_READERS = {".stl": read_stl, ".ply": read_ply, ".obj": read_obj, ".glb": read_glb}

# Text takes at most about this much for a triangle; a file beyond it is over the budget whatever it holds.
_FILE_BYTES_PER_TRIANGLE = 1000

# Corner numbers are int32.
_MOST_TRIANGLES = 700_000_000


@dataclass(frozen=True)
class MeshDescription:
    """What a loaded mesh is, in numbers.

    format: The file's format ("binary STL")
    unit_mm: Length of one unit of the file [mm]; 1 for STEP, which is converted as it is read
    triangles, vertices: Numbers after repair; vertices are counted after splitting at creases
    components: Surfaces connected through edges that exactly two triangles share
    open_edges, nonmanifold_edges: Edges of one triangle, and of three or more
    size_mm: Sides of the bounding box, part file's frame [mm]
    normals: Where the normals come from: "facets", "smoothed", "file" or "CAD surface"
    """

    format: str
    unit_mm: float
    triangles: int
    vertices: int
    components: int
    open_edges: int
    nonmanifold_edges: int
    size_mm: tuple[float, float, float]
    normals: Literal["facets", "smoothed", "file", "CAD surface"]

    @property
    def watertight(self) -> bool:
        """Every edge is shared by exactly two triangles."""
        return self.open_edges == 0 and self.nonmanifold_edges == 0


@dataclass(frozen=True, eq=False)
class LoadedMesh:
    """A mesh and what there is to say about it."""

    mesh: TriangleMesh
    warnings: tuple[str, ...]
    description: MeshDescription


def load_mesh(
    path: Path | str,
    *,
    unit_mm: float | None,
    normals: Literal["smooth", "facet"],
    crease_angle: float,
    chord_tolerance_mm: float = 0.01,
    angular_tolerance: float = 0.1,
    max_triangles: int = 20_000_000,
    step_timeout_s: float = 300.0,
    step_memory_gb: float = 4.0,
) -> LoadedMesh:
    """Mesh of a part from an STL, PLY, OBJ, GLB or STEP file, repaired and with normals.

    Coinciding vertices are one vertex, triangles without area are left out, triangles that wind against their
    neighbours and closed surfaces that are inside out are turned; each with a warning that says how many.
    Open and non-manifold meshes are fine. STEP keeps the normals of the CAD surface, PLY, OBJ and GLB the
    vertex normals that they carry; anything else is smoothed within the crease angle. GLB is turned from Y up
    to Z up.

    path: File; its ending tells the format (`MESH_SUFFIXES`)
    unit_mm: Length of one unit of the file [mm]. Required for formats that carry none (`UNITLESS_SUFFIXES`). STEP
        declares its own, which a value has to agree with. GLB is metres by its specification; a value is believed over
        that, as many programs write other units.
    normals: "smooth" for vertex normals, "facet" for none
    crease_angle: Largest bend between two facets across an edge that is smooth [rad], 0 to π; for meshes without own
        normals
    chord_tolerance_mm: STEP: largest distance between triangles and the surface [mm]
    angular_tolerance: STEP: largest bend between neighbouring tangents along an edge [rad]
    max_triangles: More are refused, before loading where the file's header tells
    step_timeout_s, step_memory_gb: STEP: time [s] and memory [10⁹ bytes] the tessellation may take
    Raises InputError: The file is missing, of an unknown format, empty, cut off or damaged; it needs a unit; it has no
        triangles, coordinates that are not finite, or indices out of range; or a limit was reached
    """
    path = Path(path)
    suffix = path.suffix.lower()
    _check_arguments(unit_mm, normals, crease_angle, chord_tolerance_mm, angular_tolerance, max_triangles)
    if suffix not in MESH_SUFFIXES:
        raise InputError(
            f"{path}: unknown mesh format '{path.suffix}', expected one of {', '.join(MESH_SUFFIXES)}"
        )
    if unit_mm is None and suffix in UNITLESS_SUFFIXES:
        raise InputError(
            f"{path}: {suffix[1:].upper()} files carry no unit of length; say which one it is (mm, inch, …)"
        )
    data = _read(path, max_triangles)
    if suffix in (".step", ".stp"):
        limits = StepLimits(chord_tolerance_mm, angular_tolerance, step_timeout_s, step_memory_gb)
        soup = read_step(path, data, unit_mm=unit_mm, limits=limits, max_triangles=max_triangles)
        unit_mm = 1.0
    else:
        soup = _READERS[suffix](str(path), data, max_triangles)
        unit_mm = 1000.0 if unit_mm is None else unit_mm
    del data
    check_budget(str(path), len(soup.faces), min(max_triangles, _MOST_TRIANGLES))
    check_soup(str(path), soup, unit_mm)
    return _finish(str(path), soup, unit_mm, crease_angle if normals == "smooth" else None)


def _finish(name: str, soup: Soup, unit_mm: float, crease_angle: float | None) -> LoadedMesh:
    """Repaired mesh with normals; facets where there is no crease angle."""
    warnings = list(soup.warnings)
    placed = soup.vertices * unit_mm
    first, number = merge_rows(placed)
    vertices, faces = placed[first], number[soup.faces]
    keep = keep_faces_with_area(vertices, faces)
    if not keep.any():
        raise InputError(f"{name}: none of the {len(faces)} triangles of the {soup.format} file has an area")
    # a tessellator closes poles with empty triangles: true of every dome in STEP, and nothing to act on
    if not keep.all() and soup.format != "STEP":
        warnings.append(f"{np.count_nonzero(~keep)} of {len(faces)} triangles have no area: left out")
    repaired = repair_winding(vertices, faces[keep])
    warnings += repaired.warnings
    merged = len(placed) - len(first)
    if crease_angle is None:
        mesh, source = _compact(vertices, repaired.faces), "facets"
        merged = merged if soup.normals is None else 0
    elif soup.normals is None:
        mesh, cancelled = smooth_normals(vertices, repaired.faces, repaired.pairs, crease_angle=crease_angle)
        source = "smoothed"
        if cancelled:
            warnings.append(f"{cancelled} vertex normals cancelled out: taken from a face")
    else:
        own = soup.faces[keep].astype(np.int32)
        turned = repaired.faces[:, 1] != faces[keep][:, 1]
        own[turned] = own[turned][:, (0, 2, 1)]
        is_cad = soup.format == "STEP"
        mesh, replaced, merged = carried_normals(
            placed, own, repaired.pairs, soup.normals, crease_angle=None if is_cad else crease_angle
        )
        warnings += replaced
        source = "CAD surface" if is_cad else "file"
    warnings += _vertex_warnings(soup, merged)
    return LoadedMesh(mesh, tuple(warnings), _described(mesh, soup.format, unit_mm, repaired, source))


def _vertex_warnings(soup: Soup, merged: int) -> list[str]:
    used = np.zeros(len(soup.vertices), dtype=np.bool_)
    used[soup.faces] = True
    unused = int(np.count_nonzero(~used))
    warnings: list[str] = []
    if unused:
        warnings.append(f"{unused} of {len(used)} vertices belong to no triangle: left out")
    if merged and not soup.repeats_vertices:
        warnings.append(f"{merged} of {len(used)} vertices repeat another one: merged")
    return warnings


def _compact(vertices: Float64, faces: Int32) -> TriangleMesh:
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return TriangleMesh(vertices[used], number[faces])


def _described(
    mesh: TriangleMesh,
    kind: str,
    unit_mm: float,
    repaired: Repaired,
    source: Literal["facets", "smoothed", "file", "CAD surface"],
) -> MeshDescription:
    x, y, z = (mesh.bounds[1] - mesh.bounds[0]).tolist()
    return MeshDescription(
        format=kind,
        unit_mm=unit_mm,
        triangles=len(mesh.faces),
        vertices=len(mesh.vertices),
        components=repaired.components,
        open_edges=repaired.pairs.open_edges,
        nonmanifold_edges=repaired.pairs.nonmanifold_edges,
        size_mm=(x, y, z),
        normals=source,
    )


def _check_arguments(
    unit_mm: float | None,
    normals: str,
    crease_angle: float,
    chord_tolerance_mm: float,
    angular_tolerance: float,
    max_triangles: int,
) -> None:
    if normals not in ("smooth", "facet"):
        raise InputError(f"normals: expected 'smooth' or 'facet', found {normals!r}")
    if not 0.0 <= crease_angle <= math.pi:
        raise InputError(f"crease angle: expected 0 to {math.pi:.4f} rad, found {crease_angle}")
    if max_triangles < 1:
        raise InputError(f"max_triangles: expected at least 1, found {max_triangles}")
    lengths = {"unit": unit_mm, "chord tolerance": chord_tolerance_mm, "angular tolerance": angular_tolerance}
    for key, value in lengths.items():
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{key}: expected a number above 0, found {value}")


def _read(path: Path, max_triangles: int) -> bytes:
    try:
        size = path.stat().st_size
        if size > max_triangles * _FILE_BYTES_PER_TRIANGLE + 1_000_000:
            raise InputError(
                f"{path}: {size / 1e9:.1f} GB, too much for the {max_triangles:,} triangles that are "
                "accepted. Export the part with a coarser tolerance"
            )
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such mesh file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not data:
        raise InputError(f"{path}: the mesh file is empty (0 bytes)")
    return data
