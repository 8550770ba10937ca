"""From levels to the share of light that a surface reflects, which light between surfaces needs.

The level of a pixel is κ times the radiance that reaches the camera, per unit of a light's normal irradiance (a panel's
weight, a large light's ∫ L·cosα/r² dA). A white surface, whose diffuse albedo is 1, shows the level W = κ/π where it
faces that light. Hence the surface's BRDF is

    f = (R_d + R_s / (cosθ_i cosθ_o) · exp(−δ²/(2σ²))) / (π·W)

and its albedo, where it is seen along its normal, (R_d + (1/π) ∫ R_s exp(−δ²/(2σ²)) · 4 cosδ dω_H) / W. Other lobes
take the place of the Gaussian one, with their factors for the directions of light and view. Of other forms of diffuse
light the mean albedo counts, that of light which arrives evenly from all sides.
"""

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.optics._reflection_model import FUJII_SCALE, DiffuseForm, Lobe, Reflectance, light_factor

DEFAULT_ALBEDO = 0.65  # share of light that a surface of unknown white level reflects: that of chrome plating
_NODES = 64
_REACH = 12.0  # standard deviations of the lobe that are integrated
_TURNS = 64  # directions of a quarter turn about the normal in which the lobe of a brushed surface is summed
_MOST_DELTA = math.pi / 4  # the surface, seen along its normal, mirrors its own horizon there


def specular_sum(reflectance: Reflectance) -> float:
    """∫ exp(−δ²/(2σ²)) · 4 cosδ dω_H / π of a lobe seen along the normal: albedo times W per unit of R_s."""
    lobe = reflectance.lobe
    if lobe.widening == 1.0:
        return _sum_along(lobe, 0.0)
    # in each direction from the normal, by its angle to that across the brushing
    turn = 0.5 * math.pi / _TURNS * (np.arange(_TURNS) + 0.5)
    across = ((1.0 - 1.0 / lobe.widening) * np.cos(turn) ** 2).tolist()
    return float(np.mean([_sum_along(lobe, share) for share in across]))


def _sum_along(lobe: Lobe, across: float) -> float:
    # of a direction from the normal; across: as `square_across` has it, of a unit tangent in this direction
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    if lobe.ggx:
        # δ whose shares of 4 cosδ dω_H below the lobe are even
        alpha, end = math.sqrt(2.0 / (lobe.inverse * (1.0 - across))), math.tan(_MOST_DELTA)
        share = 0.5 * end**2 / (alpha**2 + end**2) * (nodes + 1.0)
        delta, step = np.arctan(alpha * np.sqrt(share / (1.0 - share))), 2.0 * alpha**2 * end**2 / (alpha**2 + end**2)
        return float(step * np.sum(weights * _factors(delta, lobe, across)))
    total = 0.0
    for height, inverse in ((lobe.share, lobe.inverse), *zip(lobe.shares[: lobe.wider], lobe.inverses, strict=False)):
        end = min(_MOST_DELTA, _REACH * math.sqrt(0.5 / (inverse * (1.0 - across))))
        delta = 0.5 * end * (nodes + 1.0)
        # the part of N − H across the brushing is sinδ
        chord = np.sqrt(4.0 * np.sin(0.5 * delta) ** 2 - across * np.sin(delta) ** 2)
        values = np.exp(-inverse * (2.0 * np.arcsin(0.5 * chord)) ** 2)
        values *= np.cos(delta) * np.sin(delta) * _factors(delta, lobe, across)
        total += height * float(8.0 * 0.5 * end * np.sum(weights * values))
    return total


def _factors(delta: Float64, lobe: Lobe, across: float) -> Float64:
    # of light that a surface, seen along its normal, mirrors at a normal leaning by δ
    rows = [(max(0.0, math.cos(2.0 * d)), across * math.sin(2.0 * d) ** 2, 2.0 * math.cos(d)) for d in delta]
    return np.array([light_factor(*row, lobe) for row in rows])


def diffuse_albedo(form: DiffuseForm) -> float:
    """Mean albedo of diffuse light times W per unit of R_d: 1 of Lambert's.

    (1/π)·∫ cos^q dω = 2/(q + 1); of Fujii's form as Portsmouth et al. have it.
    """
    if form.exponent != 1.0:
        return 2.0 / (form.exponent + 1.0)
    mean = 2.0 / 3.0 - 28.0 / (15.0 * math.pi)
    return (1.0 + mean * form.roughness) / (1.0 + FUJII_SCALE * form.roughness)


def least_white_level(reflectance: Reflectance) -> float:
    """Level W at which the surface reflects all light: with a lower one, it would reflect more than it gets."""
    return reflectance.R_d * diffuse_albedo(reflectance.diffuse) + reflectance.R_s * specular_sum(reflectance)


def white_level(reflectance: Reflectance) -> float:
    """Level W of the surface's own file, or that of the default albedo [grey level]."""
    if reflectance.white_level is not None:
        return reflectance.white_level
    return least_white_level(reflectance) / DEFAULT_ALBEDO
