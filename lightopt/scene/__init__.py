"""The scene: camera, panel lights, part and postures, placed in the world frame.

:func:`build_scene` is the only code that knows both the YAML's words and the physics.
"""

from lightopt.scene._build import build_scene
from lightopt.scene._camera import (
    Distortion,
    PinholeCamera,
    pixel_directions,
    pixel_footprint,
    place_camera,
    project,
)
from lightopt.scene._framing import Framing, frame_part, screen_window
from lightopt.scene._light import PanelLight, panel_grid, place_light
from lightopt.scene._scene import PartView, Scene, view_from_part
from lightopt.transforms import Posture

__all__ = [
    "Distortion",
    "Framing",
    "PanelLight",
    "PartView",
    "PinholeCamera",
    "Posture",
    "Scene",
    "build_scene",
    "frame_part",
    "panel_grid",
    "pixel_directions",
    "pixel_footprint",
    "place_camera",
    "place_light",
    "project",
    "screen_window",
    "view_from_part",
]
