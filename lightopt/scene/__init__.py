"""The scene: camera, panel lights, part and postures, placed in the world frame.

:func:`build_scene` is the only code that knows both the YAML's words and the physics.
"""

from lightopt.scene._build import (
    build_camera,
    build_lights,
    build_scene,
    build_sensor,
    chord_tolerance,
    part_postures,
    unit_hint,
)
from lightopt.scene._camera import (
    Framing,
    PinholeCamera,
    frame_part,
    pixel_directions,
    pixel_footprint,
    place_camera,
    project,
    screen_window,
)
from lightopt.scene._defects import build_catalogue, defect_facts, place_defects
from lightopt.scene._panel_light import (
    PanelLight,
    image_area,
    panel_corners,
    panel_grid,
    place_light,
    rectangles_meet,
    segments_blocked,
)
from lightopt.scene._part_size import guess_unit, is_absurd, view_size
from lightopt.scene._point_spacing import coarse_points, coarse_warnings, like_panels, point_spacing, points_advice
from lightopt.scene._scene import PartView, Placement, Scene, move_part, view_from_part
from lightopt.scene._stage_travel import VIRTUAL_DEG_PER_S, pace_text, travel_order, travel_s

__all__ = [
    "VIRTUAL_DEG_PER_S",
    "Framing",
    "PanelLight",
    "PartView",
    "PinholeCamera",
    "Placement",
    "Scene",
    "build_camera",
    "build_catalogue",
    "build_lights",
    "build_scene",
    "build_sensor",
    "chord_tolerance",
    "coarse_points",
    "coarse_warnings",
    "defect_facts",
    "frame_part",
    "guess_unit",
    "image_area",
    "is_absurd",
    "like_panels",
    "move_part",
    "pace_text",
    "panel_corners",
    "panel_grid",
    "part_postures",
    "pixel_directions",
    "pixel_footprint",
    "place_camera",
    "place_defects",
    "place_light",
    "point_spacing",
    "points_advice",
    "project",
    "rectangles_meet",
    "screen_window",
    "segments_blocked",
    "travel_order",
    "travel_s",
    "unit_hint",
    "view_from_part",
    "view_size",
]
