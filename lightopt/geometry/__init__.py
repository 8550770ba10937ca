"""Meshes of parts: load and repair them, give them normals, and refine them into patches.

The one home of trimesh and cascadio. Knows triangles and lengths, no camera and no light. Everything is in
the frame of the part's file, in mm, Z up.
"""

from lightopt.geometry._caster import Hits, RayCaster, resolve_hits
from lightopt.geometry._load_mesh import UNITLESS_SUFFIXES, load_mesh
from lightopt.geometry._nearest import SurfaceFinder, SurfacePlace, surface_place
from lightopt.geometry._patches import Patches, estimate_patch_count, longest_edges, refine
from lightopt.geometry._topology import merge_rows, mesh_edges
from lightopt.geometry._triangle_mesh import TriangleMesh, face_areas, face_normals, transformed
from lightopt.geometry._winding import points_inside

__all__ = [
    "UNITLESS_SUFFIXES",
    "Hits",
    "Patches",
    "RayCaster",
    "SurfaceFinder",
    "SurfacePlace",
    "TriangleMesh",
    "estimate_patch_count",
    "face_areas",
    "face_normals",
    "load_mesh",
    "longest_edges",
    "merge_rows",
    "mesh_edges",
    "points_inside",
    "refine",
    "resolve_hits",
    "surface_place",
    "transformed",
]
