"""Meshes of parts: load and repair them, give them normals, and refine them into patches.

The one home of trimesh and cascadio. Knows triangles and lengths, no camera and no light. Everything is in
the frame of the part's file, in mm, Z up.
"""

from __future__ import annotations

from lightopt.mesh._load import MESH_SUFFIXES, UNITLESS_SUFFIXES, LoadedMesh, MeshDescription, load_mesh
from lightopt.mesh._nearest import SurfaceFinder, SurfacePlace, surface_place
from lightopt.mesh._patches import Patches, estimate_patch_count, refine
from lightopt.mesh._topology import MeshEdges, merge_rows, mesh_edges
from lightopt.mesh._triangle_mesh import TriangleMesh, face_areas, face_normals, transformed
from lightopt.mesh._winding import points_inside

__all__ = [
    "MESH_SUFFIXES",
    "UNITLESS_SUFFIXES",
    "LoadedMesh",
    "MeshDescription",
    "MeshEdges",
    "Patches",
    "SurfaceFinder",
    "SurfacePlace",
    "TriangleMesh",
    "estimate_patch_count",
    "face_areas",
    "face_normals",
    "load_mesh",
    "merge_rows",
    "mesh_edges",
    "points_inside",
    "refine",
    "surface_place",
    "transformed",
]
