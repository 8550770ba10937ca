"""Defects of a surface as geometry: profiles, where they lie, and what they do to normals and coefficients.

Knows points, normals and lengths; no mesh, no camera and no light. Defects are microns deep, so they turn normals and
move nothing: neither points nor silhouettes nor shadows.
"""

from lightopt.defects._catalogue import BUILT_IN_CATALOGUE, CatalogueEntry
from lightopt.defects._pixel_shares import PIXEL_RATIOS, pixel_shares
from lightopt.defects._placed_defects import (
    PlacedDefect,
    mark_surface,
    surface_coordinates,
    tangent_direction,
    tangent_references,
)
from lightopt.defects._shape import (
    MAX_SLOPE,
    SHAPE_KINDS,
    DefectKind,
    DefectShape,
    depth_of_slope,
    radial_place,
    slope_of_depth,
)

__all__ = [
    "BUILT_IN_CATALOGUE",
    "MAX_SLOPE",
    "PIXEL_RATIOS",
    "SHAPE_KINDS",
    "CatalogueEntry",
    "DefectKind",
    "DefectShape",
    "PlacedDefect",
    "depth_of_slope",
    "mark_surface",
    "pixel_shares",
    "radial_place",
    "slope_of_depth",
    "surface_coordinates",
    "tangent_direction",
    "tangent_references",
]
