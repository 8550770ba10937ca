"""How area and perimeter of the saturated region compare with the measured ones (paper, section 4.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.align import Observation
from lightopt.fit._estimate import Estimate
from lightopt.fit._predict import predict_images
from lightopt.raycast import RayCaster
from lightopt.scene import Scene
from lightopt.sensor import saturated_region

__all__ = ["PointsRow", "compare_regions"]


@dataclass(frozen=True, kw_only=True)
class PointsRow:
    """The fit with one number of points per panel: a row of the paper's Table 1.

    Attributes
    ----------
    points
        m, or ``"auto"``.
    R_d, R_s
        [grey level].
    sigma
        [rad].
    area, measured_area
        Saturated pixels of all images together, predicted and measured [px].
    perimeter, measured_perimeter
        Of the saturated regions of all images together [px].
    likelihood
        Mean log-likelihood of a level [nat]; the number of points with the greatest reproduces the images best. Area
        and perimeter of a noisy image hardly tell two numbers of points apart.
    """

    points: int | Literal["auto"]
    R_d: float
    R_s: float
    sigma: float
    area: int
    measured_area: int
    perimeter: float
    measured_perimeter: float
    likelihood: float

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
            "mean_log_likelihood": float(f"{self.likelihood:.6g}"),
        }


def compare_regions(
    scene: Scene,
    found: Estimate,
    observations: tuple[Observation, ...],
    *,
    points: int | Literal["auto"],
    caster: RayCaster,
    threads: int | None = None,
) -> PointsRow:
    """Render all images with a fit and compare the saturated regions with the measured ones.

    Both are taken from whole levels, since the camera delivers no others.
    """
    top = scene.sensor.saturated_from
    areas, perimeters = np.zeros(2), np.zeros(2)
    for seen, levels, _ in predict_images(scene, found.x, observations, caster=caster, threads=threads):
        delivered = np.clip(np.floor(levels + 0.5), 0.0, scene.sensor.max_level)
        pair: tuple[NDArray[np.float32], NDArray[np.float32]] = delivered, seen.levels
        for i, image in enumerate(pair):
            region = saturated_region(image, top)
            areas[i] += region.area
            perimeters[i] += region.perimeter
    return PointsRow(
        points=points,
        R_d=found.R_d,
        R_s=found.R_s,
        sigma=found.sigma,
        area=int(areas[0]),
        measured_area=int(areas[1]),
        perimeter=float(perimeters[0]),
        measured_perimeter=float(perimeters[1]),
        likelihood=found.maximum.evaluation.value / len(found.likelihood.samples.level),
    )
