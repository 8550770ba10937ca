"""From a scene to what the camera would see, linear and exact; and the patches that optimisation works on."""

from lightopt.rendering._converged_panel import (
    channel_groups as channel_groups,
    highlight_level as highlight_level,
    panel_to_shade as panel_to_shade,
    shade_isolated as shade_isolated,
    shadow_targets as shadow_targets,
)
from lightopt.rendering._image_set import (
    BACK_FACE_SHARE as BACK_FACE_SHARE,
    RenderOptions as RenderOptions,
    render_image_set as render_image_set,
    set_manifest as set_manifest,
)
from lightopt.rendering._images import (
    Geometry as Geometry,
    PostureImages as PostureImages,
    cast_rays_at as cast_rays_at,
    rays_of_images as rays_of_images,
    render as render,
    render_lights as render_lights,
    render_pixels as render_pixels,
    render_posture as render_posture,
)
from lightopt.rendering._light_layer import (
    LightLayer as LightLayer,
    light_layer as light_layer,
    specular_of_layers as specular_of_layers,
)
from lightopt.rendering._patches import (
    DEFAULT_PATCH_BUDGET as DEFAULT_PATCH_BUDGET,
    PatchTable as PatchTable,
    build_patches as build_patches,
    camera_visibility as camera_visibility,
    grain_of as grain_of,
    patch_pixels as patch_pixels,
    patch_positions as patch_positions,
    patches_for_edge as patches_for_edge,
    visible_points as visible_points,
)
from lightopt.rendering._pixels import (
    CREASE_COSINE as CREASE_COSINE,
    UNLIT as UNLIT,
    WHOLE as WHOLE,
    PosturePixels as PosturePixels,
    mask_pixels as mask_pixels,
    trace_pixels as trace_pixels,
    visibility_of_lights as visibility_of_lights,
)
from lightopt.rendering._scene_checks import (
    panels_in_part as panels_in_part,
    refuse_unusable_scene as refuse_unusable_scene,
    too_few_pixels as too_few_pixels,
)
from lightopt.rendering._surface import (
    GRAZING_DEG as GRAZING_DEG,
    SurfacePoints as SurfacePoints,
    hidden_by as hidden_by,
    trace_samples as trace_samples,
)
from lightopt.rendering._surface_light import light_of_channels as light_of_channels, mirrored_places as mirrored_places
from lightopt.rendering._surface_variants import shade_variants as shade_variants, surface_variants as surface_variants
