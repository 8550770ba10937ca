"""Meshes of parts: load and repair them, give them normals, and refine them into patches.

The one home of trimesh and cascadio. Knows triangles and lengths, no camera and no light. Everything is in
the frame of the part's file, in mm, Z up.
"""

from ._caster import Hits, RayCaster, resolve_hits
from ._load_mesh import UNITLESS_SUFFIXES, LoadedMesh, load_mesh
from ._mesh_formats import box_mesh, sphere_mesh, stl_bytes as stl_bytes
from ._patches import Patches, estimate_patch_count, longest_edges, refine
from ._regions import BoxRegion, ColouredRegion, MaskRegion, NamedRegion, Region, RegionAtPoints, mesh_with_regions
from ._silhouettes import Silhouettes, triangles_before, triangles_in_row
from ._texture import TextureBrushing, texture_brushing
from ._topology import merge_rows, mesh_edges, points_inside
from ._triangle_mesh import (
    Brushing,
    CurvedBrushing,
    RoundBrushing,
    StraightBrushing,
    SurfaceFinder,
    SurfacePlace,
    TriangleMesh,
    face_areas,
    face_normals,
    surface_place,
    transformed,
)
