"""The reflection model: Lambert's diffuse and Torrance–Sparrow's specular component, as functions of cosines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from lightopt.core.kernels import kernel
from lightopt.optics._exponential import exponential


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Coefficients of the reflection model (paper, equations 2 and 3).

    R_d: Diffuse reflection coefficient [grey level]
    R_s: Specular reflection coefficient [grey level]
    sigma: Concentration of the specular lobe, the standard deviation of δ [rad]
    full_scale: Level that the coefficients call full scale [grey level]
    white_level: Level of a white diffuse surface that faces a light of weight 1 [grey level]; None where not known
    """

    R_d: float
    R_s: float
    sigma: float
    full_scale: float = 255.0
    white_level: float | None = None

    def changed(self, *, R_d_factor: float = 1.0, sigma_factor: float = 1.0) -> Reflectance:
        """Coefficients of a place where R_d is multiplied, and the lobe widened without reflecting more or less light.

        What the lobe reflects goes as R_s·σ², its peak times the solid angle of the half vectors that it takes up, so
        R_s is divided by the square of the factor of σ; exact as σ goes to 0, within 2 % up to σ = 0.2.

        R_d_factor, sigma_factor: By which R_d and σ are multiplied
        """
        return replace(self, R_d=self.R_d * R_d_factor, R_s=self.R_s / sigma_factor**2, sigma=self.sigma * sigma_factor)


MIN_COS_VIEW = 0.01
"""cosθ_o is clamped to this from below in equation (3), whose 1/cosθ_o diverges at the silhouette (θ_o > 89.4°)."""

MAX_LOBE_EXPONENT = 60.0
"""Lobes are zero where δ²/(2σ²) exceeds this: e⁻⁶⁰ = 9e-27 of R_s is nothing beside a grey level."""


@kernel
def lambert(n_dot_l: float) -> float:
    """Diffuse component per unit of R_d (paper, equation 2)."""
    return max(0.0, n_dot_l)


NARROW_CHORD_SQUARED = 0.25
"""Lobes where |N − H|² is less than this, δ < 0.505 rad, are computed without branches."""


@kernel
def narrow_specular_lobe(chord_squared: float, inverse_two_sigma_squared: float) -> float:
    """:func:`specular_lobe` below :data:`NARROW_CHORD_SQUARED`, without branches; there they are the same.

    The arc cosine of N·H loses half its digits near zero; δ = 2·arcsin(c/2) of the chord c = |N − H| does not. Its
    square is summed as Σ 2·c²ⁿ / (n²·binomial(2n, n)), to 1e-10 of itself.
    """
    c = chord_squared
    series = 1.0 / 84084.0 + c * (1.0 / 411840.0)
    series = 1.0 / 16632.0 + c * series
    series = 1.0 / 3150.0 + c * series
    series = 1.0 / 560.0 + c * series
    series = 1.0 / 90.0 + c * series
    series = 1.0 / 12.0 + c * series
    exponent = min(c * (1.0 + c * series) * inverse_two_sigma_squared, 2.0 * MAX_LOBE_EXPONENT)
    return exponential(-exponent) if c * inverse_two_sigma_squared <= MAX_LOBE_EXPONENT else 0.0


@kernel
def specular_lobe(chord_squared: float, inverse_two_sigma_squared: float) -> float:
    """Specular component per unit of R_s times cosθ_o: e^(−δ²/(2σ²)) (paper, equation 3), for N·L > 0 and N·V > 0.

    chord_squared: |N − H|² of the unit normal and the unit vector halfway between light and view
    inverse_two_sigma_squared: 1/(2σ²) [rad⁻²]
    """
    # δ is never less than the chord, so that most pixels of a glossy part need no exponential
    if chord_squared * inverse_two_sigma_squared > MAX_LOBE_EXPONENT:
        return 0.0
    if chord_squared < NARROW_CHORD_SQUARED:
        return narrow_specular_lobe(chord_squared, inverse_two_sigma_squared)
    delta = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(chord_squared)))
    return exponential(-(delta * delta * inverse_two_sigma_squared))


@kernel
def specular_cosine(n_dot_v: float) -> float:
    """Divisor cosθ_o of the specular component (paper, equation 3), clamped from below by :data:`MIN_COS_VIEW`."""
    return max(n_dot_v, MIN_COS_VIEW)
