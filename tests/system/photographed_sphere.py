"""Images of a sphere by another renderer, plain NumPy, and of another surface than the model's.

The surface is measured-like: diffuse light falls off with a power of the cosine, and the highlight has two lobes, the
wide one with the tails of GGX (Trowbridge and Reitz 1975, doi:10.1364/JOSA.65.000531).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lightopt.estimate.registration import Observation
from lightopt.scene import Scene

GRID = 6
"""Point lights along each side of a panel."""


def photograph_sphere(
    scene: Scene,
    centre: np.ndarray,
    radius: float,
    *,
    R_d: float = 40.0,
    narrow: tuple[float, float] = (9000.0, 0.035),
    wide: tuple[float, float] = (1500.0, 0.15),
    exponent: float = 1.12,
    seed: int = 0,
) -> tuple[Observation, ...]:
    """8-bit images of a sphere seen straight from above, one per light of the scene.

    Parameters
    ----------
    scene
        For camera, lights and sensor.
    centre, radius
        Of the sphere, world frame [mm].
    R_d, exponent
        Diffuse coefficient [grey level] and power of the cosine.
    narrow, wide
        Height [grey level] and width [rad] of the Gaussian lobe, and of the one with tails.
    seed
        Of the noise.
    """
    camera, sensor = scene.camera, scene.sensor
    eye = np.asarray(camera.position, float)
    assert np.allclose(eye[:2], 0.0)
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pitch = camera.pixel_size / camera.image_distance
    ray = np.stack(
        [(column - camera.width / 2) * pitch, -(row - camera.height / 2) * pitch, -np.ones_like(row)], axis=-1
    )
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    toward = ray @ (eye - centre)
    root = toward**2 - (np.sum((eye - centre) ** 2) - radius**2)
    hit = root > 0.0
    t = -toward - np.sqrt(np.where(hit, root, 0.0))
    point = eye + t[..., None] * ray
    normal = (point - centre) / radius
    rng = np.random.default_rng(seed)
    images = []
    for light in scene.lights:
        level = np.zeros(hit.shape)
        for spot in _points(np.asarray(light.centre, float), light.size):
            to_light = spot - point
            to_light /= np.linalg.norm(to_light, axis=-1, keepdims=True)
            half = to_light - ray
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            cos_i = np.clip(np.sum(normal * to_light, axis=-1), 0.0, None)
            cos_o = np.clip(-np.sum(normal * ray, axis=-1), 0.05, None)
            delta = np.arccos(np.clip(np.sum(normal * half, axis=-1), -1.0, 1.0))
            lobes = narrow[0] * np.exp(-0.5 * (delta / narrow[1]) ** 2)
            lobes += wide[0] / (1.0 + (np.tan(delta) / wide[1]) ** 2) ** 2
            level += np.where(cos_i > 0.0, R_d * cos_i**exponent + lobes / cos_o, 0.0) / GRID**2
        level = np.where(hit, level, 0.0) * light.gain * sensor.max_level / 255.0
        noise = np.sqrt(sensor.noise_variance(level) - 1.0 / 12.0) * rng.normal(size=level.shape)
        seen = np.clip(np.floor(level + noise + 0.5), 0, sensor.max_level).astype(np.float32)
        images.append(
            Observation(
                light=light.name,
                posture=scene.postures[0],
                exposure=1.0,
                levels=seen,
                saturated=seen >= sensor.saturated_from,
                half_width=0.5,
                source=Path("photographed-by-test.png"),
            )
        )
    return tuple(images)


def _points(centre: np.ndarray, size: tuple[float, float]) -> list[np.ndarray]:
    # cell centres of a panel that faces the origin
    distance = np.linalg.norm(centre)
    d = centre / distance
    across = np.cross([0.0, 0.0, 1.0], d)
    across /= np.linalg.norm(across)
    up = np.cross(d, across)
    steps = (np.arange(GRID) + 0.5) / GRID - 0.5
    return [centre + u * size[0] * across + v * size[1] * up for u in steps for v in steps]
