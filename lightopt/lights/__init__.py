"""Kinds of light, a module or two for each: where a light stands, its outline, and how its points shine.

Kernels of :mod:`lightopt.rendering` add up the light of a kind by the functions of its `_…_emission` module alone.
"""

from ._light_surface import (
    RADIANCE,
    SPHERE,
    Element,
    SurfaceLight,
    cone_elements,
    element_at,
    element_place,
    element_weight,
    frame_elements,
    half_pipe_elements,
    mixed_light,
    outlines,
    picture_light,
    place_on_element,
    plane_elements,
    sphere_elements,
    surface_light,
    surface_mesh,
)
from ._panel import (
    PICTURE,
    PanelLight,
    PanelNumbers,
    Pattern,
    attenuated,
    bar_pattern,
    half_diagonal,
    panel_corners,
    panel_grid,
    panel_numbers,
    panel_point,
    pattern_at,
    pattern_picture,
    picture_patterns,
    place_light,
    plane_places,
    pose_light,
    rectangles_meet,
    sine_pattern,
)
