"""Meshes of plain solids as binary STL, for parts that have no file."""

from typing import Any

from lightopt.core.arrays import Float64

_SUBDIVISIONS = 5  # 20,480 triangles, whose middles are 0.015 % of the radius inside the sphere


def sphere_stl(radius: float) -> bytes:
    """Binary STL of a sphere about the origin; radius [mm]."""
    from trimesh import creation

    return _stl(creation.icosphere(subdivisions=_SUBDIVISIONS, radius=radius))


def box_stl(corners: Float64) -> bytes:
    """Binary STL of a box between two corners [mm], shape (2, 3)."""
    from trimesh import creation

    return _stl(creation.box(bounds=corners))


def _stl(mesh: Any) -> bytes:
    return mesh.export(file_type="stl")
