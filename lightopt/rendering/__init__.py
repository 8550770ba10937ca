"""From a scene to what the camera would see, linear and exact; and the patches that optimisation works on."""

from lightopt.rendering._converged import converged_panel, highlight_level, shade_converged
from lightopt.rendering._image_set import RenderOptions, RenderProgress, render_image_set
from lightopt.rendering._images import (
    PostureImages,
    cast_rays_at,
    render,
    render_posture,
)
from lightopt.rendering._layers import LightLayer, light_layer
from lightopt.rendering._patches import (
    DEFAULT_PATCH_BUDGET,
    PatchTable,
    build_patches,
    grain_of,
    patch_pixels,
    patch_positions,
    patches_for_edge,
    sight_of,
    visible_points,
)
from lightopt.rendering._pixels import UNLIT, WHOLE, PosturePixels, panel_verdict, trace_pixels
from lightopt.rendering._points import shade_points
from lightopt.rendering._scene_checks import panels_in_part, refuse_unusable_scene, too_few_pixels
from lightopt.rendering._surface import GRAZING_COSINE, GRAZING_DEG, SurfacePoints, trace_samples
from lightopt.rendering._variants import shade_variants, surface_variants

__all__ = [
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
    "RenderProgress",
    "SurfacePoints",
    "build_patches",
    "cast_rays_at",
    "converged_panel",
    "grain_of",
    "highlight_level",
    "light_layer",
    "panel_verdict",
    "panels_in_part",
    "patch_pixels",
    "patch_positions",
    "patches_for_edge",
    "refuse_unusable_scene",
    "render",
    "render_image_set",
    "render_posture",
    "shade_converged",
    "shade_points",
    "shade_variants",
    "sight_of",
    "surface_variants",
    "too_few_pixels",
    "trace_pixels",
    "trace_samples",
    "visible_points",
]
