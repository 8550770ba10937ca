"""Defects of a surface as geometry: profiles, where they lie, and what they do to normals and coefficients.

Knows points, normals and lengths; no mesh, no camera and no light. Defects are microns deep, so they turn normals and
move nothing: neither points nor silhouettes nor shadows.
"""

from lightopt.defects._catalogue import BUILT_IN_CATALOGUE, CatalogueEntry
from lightopt.defects._mark import Marks, mark_surface
from lightopt.defects._pixel import PIXEL_RATIOS, grid_shares, pixel_shares
from lightopt.defects._placed import (
    LEAST_NORMAL_COSINE,
    STEEPEST_DEPARTURE,
    PlacedDefect,
    surface_coordinates,
    tangent_direction,
    tangent_references,
)
from lightopt.defects._profile import height, height_gradient, radial_place
from lightopt.defects._shape import (
    DEFECT_KINDS,
    MAX_SLOPE,
    SHAPE_KINDS,
    DefectKind,
    DefectShape,
    depth_of_slope,
    slope_of_depth,
)

__all__ = [
    "BUILT_IN_CATALOGUE",
    "DEFECT_KINDS",
    "LEAST_NORMAL_COSINE",
    "MAX_SLOPE",
    "PIXEL_RATIOS",
    "SHAPE_KINDS",
    "STEEPEST_DEPARTURE",
    "CatalogueEntry",
    "DefectKind",
    "DefectShape",
    "Marks",
    "PlacedDefect",
    "depth_of_slope",
    "grid_shares",
    "height",
    "height_gradient",
    "mark_surface",
    "pixel_shares",
    "radial_place",
    "slope_of_depth",
    "surface_coordinates",
    "tangent_direction",
    "tangent_references",
]
