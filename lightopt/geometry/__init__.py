"""Meshes of parts: load and repair them, give them normals, and refine them into patches.

The one home of trimesh and cascadio. Knows triangles and lengths, no camera and no light. Everything is in
the frame of the part's file, in mm, Z up.
"""

from lightopt.geometry._caster import Hits as Hits, RayCaster as RayCaster, resolve_hits as resolve_hits
from lightopt.geometry._load_mesh import (
    UNITLESS_SUFFIXES as UNITLESS_SUFFIXES,
    LoadedMesh as LoadedMesh,
    load_mesh as load_mesh,
)
from lightopt.geometry._mesh_formats import box_mesh as box_mesh, sphere_mesh as sphere_mesh, stl_bytes as stl_bytes
from lightopt.geometry._patches import (
    Patches as Patches,
    estimate_patch_count as estimate_patch_count,
    longest_edges as longest_edges,
    refine as refine,
)
from lightopt.geometry._regions import (
    BoxRegion as BoxRegion,
    ColouredRegion as ColouredRegion,
    MaskRegion as MaskRegion,
    NamedRegion as NamedRegion,
    Region as Region,
    RegionAtPoints as RegionAtPoints,
    mesh_with_regions as mesh_with_regions,
)
from lightopt.geometry._topology import (
    merge_rows as merge_rows,
    mesh_edges as mesh_edges,
    points_inside as points_inside,
)
from lightopt.geometry._triangle_mesh import (
    Brushing as Brushing,
    CurvedBrushing as CurvedBrushing,
    RoundBrushing as RoundBrushing,
    StraightBrushing as StraightBrushing,
    SurfaceFinder as SurfaceFinder,
    SurfacePlace as SurfacePlace,
    TriangleMesh as TriangleMesh,
    face_areas as face_areas,
    face_normals as face_normals,
    surface_place as surface_place,
    transformed as transformed,
)
