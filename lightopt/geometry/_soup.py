"""Triangles as a file gives them, before anything is checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int32, Int64
from lightopt.core.errors import InputError, counted

# Peak of loading and smoothing a binary STL of 1.3 million triangles: 700 bytes each, measured.
BYTES_PER_TRIANGLE = 700

# A height below this part of the longest edge is rounding of the coordinates, not a surface: it has no
# direction.
_FLAT = 1e-12

# Farther from the origin rounding eats the part, and no part is that large.
_FARTHEST_MM = 1e9


@dataclass(frozen=True, eq=False)
class Soup:
    """Triangles of a file in the file's unit.

    vertices: Positions [file unit], Z up, shape (n, 3)
    faces: Vertex indices as found in the file, shape (m, 3)
    normals: Vertex normals carried by the file, not necessarily of unit length, shape (n, 3), or None
    format: What the file is, for people ("binary STL")
    repeats_vertices: The format repeats a vertex for each face or seam, so coinciding vertices are nothing to report
    warnings: What was noticed while reading
    """

    vertices: Float64
    faces: Int64
    normals: Float64 | None
    format: str
    repeats_vertices: bool
    warnings: tuple[str, ...] = ()


def check_budget(name: str, triangles: int, max_triangles: int) -> None:
    """Refuse a mesh of more than `max_triangles` before its data is loaded.

    Raises InputError: With both numbers and the memory that loading would take
    """
    if triangles > max_triangles:
        gigabytes = triangles * BYTES_PER_TRIANGLE / 1e9
        raise InputError(
            f"{name}: {triangles:,} triangles, at most {max_triangles:,} are accepted; loading them would "
            f"take about {gigabytes:.1f} GB of memory. Export the part with a coarser tolerance"
        )


def check_soup(name: str, soup: Soup, unit_mm: float) -> None:
    """Refuse triangles that cannot be repaired.

    Raises InputError: No triangles, a vertex that is not finite or beyond all reason, or a vertex index out of range
    """
    if not len(soup.faces):
        raise InputError(f"{name}: the {soup.format} file has no triangles ({len(soup.vertices)} vertices)")
    low, high = int(soup.faces.min()), int(soup.faces.max())
    if low < 0 or high >= len(soup.vertices):
        bad = (soup.faces < 0) | (soup.faces >= len(soup.vertices))
        count = counted(int(np.count_nonzero(bad.any(axis=1))), "triangle")
        raise InputError(
            f"{name}: {count} with vertices that do not exist: indices "
            f"{low} to {high} (counted from 0) for {len(soup.vertices)} vertices. The file is damaged; "
            "export it again"
        )
    bad = ~np.isfinite(soup.vertices).all(axis=1)
    if bad.any():
        where = int(np.argmax(bad))
        raise InputError(
            f"{name}: {np.count_nonzero(bad)} vertices have coordinates that are not finite, the first is "
            f"vertex {where} (counted from 0): {soup.vertices[where].tolist()}. Export the file again"
        )
    farthest = float(np.abs(soup.vertices).max())
    if farthest > _FARTHEST_MM / unit_mm:
        raise InputError(
            f"{name}: coordinates up to {farthest:g} units of {unit_mm:g} mm, at most {_FARTHEST_MM:g} mm "
            "are accepted; the file is damaged or its unit is wrong"
        )


def keep_faces_with_area(vertices: Float64, faces: Int32) -> Bool:
    """Tell which faces have an area, and so a direction, shape (m,)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    u, v, w = b - a, c - a, c - b
    cross = np.cross(u, v)
    longest = np.maximum(np.maximum((u * u).sum(axis=1), (v * v).sum(axis=1)), (w * w).sum(axis=1))
    return np.sqrt((cross * cross).sum(axis=1)) > _FLAT * longest
