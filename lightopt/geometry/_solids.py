"""Meshes of plain solids as binary STL, for parts that have no file."""

from typing import Any

_SUBDIVISIONS = 5  # 20,480 triangles, whose middles are 0.015 % of the radius inside the sphere


def sphere_stl(radius: float) -> bytes:
    """Binary STL of a sphere about the origin; radius [mm]."""
    from trimesh import creation

    return _stl(creation.icosphere(subdivisions=_SUBDIVISIONS, radius=radius))


def box_stl(low: tuple[float, float, float], high: tuple[float, float, float]) -> bytes:
    """Binary STL of a box between two corners [mm]."""
    from trimesh import creation

    return _stl(creation.box(bounds=[low, high]))


def _stl(mesh: Any) -> bytes:
    return mesh.export(file_type="stl")
