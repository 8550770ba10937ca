"""Defects of a surface as geometry: profiles, where they lie, and what they do to normals and coefficients.

Knows points, normals and lengths; no mesh, no camera and no light. Defects are microns deep, so they turn normals and
move nothing: neither points nor silhouettes nor shadows. ``benchmarks/displaced.py`` has what that costs.
"""

from lightopt.defects._placed_defects import (
    PlacedDefect as PlacedDefect,
    mark_surface as mark_surface,
    surface_coordinates as surface_coordinates,
    tangent_direction as tangent_direction,
    tangent_references as tangent_references,
)
from lightopt.defects._shape import (
    BUILT_IN_CATALOGUE as BUILT_IN_CATALOGUE,
    MAX_SLOPE as MAX_SLOPE,
    SHAPE_KINDS as SHAPE_KINDS,
    SIZES as SIZES,
    CatalogueEntry as CatalogueEntry,
    DefectKind as DefectKind,
    DefectShape as DefectShape,
    depth_of_slope as depth_of_slope,
    radial_place as radial_place,
    slope_of_depth as slope_of_depth,
)
from lightopt.defects._statistic import (
    CATALOGUE_SHARE as CATALOGUE_SHARE,
    CONFIRMED as CONFIRMED,
    DARK as DARK,
    DEFAULT_FALSE_ALARMS as DEFAULT_FALSE_ALARMS,
    MOST_CHANGE as MOST_CHANGE,
    REGISTRATION_PX as REGISTRATION_PX,
    SCALES_PX as SCALES_PX,
    chance_score as chance_score,
    expected_change as expected_change,
    false_alarms_problem as false_alarms_problem,
    least_z as least_z,
    rest_of_images as rest_of_images,
)
from lightopt.defects._waviness import Waviness as Waviness, clipped_variance as clipped_variance
from lightopt.defects._whole_defects import (
    FORESHORTENINGS as FORESHORTENINGS,
    PLANNING_GRID as PLANNING_GRID,
    DefectHypotheses as DefectHypotheses,
    PixelMixture as PixelMixture,
    defect_hypotheses as defect_hypotheses,
    foreshortening_classes as foreshortening_classes,
    image_axes as image_axes,
    plane_to_image as plane_to_image,
    search_grid as search_grid,
    tangent_axis as tangent_axis,
)
