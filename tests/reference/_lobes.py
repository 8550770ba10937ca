"""Specular lobes by the formulas of their papers, in plain NumPy."""

import numpy as np


def specular(normal, view, light, reflectance):
    """Specular light per unit of R_s, of unit vectors of shape (…, 3) (paper, equation 3; Walter et al. 2007)."""
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
        value = value / np.maximum(n_dot_v, 0.01)
    if model.refractive_index is not None:
        index = model.refractive_index
        value = value * fresnel(np.sum(half * light, axis=-1), index) / fresnel(np.float64(1.0), index)
    return np.where((n_dot_l > 0.0) & (n_dot_v > 0.0), value, 0.0)


def fresnel(cosine, index):
    """Reflectance of a metal for unpolarised light: Fresnel's equations as they stand, with complex numbers."""
    n = complex(*index)
    inner = np.sqrt(1.0 - (1.0 - cosine**2) / n**2)
    perpendicular = (cosine - n * inner) / (cosine + n * inner)
    parallel = (n * cosine - inner) / (n * cosine + inner)
    return 0.5 * (np.abs(perpendicular) ** 2 + np.abs(parallel) ** 2)
