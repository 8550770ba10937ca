"""Whole images as a fit predicts them, penumbrae and silhouettes included."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lightopt.estimate.reflectance._criterion import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.registration import Observation
from lightopt.geometry import RayCaster
from lightopt.optics import Reflectance
from lightopt.rendering import render_posture
from lightopt.scene import Scene

Float64 = NDArray[np.float64]


def predict_images(
    scene: Scene,
    x: Float64,
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    threads: int | None = None,
) -> Iterator[tuple[Observation, NDArray[np.float32], NDArray[np.bool_]]]:
    """Per observation: itself, the sensor levels predicted for it, not clipped, and where the part is.

    x: Parameters, shape (K,), as :mod:`lightopt.estimate.reflectance._likelihood` orders them.
    """
    names = [light.name for light in scene.lights]
    reflectance = Reflectance(
        R_d=float(x[R_D]),
        R_s=math.exp(x[LOG_R_S]),
        sigma=math.exp(x[LOG_SIGMA]),
        full_scale=scene.reflectance.full_scale,
    )
    scale = scene.sensor.max_level / scene.reflectance.full_scale
    for posture in dict.fromkeys(o.posture for o in observations):
        shown = [o for o in observations if o.posture == posture]
        wanted = {o.light for o in shown}
        lights = tuple(light for light in scene.lights if light.name in wanted)
        images = render_posture(
            replace(scene, lights=lights, reflectance=reflectance), posture, caster=caster, threads=threads
        )
        by_name = {image.light: image.level for image in images.lights}
        for o in shown:
            gain = math.exp(x[FIRST_GAIN + names.index(o.light)])
            factor = np.float32(scale * o.exposure * gain)
            offset = np.float32(scene.sensor.black_level + x[DARK])
            yield o, by_name[o.light] * factor + offset, images.geometry.hit
