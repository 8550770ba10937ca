from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Coefficients of the reflection model (paper, equations 2 and 3).

    Attributes
    ----------
    R_d: Diffuse reflection coefficient [grey level]
    R_s: Specular reflection coefficient [grey level]
    sigma: Concentration of the specular lobe, the standard deviation of δ [rad]
    full_scale: Level that the coefficients call full scale [grey level]
    """

    R_d: float
    R_s: float
    sigma: float
    full_scale: float = 255.0

    def changed(self, *, R_d_factor: float = 1.0, sigma_factor: float = 1.0) -> Reflectance:
        """Coefficients of a place where R_d is multiplied, and the lobe widened without reflecting more or less light.

        What the lobe reflects goes as R_s·σ², its peak times the solid angle of the half vectors that it takes up, so
        R_s is divided by the square of the factor of σ; exact as σ goes to 0, within 2 % up to σ = 0.2.

        Parameters
        ----------
        R_d_factor, sigma_factor: By which R_d and σ are multiplied
        """
        return replace(
            self, R_d=self.R_d * R_d_factor, R_s=self.R_s / sigma_factor**2, sigma=self.sigma * sigma_factor
        )
