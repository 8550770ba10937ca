"""The reflection model: a diffuse component and a specular lobe, as functions of cosines.

The lobe is Torrance and Sparrow's of the paper (equation 3), a sum of two of them, or the one of GGX:

    B. Walter, S. R. Marschner, H. Li, K. E. Torrance: Microfacet models for refraction through rough surfaces,
    Eurographics Symposium on Rendering 2007, equations 20, 33 and 34, doi:10.2312/EGWR/EGSR07/195-206

Brushed surfaces have lobes that are wider across the brushing than along it; that of GGX is then

    E. Heitz: Understanding the masking-shadowing function in microfacet-based BRDFs, Journal of Computer Graphics
    Techniques 3 (2), 2014, equations 80, 85 and 86

The diffuse component is Lambert's (equation 2), a power of N·L, or Oren and Nayar's in the form of Fujii, which has an
albedo of at most 1 in all directions:

    Y. Fujii: A tiny improvement of Oren-Nayar reflectance model, mimosa-pudica.net/improved-oren-nayar.html
    J. Portsmouth, P. Kutz, S. Hill: EON: A practical energy-preserving rough diffuse BRDF, arXiv:2410.18026
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from lightopt.core.arrays import Float64
from lightopt.core.kernels import kernel
from lightopt.core.vectors import Vector, dot, minus, scaled
from lightopt.optics._exponential import exponential, rough_exponential

ModelName = Literal["torrance-sparrow", "ggx", "two-lobe", "measured"]

MIN_COS_VIEW = 0.01
"""cosθ_o is clamped to this from below in equation (3), whose 1/cosθ_o diverges at the silhouette (θ_o > 89.4°)."""

MAX_LOBE_EXPONENT = 60.0
"""Lobes are zero where δ²/(2σ²) exceeds this: e⁻⁶⁰ = 9e-27 of R_s is nothing beside a grey level."""

EVERYWHERE = 1e30  # exponent that no place exceeds: a lobe that is nowhere negligible
_QUARTER_TURN_SQUARED, _NOTHING_LEFT = 2.0, 5.2  # |N − H|² of δ = 90°, and 1/(2σ²) of σ = 0.31
NARROW_CHORD_SQUARED = 0.25  # Lobes where |N − H|² is less than this, δ < 0.505 rad, are computed without branches


FUJII_SCALE = 0.5 - 2.0 / (3.0 * math.pi)
"""c of 1/(1 + c·r), by which Fujii's form of roughness r is scaled: its albedo along the normal, 1 at the horizon."""


class DiffuseForm(NamedTuple):
    """Form of the diffuse component, apart from R_d; one of the two is Lambert's."""

    exponent: float = 1.0  # power of N·L; 1 is Lambert's law
    roughness: float = 0.0  # r of Oren and Nayar's component in Fujii's form, from 0, Lambert's law, to 1


LAMBERT = DiffuseForm()


class Lobe(NamedTuple):
    """A specular lobe in the form that kernels take; its greatest value is R_s, where N = H = V."""

    inverse: float  # 1/(2σ²) [rad⁻²]; for GGX, 2/α²
    farthest: float  # δ²/(2σ²) from which the lobe is zero
    plain: bool  # whether it is one Gaussian lobe without Fresnel's factor, which equation (3) has
    ggx: bool  # whether it is the lobe of GGX
    share: float  # height of the narrowest Gaussian lobe: 1 of a single one and of the narrow one of two
    wider: int  # number of further, wider Gaussian lobes
    shares: tuple[float, float, float, float, float]  # their heights, in the unit of `share`
    # 1/(2σ²) of these lobes [rad⁻²], of which each is wider than the one before
    inverses: tuple[float, float, float, float, float]
    n: float  # of the complex refractive index n + ik of a metal; 0 where reflection does not depend on the angle
    k: float  # its imaginary part; 0 likewise
    normal_reflectance: float  # Fresnel reflectance of the metal at normal incidence
    widening: float  # (σ_across/σ)² of a brushed surface, whose lobe is as much wider across the brushing; 1 of others
    # unit vector across the brushing, in the tangent plane, times √(1 − 1/widening); 0 where the lobe is alike all
    # round
    across: Vector


_ALL_ROUND = Vector(0.0, 0.0, 0.0)
MOST_WIDER = 5  # wider Gaussian lobes that a lobe may have


@dataclass(frozen=True, kw_only=True)
class SpecularModel:
    """What a specular lobe is like, apart from how wide and how high it is."""

    # torrance-sparrow, one Gaussian lobe in δ; ggx, with masking by Smith; two-lobe, two Gaussian ones; measured, a sum
    # of Gaussian ones that follows a table
    name: ModelName = "torrance-sparrow"
    wide_share: float = 0.0  # R_s of the wide lobe, as a share of R_s; two-lobe only
    wide_ratio: float = 1.0  # σ of the wide lobe over σ; two-lobe only
    # n and k of the metal, for Fresnel's factor; None for no such factor
    refractive_index: tuple[float, float] | None = None
    across_ratio: float = 1.0  # σ across the brushing over σ, of brushed surfaces; 1 of others
    # height and σ [rad] of each Gaussian lobe of a table, from the narrowest on; their sum is 1 at δ = 0
    measured: tuple[tuple[float, float], ...] = ()

    @property
    def width_key(self) -> str:
        """Key of a part file for the width of the lobe."""
        return {"ggx": "alpha", "measured": "width_factor"}.get(self.name, "sigma_rad")

    @property
    def across_key(self) -> str:
        """Key of a part file for the width of the lobe across the brushing."""
        return "alpha_across" if self.name == "ggx" else "sigma_across_rad"

    @property
    def width_factor(self) -> float:
        """What σ is multiplied by for that key: α = 2σ; of a table, σ is that of its narrowest lobe."""
        if self.name == "measured":
            return 1.0 / self.measured[0][1]
        return 2.0 if self.name == "ggx" else 1.0

    @property
    def wider_lobes(self) -> tuple[tuple[float, float], ...]:
        """Heights of the wider Gaussian lobes, and their σ over that of the narrowest."""
        if self.name == "measured":
            return tuple((height, sigma / self.measured[0][1]) for height, sigma in self.measured[1:])
        return ((self.wide_share, self.wide_ratio),) if self.name == "two-lobe" and self.wide_share > 0.0 else ()


@dataclass(frozen=True, kw_only=True)
class Reflectance:
    """Coefficients of the reflection model (paper, equations 2 and 3)."""

    R_d: float  # diffuse reflection coefficient [grey level]
    R_s: float  # specular reflection coefficient [grey level]
    # concentration of the specular lobe, the standard deviation of δ [rad]. Of two lobes, of the narrow one; of GGX,
    # α/2, with which both models have the same curvature where they are brightest
    sigma: float
    full_scale: float = 255.0  # level that the coefficients call full scale [grey level]
    model: SpecularModel = SpecularModel()  # the lobe's form
    diffuse: DiffuseForm = LAMBERT  # the form of the diffuse component
    # level of a white diffuse surface that faces a light of weight 1 [grey level]; None where not known
    white_level: float | None = None

    @property
    def lobe(self) -> Lobe:
        inverse, model = 0.5 / self.sigma**2, self.model
        wider = model.wider_lobes
        ratio, rest = max((one for _, one in wider), default=1.0), MOST_WIDER - len(wider)
        n, k = model.refractive_index or (0.0, 0.0)
        widening = model.across_ratio**2
        return Lobe(
            inverse=inverse,
            farthest=EVERYWHERE if model.name == "ggx" else MAX_LOBE_EXPONENT * max(1.0, ratio**2) * widening,
            plain=model.name != "ggx" and not wider and n == 0.0 and widening == 1.0,
            ggx=model.name == "ggx",
            share=model.measured[0][0] if model.name == "measured" else 1.0,
            wider=len(wider),
            shares=(*(share for share, _ in wider), *[0.0] * rest),  # type: ignore[arg-type]
            inverses=(*(inverse / one**2 for _, one in wider), *[inverse] * rest),  # type: ignore[arg-type]
            n=float(n),
            k=float(k),
            normal_reflectance=conductor_reflectance(1.0, n, k) if n > 0.0 else 1.0,
            widening=widening,
            across=_ALL_ROUND,
        )

    @property
    def width_text(self) -> str:
        """The lobe's width as part files give it, for messages."""
        if self.model.name == "ggx":
            return f"α = {self.model.width_factor * self.sigma:g} (σ = α/2)"
        if self.model.name == "measured":
            return f"width_factor = {self.model.width_factor * self.sigma:g} (σ = {self.sigma:.3g} rad)"
        return f"σ = {self.sigma:g} rad"

    def changed(self, *, R_d_factor: float = 1.0, sigma_factor: float = 1.0) -> "Reflectance":
        """Coefficients of a place where R_d is multiplied, and the lobe widened without reflecting more or less light.

        What the lobe reflects goes as R_s·σ², its peak times the solid angle of the half vectors that it takes up, so
        R_s is divided by the square of the factor of σ; exact as σ goes to 0, within 2 % up to σ = 0.2.

        R_d_factor, sigma_factor: By which R_d and σ are multiplied
        """
        return replace(self, R_d=self.R_d * R_d_factor, R_s=self.R_s / sigma_factor**2, sigma=self.sigma * sigma_factor)


@kernel
def lambert(n_dot_l: float) -> float:
    """Diffuse component per unit of R_d (paper, equation 2)."""
    return max(0.0, n_dot_l)


@kernel
def is_lambert(form: DiffuseForm) -> bool:
    return (form.exponent == 1.0) & (form.roughness == 0.0)


@kernel
def diffuse_term(n_dot_l: float, n_dot_v: float, l_dot_v: float, form: DiffuseForm) -> float:
    """Diffuse component per unit of R_d in any form; :func:`lambert` is the faster one of Lambert's.

    Oren and Nayar's: N·L · (1 + r·s/t) / (1 + c·r), s = L·V − (N·L)·(N·V), t = max(N·L, N·V) where s is above 0 and 1
    where it is not (Fujii). An interpolated normal that is turned away from the camera has N·V = 0.
    """
    if n_dot_l <= 0.0:
        return 0.0
    if form.exponent != 1.0:
        return n_dot_l**form.exponent
    n_dot_v = max(0.0, n_dot_v)
    s = l_dot_v - n_dot_l * n_dot_v
    t = max(n_dot_l, n_dot_v) if s > 0.0 else 1.0
    return (n_dot_l + form.roughness * s * (n_dot_l / t)) / (1.0 + FUJII_SCALE * form.roughness)


@kernel
def narrow_gaussian(chord_squared: float, inverse_two_sigma_squared: float) -> float:
    """:func:`gaussian` below :data:`NARROW_CHORD_SQUARED`, without branches; there they are the same.

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
def series_reach(inverse_two_sigma_squared: float) -> float:
    """|N − H|² up to which :func:`narrow_gaussian` is exact to 2e-8 of the lobe's peak.

    At δ of 90° its exponent is off by 5e-4 of itself. Up to σ = 0.31 nothing is left of the lobe there.
    """
    return _QUARTER_TURN_SQUARED if inverse_two_sigma_squared >= _NOTHING_LEFT else NARROW_CHORD_SQUARED


@kernel
def rough_gaussian(chord_squared: float, inverse_two_sigma_squared: float) -> float:
    """:func:`gaussian` without branches, to 1e-3 of its greatest value up to σ = 0.3, and to 1e-5 up to σ = 0.1."""
    c = chord_squared
    exponent = c * (1.0 + c * (1.0 / 12.0 + c * (1.0 / 90.0))) * inverse_two_sigma_squared
    return rough_exponential(-min(exponent, 10.0 * MAX_LOBE_EXPONENT))


@kernel
def gaussian(chord_squared: float, inverse_two_sigma_squared: float) -> float:
    """Torrance and Sparrow's lobe, e^(−δ²/(2σ²)) (paper, equation 3).

    chord_squared: |N − H|² of the unit normal and the unit vector halfway between light and view
    inverse_two_sigma_squared: 1/(2σ²) [rad⁻²]
    """
    # δ is never less than the chord, so that most pixels of a glossy part need no exponential
    if chord_squared * inverse_two_sigma_squared > MAX_LOBE_EXPONENT:
        return 0.0
    if chord_squared < NARROW_CHORD_SQUARED:
        return narrow_gaussian(chord_squared, inverse_two_sigma_squared)
    delta = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(chord_squared)))
    return exponential(-(delta * delta * inverse_two_sigma_squared))


@kernel
def lobe_at(lobe: Lobe, frames: Float64, i: int) -> Lobe:
    """The lobe of a surface point, turned as its brushing runs.

    frames: Unit normals and, of brushed surfaces, unit vectors across the brushing or 0, shape (k, 3) or (k, 6)
    i: Number of the point
    """
    if lobe.widening == 1.0 or frames.shape[1] < 6:
        return lobe
    return lobe_across(lobe, Vector(frames[i, 3], frames[i, 4], frames[i, 5]))


@kernel
def lobe_beside(lobe: Lobe, normal: Vector) -> Lobe:
    """The lobe where the surface leans to another unit normal: the brushing leans with it."""
    if lobe.widening == 1.0:
        return lobe
    part = dot(lobe.across, normal)
    aside = minus(lobe.across, scaled(normal, part))
    size = math.sqrt(dot(aside, aside))
    return lobe_across(lobe, scaled(aside, 1.0 / size if size > 0.0 else 0.0))


@kernel
def lobe_across(lobe: Lobe, across: Vector) -> Lobe:
    """The lobe of a brushed surface, by the unit vector across its brushing, or 0 where it has no direction."""
    return Lobe(*lobe[:-1], scaled(across, math.sqrt(1.0 - 1.0 / lobe.widening)))


@kernel
def square_across(vector: Vector, lobe: Lobe) -> float:
    """Square of a vector's component across the brushing, times 1 − 1/widening; 0 where the lobe is alike all round."""
    if lobe.widening == 1.0:
        return 0.0
    part = dot(vector, lobe.across)
    return part * part


@kernel
def specular_lobe(chord_squared: float, across_squared: float, lobe: Lobe) -> float:
    """The lobe as a function of N − H, 1 where it is 0; for N·L > 0 and N·V > 0.

    Gaussian lobes of brushed surfaces are those of |N − H|² whose part across the brushing is divided by the widening.
    GGX: cos⁴δ·(1 + tan²δ/α²)² in the denominator (Walter et al., equation 33), with the square of its sine by the
    chord; of brushed surfaces (h_z² + h_y²/α² + h_x²/(α²·widening))² (Heitz, equation 85).

    chord_squared: |N − H|² of the unit normal and the unit vector halfway between light and view
    across_squared: :func:`square_across` of N − H
    """
    if lobe.ggx:
        sine_squared = chord_squared * (1.0 - 0.25 * chord_squared)
        root = 1.0 + sine_squared * (0.5 * lobe.inverse - 1.0)
        if lobe.widening > 1.0:
            root -= across_squared * (0.5 * lobe.inverse)
        return 1.0 / (root * root)
    if lobe.widening > 1.0:
        chord_squared = max(0.0, chord_squared - across_squared)
    value = lobe.share * gaussian(chord_squared, lobe.inverse)
    for k in range(lobe.wider):
        value += lobe.shares[k] * gaussian(chord_squared, lobe.inverses[k])
    return value


@kernel
def _masked(cosine: float, across_squared: float, lobe: Lobe) -> float:
    # c + √(α² + (1 − α²)·c²), by which Smith's masking is 2c divided (Walter et al., equation 34); of brushed surfaces
    # with the α of the vector's direction, α²·(1 + (widening − 1)·cos²φ) (Heitz, equation 80)
    alpha_squared = 2.0 / lobe.inverse
    squared = alpha_squared + (1.0 - alpha_squared) * cosine * cosine
    if lobe.widening > 1.0:
        squared += alpha_squared * lobe.widening * across_squared
    return cosine + math.sqrt(squared)


@kernel
def specular_divisor(n_dot_v: float, across_squared: float, lobe: Lobe) -> float:
    """What the specular component is divided by for its view.

    cosθ_o (paper, equation 3), clamped from below by :data:`MIN_COS_VIEW`; for GGX over its masking, which is finite.

    across_squared: :func:`square_across` of V
    """
    return 0.5 * _masked(n_dot_v, across_squared, lobe) if lobe.ggx else max(n_dot_v, MIN_COS_VIEW)


@kernel
def light_factor(n_dot_l: float, across_squared: float, half_size: float, lobe: Lobe) -> float:
    """Factor of the specular component for where its light comes from: masking of GGX, and Fresnel's of metals.

    n_dot_l: Above 0
    across_squared: :func:`square_across` of L
    half_size: Length of L + V, twice the cosine of the angle between L and H
    """
    if lobe.plain:
        return 1.0
    factor = 2.0 * n_dot_l / _masked(n_dot_l, across_squared, lobe) if lobe.ggx else 1.0
    if lobe.n > 0.0:
        factor *= fresnel_factor(half_size, lobe.n, lobe.k, lobe.normal_reflectance)
    return factor


@kernel
def fresnel_factor(half_size: float, n: float, k: float, normal_reflectance: float) -> float:
    """Fresnel reflectance of a metal over that at normal incidence; half_size as :func:`light_factor` takes it."""
    return conductor_reflectance(min(1.0, 0.5 * half_size), n, k) / normal_reflectance


@kernel
def round_ggx(chord_squared: float, n_dot_l: float, inverse: float) -> float:
    """:func:`specular_lobe` times :func:`light_factor` of GGX that is alike all round, without Fresnel's factor.

    It takes few numbers, so that the processor computes several at once.
    """
    alpha_squared = 2.0 / inverse
    root = 1.0 + chord_squared * (1.0 - 0.25 * chord_squared) * (0.5 * inverse - 1.0)
    masked = n_dot_l + math.sqrt(alpha_squared + (1.0 - alpha_squared) * n_dot_l * n_dot_l)
    return 2.0 * n_dot_l / (masked * root * root)


@kernel
def conductor_reflectance(cosine: float, n: float, k: float) -> float:
    """Fresnel reflectance of a metal for unpolarised light (M. Born, E. Wolf: Principles of optics, section 14.2).

    cosine: Of the angle of incidence
    n, k: Complex refractive index n + ik against air
    """
    c2 = cosine * cosine
    s2 = 1.0 - c2
    first = n * n - k * k - s2
    size = math.sqrt(first * first + 4.0 * n * n * k * k)
    a = math.sqrt(max(0.0, 0.5 * (size + first)))
    perpendicular = (size + c2 - 2.0 * a * cosine) / (size + c2 + 2.0 * a * cosine)
    mixed, product = c2 * size + s2 * s2, 2.0 * a * cosine * s2
    return 0.5 * perpendicular * (1.0 + (mixed - product) / (mixed + product))


@kernel
def farthest_exponent(most: float, lobe: Lobe) -> float:
    """δ²/(2σ²) from which a lobe is less than e^−most of its height, or more.

    The square of δ's sine, on which GGX depends, is more than 4/π² of that of δ. A metal reflects as many times more at
    grazing angles as it reflects less than all along its normal. Across the brushing the lobe reaches farthest.
    """
    if not lobe.plain:
        most -= math.log(lobe.normal_reflectance)
    return lobe.widening * _farthest_along(most, lobe)


@kernel
def _farthest_along(most: float, lobe: Lobe) -> float:
    if lobe.ggx:
        narrowing = 1.0 - 2.0 / lobe.inverse  # 1 − α²
        if narrowing <= 0.01:
            return EVERYWHERE
        return (0.5 * math.pi) ** 2 * 2.0 * (math.exp(0.5 * min(most, MAX_LOBE_EXPONENT)) - 1.0) / narrowing
    if lobe.wider > 0:
        # each of them less than a half, a quarter, … of it
        most += 0.7 * lobe.wider
        farthest = most
        for k in range(lobe.wider):
            farthest = max(farthest, (most + math.log(lobe.shares[k])) * lobe.inverse / lobe.inverses[k])
        return farthest
    return most


@kernel
def gaussian_lobe(lobe: Lobe, number: int) -> tuple[float, Lobe]:
    """Height of one of several Gaussian lobes, and this one alone with height 1; 0 is the narrowest."""
    share, inverse = lobe.share, lobe.inverse
    if number > 0:
        share, inverse = lobe.shares[number - 1], lobe.inverses[number - 1]
    plain = (lobe.n == 0.0) & (lobe.widening == 1.0)
    return share, Lobe(inverse, MAX_LOBE_EXPONENT * lobe.widening, plain, False, 1.0, 0, *lobe[6:])


@kernel
def lobe_of_width(lobe: Lobe, inverse: float) -> Lobe:
    """A lobe of the same form of another width; of several, all are as much wider.

    inverse: 1/(2σ²) [rad⁻²]
    """
    factor = inverse / lobe.inverse
    a, b, c, d, e = lobe.inverses
    wider = (a * factor, b * factor, c * factor, d * factor, e * factor)
    return Lobe(inverse, *lobe[1:7], wider, *lobe[8:])
