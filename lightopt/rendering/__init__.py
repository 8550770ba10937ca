"""From a scene to what the camera would see, linear and exact; and the patches that optimisation works on."""

from lightopt.rendering._converged_panel import converged_panel, highlight_level, shade_converged, shadow_targets
from lightopt.rendering._image_set import BACK_FACE_SHARE, RenderOptions, render_image_set, set_manifest
from lightopt.rendering._images import PostureImages, cast_rays_at, rays_of_images, render, render_posture
from lightopt.rendering._light_layer import LightLayer, light_layer
from lightopt.rendering._patches import (
    DEFAULT_PATCH_BUDGET,
    PatchTable,
    build_patches,
    camera_visibility,
    grain_of,
    patch_pixels,
    patch_positions,
    patches_for_edge,
    visible_points,
)
from lightopt.rendering._pixels import UNLIT, WHOLE, PosturePixels, panel_visibility, trace_pixels
from lightopt.rendering._point_lights import shade_points
from lightopt.rendering._scene_checks import panels_in_part, refuse_unusable_scene, too_few_pixels
from lightopt.rendering._surface import GRAZING_COSINE, GRAZING_DEG, SurfacePoints, trace_samples
from lightopt.rendering._surface_variants import shade_variants, surface_variants

__all__ = [
    "BACK_FACE_SHARE",
    "DEFAULT_PATCH_BUDGET",
    "GRAZING_COSINE",
    "GRAZING_DEG",
    "UNLIT",
    "WHOLE",
    "LightLayer",
    "PatchTable",
    "PostureImages",
    "PosturePixels",
    "RenderOptions",
    "SurfacePoints",
    "build_patches",
    "camera_visibility",
    "cast_rays_at",
    "converged_panel",
    "grain_of",
    "highlight_level",
    "light_layer",
    "panel_visibility",
    "panels_in_part",
    "patch_pixels",
    "patch_positions",
    "patches_for_edge",
    "rays_of_images",
    "refuse_unusable_scene",
    "render",
    "render_image_set",
    "render_posture",
    "set_manifest",
    "shade_converged",
    "shade_points",
    "shade_variants",
    "shadow_targets",
    "surface_variants",
    "too_few_pixels",
    "trace_pixels",
    "trace_samples",
    "visible_points",
]
