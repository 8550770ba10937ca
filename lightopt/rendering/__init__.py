"""From a scene to what the camera would see, linear and exact; and the patches that optimisation works on."""

from lightopt.rendering._converged import ConvergedPanel, converged_panel, shade_converged
from lightopt.rendering._images import (
    Geometry,
    LightImage,
    PostureImages,
    Progress,
    cast_rays_at,
    render,
    render_posture,
)
from lightopt.rendering._points import shade_points
from lightopt.rendering._surface import SurfacePoints, interpolate_surface, trace_samples

__all__ = [
    "ConvergedPanel",
    "Geometry",
    "LightImage",
    "PostureImages",
    "Progress",
    "SurfacePoints",
    "cast_rays_at",
    "converged_panel",
    "interpolate_surface",
    "render",
    "render_posture",
    "shade_converged",
    "shade_points",
    "trace_samples",
]
