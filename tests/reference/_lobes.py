"""Diffuse components and specular lobes by the formulas of their papers, in plain NumPy."""

import numpy as np


def specular(normal, view, light, reflectance, across=None):
    """Specular light per unit of R_s, of unit vectors of shape (…, 3) (paper, equation 3; Walter et al. 2007).

    across: Unit tangents in which the lobe of a brushed surface is wider
    """
    if across is not None:
        return brushed(normal, view, light, reflectance, across)
    sigma, model = reflectance.sigma, reflectance.model
    n_dot_l, n_dot_v = np.sum(normal * light, axis=-1), np.sum(normal * view, axis=-1)
    half = light + view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    delta = np.arctan2(np.linalg.norm(np.cross(normal, half), axis=-1), np.sum(normal * half, axis=-1))
    if model.name == "ggx":
        alpha = 2.0 * sigma
        value = 1.0 / (np.cos(delta) ** 4 * (1.0 + (np.tan(delta) / alpha) ** 2) ** 2) / np.maximum(n_dot_v, 1e-12)
        for cosine in (n_dot_l, n_dot_v):
            value = value * 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * (1.0 / np.maximum(cosine, 1e-12) ** 2 - 1.0)))
    else:
        value = np.exp(-(delta**2) / (2.0 * sigma**2))
        if model.name == "two-lobe":
            value = value + model.wide_share * np.exp(-(delta**2) / (2.0 * (sigma * model.wide_ratio) ** 2))
        if model.name == "measured":
            widths = [(height, sigma * own / model.measured[0][1]) for height, own in model.measured]
            value = sum(height * np.exp(-(delta**2) / (2.0 * own**2)) for height, own in widths)
        value = value / np.maximum(n_dot_v, 0.01)
    if model.refractive_index is not None:
        index = model.refractive_index
        value = value * fresnel(np.sum(half * light, axis=-1), index) / fresnel(np.float64(1.0), index)
    return np.where((n_dot_l > 0.0) & (n_dot_v > 0.0), value, 0.0)


def brushed(normal, view, light, reflectance, across):
    """The lobe of a brushed surface: GGX by the three components of H (Heitz 2014), Gaussians by those of N − H."""
    model, ratio = reflectance.model, reflectance.model.across_ratio
    n_dot_l, n_dot_v = np.sum(normal * light, axis=-1), np.sum(normal * view, axis=-1)
    half = light + view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    aside = np.sum((half - normal) * across, axis=-1)
    if model.name == "ggx":
        alpha, up = 2.0 * reflectance.sigma, np.sum(normal * half, axis=-1)
        beside = 1.0 - up**2 - aside**2
        value = 1.0 / ((aside / (alpha * ratio)) ** 2 + beside / alpha**2 + up**2) ** 2 / np.maximum(n_dot_v, 1e-12)
        for way, cosine in ((light, n_dot_l), (view, n_dot_v)):
            part = np.sum(way * across, axis=-1) ** 2
            roughness = (alpha * ratio) ** 2 * part + alpha**2 * (1.0 - cosine**2 - part)
            value = value * 2.0 / (1.0 + np.sqrt(1.0 + roughness / np.maximum(cosine, 1e-12) ** 2))
    else:
        chord_squared = np.sum((half - normal) ** 2, axis=-1) - aside**2 + (aside / ratio) ** 2
        delta = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.sqrt(chord_squared)))
        value = np.exp(-(delta**2) / (2.0 * reflectance.sigma**2))
        if model.name == "two-lobe":
            wide = reflectance.sigma * model.wide_ratio
            value = value + model.wide_share * np.exp(-(delta**2) / (2.0 * wide**2))
        value = value / np.maximum(n_dot_v, 0.01)
    if model.refractive_index is not None:
        index = model.refractive_index
        value = value * fresnel(np.sum(half * light, axis=-1), index) / fresnel(np.float64(1.0), index)
    return np.where((n_dot_l > 0.0) & (n_dot_v > 0.0), value, 0.0)


def diffuse(normal, view, light, form):
    """Diffuse light per unit of R_d, of unit vectors of shape (…, 3).

    Oren and Nayar's with their angles: sinα tanβ cosφ, α the larger one of θ_i and θ_o and β the smaller one, where
    cosφ is above 0; and sinθ_i sinθ_o cosφ where it is not (Fujii).
    """
    cos_i, cos_o = np.sum(normal * light, axis=-1), np.sum(normal * view, axis=-1)
    if form.exponent != 1.0:
        return np.maximum(0.0, cos_i) ** form.exponent
    theta_i, theta_o = np.arccos(np.clip(cos_i, 0.0, 1.0)), np.arccos(np.clip(cos_o, 0.0, 1.0))
    flat_i, flat_o = light - cos_i[..., None] * normal, view - cos_o[..., None] * normal
    lengths = np.linalg.norm(flat_i, axis=-1) * np.linalg.norm(flat_o, axis=-1)
    cos_phi = np.sum(flat_i * flat_o, axis=-1) / np.maximum(lengths, 1e-300)
    beta = np.minimum(np.minimum(theta_i, theta_o), 0.5 * np.pi - 1e-9)
    ahead = np.sin(np.maximum(theta_i, theta_o)) * np.tan(beta) * cos_phi
    behind = np.sin(theta_i) * np.sin(theta_o) * cos_phi
    scale = 1.0 + (0.5 - 2.0 / (3.0 * np.pi)) * form.roughness
    return np.maximum(0.0, cos_i) * (1.0 + form.roughness * np.where(cos_phi > 0.0, ahead, behind)) / scale


def fresnel(cosine, index):
    """Reflectance of a metal for unpolarised light: Fresnel's equations as they stand, with complex numbers."""
    n = complex(*index)
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / n**2)
    perpendicular = (cosine - n * inner) / (cosine + n * inner)
    parallel = (n * cosine - inner) / (n * cosine + inner)
    return 0.5 * (np.abs(perpendicular) ** 2 + np.abs(parallel) ** 2)
