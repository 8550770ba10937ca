"""How bright the mirror image of a panel is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lightopt.rendering._converged import converged_panel, shade_converged
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import PanelLight, Scene


def highlight_level(scene: Scene, light: PanelLight) -> float:
    """Specular level at exposure 1 of a surface at the origin that mirrors a panel's centre [grey level].

    That of the panel as a whole, whatever its number of points: R_s is what a single point of light would reach.

    Parameters
    ----------
    light: World frame
    """
    origin = np.zeros((1, 3))
    view = scene.camera.position / np.linalg.norm(scene.camera.position)
    half = view + light.centre / np.linalg.norm(light.centre)
    if (length := float(np.linalg.norm(half))) < 1e-9:
        return 0.0  # the light is opposite the camera
    normal = half[None] / length
    surface = SurfacePoints(origin, normal, normal, view[None], np.ones(1, np.bool_))
    whole = replace(light, points="auto")
    panel = converged_panel(whole, centre=origin[0], radius=1.0)
    _, specular = shade_converged(
        surface, panel, sample=np.zeros(1, np.intp), shape=(1, 1), reflectance=scene.reflectance, caster=None
    )
    return float(scene.reflectance.R_s * specular[0] * light.total_weight / whole.total_weight)
