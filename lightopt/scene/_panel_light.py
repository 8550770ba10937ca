from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent


@dataclass(frozen=True, kw_only=True)
class PanelLight:
    """A rectangular panel facing the origin, in whichever frame its vectors are given (world or part).

    Attributes
    ----------
    elevation, azimuth: Where it stands, world frame [rad]
    distance: Panel centre to origin [mm]
    centre: [mm], shape (3,)
    across, along: Unit vectors of its sides, e_φ and e_θ, shape (3,)
    outward: Unit vector from the origin to the panel, d, shape (3,); the panel shines along −d
    size: Sides along `across` and `along` [mm]
    points: Number of point lights k², or ``"auto"`` for the converged panel
    total_weight: Sum of the points' weights: gain, times m where the normalisation is ``sum``
    inverse_square: Whether light falls off with (distance of the panel centre / r)²
    emission_exponent: n of the emission cosⁿ(angle to the panel's axis); 0 is the paper's point light
    """

    name: str
    elevation: float
    azimuth: float
    distance: float
    centre: Float64
    across: Float64
    along: Float64
    outward: Float64
    size: tuple[float, float]
    points: int | Literal["auto"]
    normalisation: Literal["mean", "sum"] = "mean"
    gain: float = 1.0
    inverse_square: bool = False
    emission_exponent: float = 0.0

    @property
    def total_weight(self) -> float:
        """Sum of the weights of the panel's points (1/m each for ``mean``, 1 each for ``sum``), times the gain."""
        if self.normalisation == "sum" and self.points != "auto":
            return self.gain * self.points
        return self.gain

    def moved(self, rotation: Float64, translation: Float64) -> PanelLight:
        """The panel after x' = rotation·x + translation, of shapes (3, 3) and (3,)."""
        return replace(
            self,
            centre=rotation @ self.centre + translation,
            across=rotation @ self.across,
            along=rotation @ self.along,
            outward=rotation @ self.outward,
        )


def place_light(
    *,
    name: str,
    distance: float,
    elevation: float,
    azimuth: float,
    size: tuple[float, float],
    points: int | Literal["auto"],
    normalisation: Literal["mean", "sum"] = "mean",
    gain: float = 1.0,
    inverse_square: bool = False,
    emission_exponent: float = 0.0,
) -> PanelLight:
    """Panel centred at ``distance·d(elevation, azimuth)``, facing the origin; [mm], [rad], world frame."""
    d = direction(elevation=elevation, azimuth=azimuth)
    return PanelLight(
        name=name,
        elevation=elevation,
        azimuth=azimuth,
        distance=distance,
        centre=distance * d,
        across=azimuth_tangent(azimuth=azimuth),
        along=elevation_tangent(elevation=elevation, azimuth=azimuth),
        outward=d,
        size=size,
        points=points,
        normalisation=normalisation,
        gain=gain,
        inverse_square=inverse_square,
        emission_exponent=emission_exponent,
    )


def panel_grid(light: PanelLight, points: int) -> Float64:
    """The m point lights of a panel at the centres of a k×k grid of cells (paper, figure 7), shape (m, 3) [mm].

    points: m = k²
    """
    k = math.isqrt(points)
    offsets = (np.arange(k) + 0.5) / k - 0.5
    across = (offsets * light.size[0])[None, :, None] * light.across
    along = (offsets * light.size[1])[:, None, None] * light.along
    return np.ascontiguousarray((light.centre + across + along).reshape(-1, 3))
