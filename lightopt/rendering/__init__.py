"""From a scene to what the camera would see, linear and exact; and the patches that optimisation works on."""

from lightopt.rendering._converged import ConvergedPanel, converged_panel, shade_converged
from lightopt.rendering._grazing import GRAZING_COSINE, GRAZING_DEG
from lightopt.rendering._highlight import highlight_level
from lightopt.rendering._hopeless import (
    PanelInPart,
    TooFewPixels,
    panels_in_part,
    refuse_hopeless,
    too_few_pixels,
)
from lightopt.rendering._image_set import RenderedSet, RenderOptions, Report, render_image_set
from lightopt.rendering._images import (
    Geometry,
    LightImage,
    PostureImages,
    Progress,
    cast_rays_at,
    render,
    render_posture,
)
from lightopt.rendering._layers import LightLayer, light_layer
from lightopt.rendering._patches import (
    DEFAULT_PATCH_BUDGET,
    PatchPixels,
    PatchTable,
    build_patches,
    grain_of,
    patch_pixels,
    patch_positions,
    patches_for_edge,
    sight_of,
    visible_points,
)
from lightopt.rendering._pixels import (
    LEFT_OUT,
    UNLIT,
    WHOLE,
    PosturePixels,
    panel_verdict,
    trace_pixels,
)
from lightopt.rendering._points import shade_points
from lightopt.rendering._surface import SurfacePoints, interpolate_surface, trace_samples
from lightopt.rendering._threads import Task, available_processors, end_if_stopped, in_threads, run_all
from lightopt.rendering._variants import SurfaceVariants, VariantLevels, shade_variants, surface_variants

__all__ = [
    "DEFAULT_PATCH_BUDGET",
    "GRAZING_COSINE",
    "GRAZING_DEG",
    "LEFT_OUT",
    "UNLIT",
    "WHOLE",
    "ConvergedPanel",
    "Geometry",
    "LightImage",
    "LightLayer",
    "PanelInPart",
    "PatchPixels",
    "PatchTable",
    "PostureImages",
    "PosturePixels",
    "Progress",
    "RenderOptions",
    "RenderedSet",
    "Report",
    "SurfacePoints",
    "SurfaceVariants",
    "Task",
    "TooFewPixels",
    "VariantLevels",
    "available_processors",
    "build_patches",
    "cast_rays_at",
    "converged_panel",
    "end_if_stopped",
    "grain_of",
    "highlight_level",
    "in_threads",
    "interpolate_surface",
    "light_layer",
    "panel_verdict",
    "panels_in_part",
    "patch_pixels",
    "patch_positions",
    "patches_for_edge",
    "refuse_hopeless",
    "render",
    "render_image_set",
    "render_posture",
    "run_all",
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
