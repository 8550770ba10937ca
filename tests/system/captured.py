"""Images as a camera would deliver them, with the truth known: noise, quantisation, saturation, a mesh of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lightopt import render
from lightopt.estimate.reflectance._estimate import Estimate, profile_regions
from lightopt.estimate.reflectance._samples import Samples
from lightopt.estimate.registration import Observation
from lightopt.optics import expose, image_rng
from lightopt.rendering import PostureImages
from lightopt.scene import Scene

PARTS = Path(__file__).parents[2] / "configs" / "parts"

RIG = """\
format: lightopt-rig/1
name: small
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [160, 120]
  pixel_size_um: 44
  image_distance_mm: 55
  sensor: {bit_depth: 8, read_noise_levels: 0.8, electrons_per_level: 60}
light_source: {size_mm: [60, 60], points: 4}
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45}
  - {name: light2, distance_mm: 330, elevation_deg: 60, azimuth_deg: 135}
  - {name: light3, distance_mm: 330, elevation_deg: 45, azimuth_deg: 225, gain: 0.8}
stage: {elevation_range_deg: [-45, 45], rotation_range_deg: [0, 360]}
"""

PART = """\
format: lightopt-part/1
name: knob
mesh: {file: knob.stl, units: mm}
postures: [{elevation_deg: 0, rotation_deg: 0}, {elevation_deg: -10, rotation_deg: 170}]
reflectance: {R_d: 45.0, R_s: 12500, sigma_rad: 0.0475}
"""


def profile_interval(found: Estimate, place: int) -> tuple[float, float]:
    """95 % interval of a parameter, over all of its regions and what is between them."""
    regions = profile_regions(found, place)
    return regions[0][0], regions[-1][1]


def expose_all(
    scene: Scene,
    images: list[PostureImages],
    *,
    seed: int = 0,
    exposures: tuple[float, ...] = (1.0,),
    garbage: float = 0.0,
) -> tuple[Observation, ...]:
    """8-bit images of rendered levels; a share of the pixels replaced by anything."""
    observations = []
    for p, posture in enumerate(images):
        for k, light in enumerate(posture.lights):
            for e, exposure in enumerate(exposures):
                rng = image_rng(seed, light=k, posture=p, exposure=e)
                levels = expose(
                    light.level,
                    sensor=scene.sensor,
                    exposure=exposure,
                    full_scale=scene.reflectance.full_scale,
                    rng=rng,
                )
                if garbage:
                    anything = rng.integers(0, 256, levels.shape)
                    levels = np.where(rng.random(levels.shape) < garbage, anything, levels)
                observations.append(observe(light.light, posture.posture, exposure, levels, scene))
    return tuple(observations)


def observe(light, posture, exposure, levels, scene) -> Observation:
    """A delivered image."""
    return Observation(
        light=light,
        posture=posture,
        exposure=exposure,
        levels=np.asarray(levels, dtype=np.float32),
        saturated=np.asarray(levels) >= scene.sensor.saturated_from,
        half_width=0.5,
        source=Path("made-by-test.png"),
    )


def captured(scene: Scene, *, reflectance=None, mesh=None, **options) -> tuple[Observation, ...]:
    """Images of a scene with another reflectance, and of another mesh of the same part."""
    truth = replace(scene, reflectance=reflectance or scene.reflectance, mesh=mesh or scene.mesh)
    return expose_all(truth, list(render(truth)), **options)


def remeasured(samples: Samples, observations: tuple[Observation, ...]) -> Samples:
    """The same pixels with the levels of other images of the same lights and postures."""
    return samples.with_images(observations)
