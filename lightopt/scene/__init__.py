"""The scene: camera, panel lights, part and postures, placed in the world frame.

:func:`build_scene` is the only code that knows both the YAML's words and the physics.
"""

from ._build import (
    build_camera,
    build_lights,
    build_scene,
    build_sensor,
    build_stage,
    guess_unit,
    is_absurd,
    part_postures as part_postures,
    unit_hint,
    view_size,
)
from ._camera import (
    Distortion,
    Framing,
    Lens,
    PinholeCamera,
    blur_diameter,
    frame_part,
    lens_share,
    pixel_directions,
    pixel_footprint,
    place_camera,
    pose_camera,
    project,
    screen_window,
    surface_footprint,
    surface_share,
    through_lens,
    typical_blur,
)
from ._defects import angle_outside_range, build_catalogue, defect_facts, place_defects
from ._image_area import area_in_view, image_area, lights_meet, obstructions
from ._lights import display_picture, housing_corners
from ._point_spacing import coarse_points, coarse_warnings, like_panels, point_spacing, points_advice
from ._scene import (
    MOST_MOTION_PX,
    Housings,
    Motion,
    PartView,
    Placement,
    Scene,
    at_rest_warnings,
    motion_blur,
    move_part,
    scene_of_region,
    view_from_part,
    with_reflectances,
)
from ._stage import VIRTUAL_DEG_PER_S, Stage, pace_text, travel_order, travel_s
