"""Kinds of light, a module or two for each: where a light stands, its outline, and how its points shine.

Kernels of :mod:`lightopt.rendering` add up the light of a kind by the functions of its `_…_emission` module alone.
"""

from lightopt.lights._panel import (
    PanelLight as PanelLight,
    panel_corners as panel_corners,
    panel_grid as panel_grid,
    place_light as place_light,
    pose_light as pose_light,
    rectangles_meet as rectangles_meet,
    segments_blocked as segments_blocked,
)
from lightopt.lights._panel_emission import (
    PanelNumbers as PanelNumbers,
    attenuated as attenuated,
    half_diagonal as half_diagonal,
    panel_numbers as panel_numbers,
    panel_point as panel_point,
)
