"""The scene: camera, panel lights, part and postures, placed in the world frame.

:func:`build_scene` is the only code that knows both the YAML's words and the physics.
"""

from lightopt.scene._build import (
    build_camera as build_camera,
    build_lights as build_lights,
    build_scene as build_scene,
    build_sensor as build_sensor,
    build_stage as build_stage,
    guess_unit as guess_unit,
    is_absurd as is_absurd,
    part_postures as part_postures,
    unit_hint as unit_hint,
    view_size as view_size,
)
from lightopt.scene._camera import (
    Distortion as Distortion,
    Framing as Framing,
    Lens as Lens,
    PinholeCamera as PinholeCamera,
    blur_diameter as blur_diameter,
    frame_part as frame_part,
    lens_share as lens_share,
    pixel_directions as pixel_directions,
    pixel_footprint as pixel_footprint,
    place_camera as place_camera,
    pose_camera as pose_camera,
    project as project,
    screen_window as screen_window,
    surface_footprint as surface_footprint,
    surface_share as surface_share,
    through_lens as through_lens,
    typical_blur as typical_blur,
)
from lightopt.scene._defects import (
    angle_outside_range as angle_outside_range,
    build_catalogue as build_catalogue,
    defect_facts as defect_facts,
    place_defects as place_defects,
)
from lightopt.scene._image_area import (
    area_in_view as area_in_view,
    lights_meet as lights_meet,
    obstructions as obstructions,
)
from lightopt.scene._lights import display_picture as display_picture
from lightopt.scene._point_spacing import (
    coarse_points as coarse_points,
    coarse_warnings as coarse_warnings,
    like_panels as like_panels,
    point_spacing as point_spacing,
    points_advice as points_advice,
)
from lightopt.scene._scene import (
    PartView as PartView,
    Placement as Placement,
    Scene as Scene,
    move_part as move_part,
    scene_of_region as scene_of_region,
    view_from_part as view_from_part,
    with_reflectances as with_reflectances,
)
from lightopt.scene._stage import (
    VIRTUAL_DEG_PER_S as VIRTUAL_DEG_PER_S,
    Stage as Stage,
    pace_text as pace_text,
    travel_order as travel_order,
    travel_s as travel_s,
)
