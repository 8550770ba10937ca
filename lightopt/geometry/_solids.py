"""Meshes of plain solids, for parts that have no file."""

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.geometry._triangle_mesh import TriangleMesh

_SUBDIVISIONS = 6  # 81,920 triangles, whose middles are 0.004 % of the radius inside the sphere


def sphere_mesh(radius: float) -> TriangleMesh:
    """A sphere about the origin, with its own normals; radius [mm]."""
    from trimesh import creation

    unit = creation.icosphere(subdivisions=_SUBDIVISIONS)
    normals = np.asarray(unit.vertices, np.float64)
    return TriangleMesh(vertices=radius * normals, faces=np.asarray(unit.faces, np.int32), normals=normals)


def box_mesh(corners: Float64) -> TriangleMesh:
    """A box between two corners [mm], shape (2, 3)."""
    from trimesh import creation

    box = creation.box(bounds=corners)
    return TriangleMesh(vertices=np.asarray(box.vertices, np.float64), faces=np.asarray(box.faces, np.int32))
