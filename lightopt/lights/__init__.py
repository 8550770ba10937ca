"""Kinds of light, a module or two for each: where a light stands, its outline, and how its points shine.

Kernels of :mod:`lightopt.rendering` add up the light of a kind by the functions of its `_…_emission` module alone.
"""

from lightopt.lights._light_surface import (
    RADIANCE as RADIANCE,
    SPHERE as SPHERE,
    Element as Element,
    SurfaceLight as SurfaceLight,
    cone_elements as cone_elements,
    element_at as element_at,
    element_place as element_place,
    element_weight as element_weight,
    frame_elements as frame_elements,
    half_pipe_elements as half_pipe_elements,
    mixed_light as mixed_light,
    outlines as outlines,
    picture_light as picture_light,
    place_on_element as place_on_element,
    plane_elements as plane_elements,
    sphere_elements as sphere_elements,
    surface_light as surface_light,
    surface_mesh as surface_mesh,
)
from lightopt.lights._panel import (
    PanelLight as PanelLight,
    PanelNumbers as PanelNumbers,
    attenuated as attenuated,
    half_diagonal as half_diagonal,
    panel_corners as panel_corners,
    panel_grid as panel_grid,
    panel_numbers as panel_numbers,
    panel_point as panel_point,
    place_light as place_light,
    plane_places as plane_places,
    pose_light as pose_light,
    rectangles_meet as rectangles_meet,
)
from lightopt.lights._pattern import (
    PICTURE as PICTURE,
    Pattern as Pattern,
    bar_pattern as bar_pattern,
    pattern_at as pattern_at,
    pattern_picture as pattern_picture,
    picture_patterns as picture_patterns,
    sine_pattern as sine_pattern,
)
