"""Simulated images of a small rig with faults, for tests of verification."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from lightopt.config import load_part, load_rig
from lightopt.estimate.registration import Observation
from lightopt.estimate.verification import VerifyLimits
from lightopt.estimate.verification._parameters import Parameters
from lightopt.optics import expose, image_rng
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import build_scene


def small_scene(bench, *, points=1):
    """The small rig with twice its pixels per side and panels of so many points, and its part."""
    scene = build_scene(load_rig(bench.rig), load_part(bench.part))
    camera = scene.camera
    return replace(
        scene,
        lights=tuple(replace(light, points=points) for light in scene.lights),
        camera=replace(camera, width=2 * camera.width, height=2 * camera.height, pixel_size=0.5 * camera.pixel_size),
    )


def parameters_of(scene):
    """The faults that a rig may have."""
    return Parameters.of(scene, VerifyLimits())


def rig_with(scene, **faults):
    """Parameters of a rig with faults, by kind and light."""
    p = parameters_of(scene)
    theta = np.zeros(p.size)
    for name, values in faults.items():
        kind, _, light = name.partition(" ")
        theta[p.group(kind, light).where] = values
    return theta


def images_of(scene, theta, *, blur=0.0):
    """Linear images of a rig with faults, by posture and light [grey level]; the black level is left out."""
    p, caster = parameters_of(scene), cast_rays_at(scene)
    found = {}
    for posture in scene.postures:
        view = p.view(scene, posture, theta)
        world = replace(
            scene,
            camera=view.camera.moved(view.rotation, view.translation),
            lights=tuple(light.moved(view.rotation, view.translation) for light in view.lights),
        )
        for image in render_posture(world, posture, caster=caster).lights:
            log = theta[p.group("exposure").first] + theta[p.group("gain", image.light).first]
            level = image.level * np.float32(math.exp(log))
            found[posture, image.light] = ndimage.gaussian_filter(level, blur) if blur else level
    return found


def observed(scene, images, *, seed, black=0.0):
    """Images with the sensor's noise; its black level is off by `black`."""
    sensor = replace(scene.sensor, black_level=scene.sensor.black_level + black)
    found = []
    for j, posture in enumerate(scene.postures):
        for i, light in enumerate(scene.lights):
            rng = image_rng(seed, light=i, posture=j, exposure=0)
            full_scale = scene.reflectance.full_scale
            png = expose(images[posture, light.name], sensor=sensor, exposure=1.0, full_scale=full_scale, rng=rng)
            found.append(
                Observation(
                    light=light.name,
                    posture=posture,
                    exposure=1.0,
                    levels=png.astype(np.float32),
                    saturated=png >= sensor.saturated_from,
                    half_width=0.5,
                    source=Path("simulated", f"{i}-{j}.png"),
                )
            )
    return found
