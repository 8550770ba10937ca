"""From a scene to what the camera would see, linear and exact; and the patches that optimisation works on."""

from ._bounced_patches import BouncedPatches
from ._converged_panel import channel_groups, highlight_level, panel_to_shade, shade_isolated, shadow_targets
from ._image_set import (
    BACK_FACE_SHARE,
    RenderOptions as RenderOptions,
    render_image_set as render_image_set,
    set_manifest,
)
from ._images import (
    Geometry,
    LightImage,
    PostureImages,
    cast_rays_at as cast_rays_at,
    rays_of_images,
    render,
    render_lights,
    render_pixels,
    render_posture,
)
from ._light_layer import LightLayer, light_layer, specular_of_layers
from ._patches import (
    DEFAULT_PATCH_BUDGET,
    PatchTable as PatchTable,
    build_patches as build_patches,
    camera_visibility,
    grain_of,
    marks_by_area,
    patch_pixels as patch_pixels,
    patch_positions,
    patches_for_edge,
    visible_points,
)
from ._pixels import (
    CREASE_COSINE,
    MARGIN_PX,
    PARTLY,
    STEADY,
    UNLIT,
    WHOLE,
    PosturePixels,
    mask_pixels,
    trace_pixels,
    visibility_of_lights,
    visible_shares,
)
from ._scene_checks import panels_in_part, refuse_unusable_scene, too_few_pixels
from ._surface import GRAZING_DEG, SurfacePoints, hidden_by, trace_samples
from ._surface_light import light_of_channels, mirrored_places
from ._surface_variants import shade_variants, surface_variants
