"""Defects of a surface as geometry: profiles, where they lie, and what they do to normals and coefficients.

Knows points, normals and lengths; no mesh, no camera and no light. Defects are microns deep, so they turn normals and
move nothing: neither points nor silhouettes nor shadows. ``benchmarks/displaced.py`` has what that costs.
"""

from ._placed_defects import PlacedDefect, mark_surface, surface_coordinates, tangent_direction, tangent_references
from ._shape import (
    BUILT_IN_CATALOGUE,
    MAX_SLOPE,
    SHAPE_KINDS,
    SIZES,
    CatalogueEntry,
    DefectKind,
    DefectShape,
    depth_of_slope,
    radial_place,
    slope_of_depth,
)
from ._statistic import (
    CATALOGUE_SHARE,
    CONFIRMED,
    DARK,
    DEFAULT_FALSE_ALARMS,
    MOST_CHANGE,
    REGISTRATION_PX,
    SCALES_PX,
    chance_score,
    expected_change,
    false_alarms_problem,
    least_z,
    rest_of_images,
)
from ._waviness import Waviness, clipped_variance
from ._whole_defects import (
    FORESHORTENINGS,
    PLANNING_GRID,
    DefectHypotheses,
    PixelMixture,
    defect_hypotheses,
    foreshortening_classes,
    image_axes,
    plane_to_image,
    search_grid,
    tangent_axis,
)
