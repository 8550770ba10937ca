"""Whole images that a fit predicts, and their saturated regions compared with measured ones (paper, section 4.4)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.estimate.reflectance._criterion import DARK, FIRST_GAIN, LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.registration import Observation
from lightopt.geometry import RayCaster
from lightopt.optics import Reflectance, saturated_region
from lightopt.rendering import render_posture
from lightopt.scene import Scene


def predict_images(
    scene: Scene,
    x: Float64,
    observations: Sequence[Observation],
    *,
    caster: RayCaster,
    threads: int | None = None,
) -> Iterator[tuple[Observation, Float32, Bool]]:
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


@dataclass(frozen=True, kw_only=True)
class PointsRow:
    """The fit with one number of points per panel: a row of the paper's Table 1.

    area, measured_area: Saturated pixels of all images together, predicted and measured [px].
    perimeter, measured_perimeter: Of the saturated regions of all images together [px].
    likelihood: Mean log-likelihood of a level [nat]; None by a method that knows none. The number of points with the
        greatest reproduces the images best: area and perimeter of a noisy image hardly tell two numbers of points
        apart.
    """

    points: int | Literal["auto"]
    R_d: float
    R_s: float
    sigma: float
    area: int
    measured_area: int
    perimeter: float
    measured_perimeter: float
    likelihood: float | None

    @property
    def misfit(self) -> float:
        """Relative deviations of area and perimeter, added (paper, section 4.4)."""
        area = abs(self.area - self.measured_area) / max(self.measured_area, 1)
        return area + abs(self.perimeter - self.measured_perimeter) / max(self.measured_perimeter, 1.0)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "points": self.points,
            "R_d": float(f"{self.R_d:.6g}"),
            "R_s": float(f"{self.R_s:.6g}"),
            "sigma_rad": float(f"{self.sigma:.6g}"),
            "area_px": self.area,
            "measured_area_px": self.measured_area,
            "perimeter_px": round(self.perimeter, 1),
            "measured_perimeter_px": round(self.measured_perimeter, 1),
            "mean_log_likelihood": None if self.likelihood is None else float(f"{self.likelihood:.6g}"),
        }


def compare_regions(
    scene: Scene,
    x: Float64,
    observations: tuple[Observation, ...],
    *,
    points: int | Literal["auto"],
    caster: RayCaster,
    likelihood: float | None = None,
    threads: int | None = None,
) -> PointsRow:
    """Render all images with a fit and compare the saturated regions with the measured ones.

    Both are taken from whole levels, since the camera delivers no others.

    x: Parameters, shape (K,), as :mod:`lightopt.estimate.reflectance._likelihood` orders them.
    """
    top = scene.sensor.saturated_from
    areas, perimeters = np.zeros(2), np.zeros(2)
    for seen, levels, _ in predict_images(scene, x, observations, caster=caster, threads=threads):
        delivered = np.clip(np.floor(levels + 0.5), 0.0, scene.sensor.max_level)
        pair: tuple[Float32, Float32] = delivered, seen.levels
        for i, image in enumerate(pair):
            region = saturated_region(image, top)
            areas[i] += region.area
            perimeters[i] += region.perimeter
    return PointsRow(
        points=points,
        R_d=float(x[R_D]),
        R_s=math.exp(x[LOG_R_S]),
        sigma=math.exp(x[LOG_SIGMA]),
        area=int(areas[0]),
        measured_area=int(areas[1]),
        perimeter=float(perimeters[0]),
        measured_perimeter=float(perimeters[1]),
        likelihood=likelihood,
    )
