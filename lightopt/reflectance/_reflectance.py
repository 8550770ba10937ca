from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Reflectance"]


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Coefficients of the reflection model (paper, equations 2 and 3).

    Attributes
    ----------
    R_d
        Diffuse reflection coefficient [grey level].
    R_s
        Specular reflection coefficient [grey level].
    sigma
        Concentration of the specular lobe, the standard deviation of δ [rad].
    full_scale
        Level that the coefficients call full scale [grey level].
    """

    R_d: float
    R_s: float
    sigma: float
    full_scale: float = 255.0
