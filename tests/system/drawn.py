"""Images of a surface with a lobe of any form: the geometry is the package's, the light is summed here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from captured import observe
from reference import lambert

from lightopt.estimate.registration import Observation
from lightopt.geometry import RayCaster
from lightopt.optics import expose, image_rng
from lightopt.rendering import UNLIT, trace_pixels
from lightopt.rendering._pixels import visibility_of_lights
from lightopt.scene import Scene

NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)  # along each side of a panel, from −1 to 1


def draw_images(
    scene: Scene,
    caster: RayCaster,
    lobe: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    *,
    R_d: float,
    R_s: float,
    exposures: Sequence[float],
    form: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] = lambert,
) -> tuple[Observation, ...]:
    """Noisy images of all postures under all lights.

    lobe, form: Specular light per unit of R_s and diffuse light per unit of R_d, of unit normals, views and directions
        of light, shape (k, 3) each
    """
    levels = draw_levels(scene, caster, lobe, R_d=R_d, R_s=R_s, form=form)
    return expose_levels(scene, levels, exposures=exposures, seed=1)


def expose_levels(
    scene: Scene, levels: Sequence[np.ndarray], *, exposures: Sequence[float], seed: int
) -> tuple[Observation, ...]:
    """Noisy images of what :func:`draw_levels` returns."""
    images = []
    numbers = product(range(len(scene.postures)), range(len(scene.lights)))
    for (number, k), level in zip(numbers, levels, strict=True):
        for e, exposure in enumerate(exposures):
            rng = image_rng(seed, light=k, posture=number, exposure=e)
            delivered = expose(level, sensor=scene.sensor, exposure=exposure, full_scale=255.0, rng=rng)
            images.append(observe(scene.lights[k].name, scene.postures[number], exposure, delivered, scene))
    return tuple(images)


def draw_levels(
    scene: Scene,
    caster: RayCaster,
    lobe: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    *,
    R_d: float,
    R_s: float,
    form: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] = lambert,
) -> list[np.ndarray]:
    """The levels, posture by posture and light by light, before the camera."""
    images = []
    for posture in scene.postures:
        pixels = trace_pixels(scene, posture, caster)
        surface = pixels.surface
        for panel in pixels.view.lights:
            total = np.zeros(len(surface))
            for (s, of_s), (t, of_t) in product(zip(NODES, WEIGHTS, strict=True), repeat=2):
                place = panel.centre + 0.5 * (s * panel.size[0] * panel.across + t * panel.size[1] * panel.along)
                towards = place - surface.points
                towards /= np.linalg.norm(towards, axis=1)[:, None]
                directions = surface.normals, surface.views, towards
                value = R_d * form(*directions) + R_s * lobe(*directions)
                total += 0.25 * of_s * of_t * value
            lit = visibility_of_lights(pixels, [panel], caster)[0] != UNLIT
            level = np.zeros(pixels.shape, np.float32)
            level[pixels.row, pixels.column] = np.where(lit, panel.gain * total, 0.0)
            images.append(level)
    return images
