"""Equations (1)–(4) of the paper, one point light after the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ._casting import blocked, trace

SMALLEST_COS_VIEW = 0.01  # the clamp of cos θ_o in equation (3)
OFFSET = 1e-5  # of the part's radius, along the geometric normal, where shadow rays end


def dot(a, b):
    return np.einsum("...i,...i->...", a, b)  # several times as fast as a sum over an axis of three


def unit(a):
    return a / np.sqrt(dot(a, a))[..., None]


def angle(a, b):
    """Angle between unit vectors; accurate near zero, unlike the arc cosine of their product."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    sine = np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
    return np.arctan2(sine, dot(a, b))


def emission(light, source, r):
    """Falloff times emission towards points at the vectors r (from point to source), both 1 in the paper."""
    factor = np.ones(r.shape[:-1])
    if light.falloff == "inverse_square":
        factor = factor * light.distance**2 / dot(r, r)
    if light.emission:
        cosine = np.maximum(0, dot(unit(r), light.axis))
        factor = factor * cosine**light.emission
    return factor


def lambert(normal, view, to_light):
    return np.maximum(0, dot(normal, to_light))  # (2)


def point_terms(hits, light, source, *, R_d, R_s, sigma=None, form=lambert, lobe=None):
    """I_d and I_s of one unit point light at `source` (..., 3), without shadows, gain and weights.

    `form` is diffuse light per unit of R_d of unit normals, views and directions to the light. `lobe` is specular light
    per unit of R_s likewise; without it, that of equation (3).
    `hits` are broadcast against `source`: pass `hits.point[:, None]`-like views for many sources at once.
    """
    point, normal, view = hits.point, hits.normal, hits.view
    if source.ndim > 1:
        point, normal, view = point[:, None], normal[:, None], view[:, None]
    r = source - point
    to_light = unit(r)
    cos_i, cos_o = dot(normal, to_light), dot(normal, view)
    strength = emission(light, source, r)
    if lobe is not None:
        return strength * R_d * form(normal, view, to_light), strength * R_s * lobe(normal, view, to_light)
    delta = angle(normal, unit(to_light + view))
    specular = R_s / np.maximum(cos_o, SMALLEST_COS_VIEW) * np.exp(-(delta**2) / (2 * sigma**2))  # (3)
    specular = np.where((cos_i > 0) & (cos_o > 0), specular, 0)
    return strength * R_d * form(normal, view, to_light), strength * specular


def shadow_point(hits, triangles):
    corners = triangles.reshape(-1, 3)
    radius = np.linalg.norm(np.ptp(corners, axis=0)) / 2
    return hits.point + OFFSET * radius * hits.geometric


def in_shadow(hits, source, triangles):
    """Whether the faces' own planes or any triangle keep one point light from the hit points."""
    below = dot(source - hits.point, hits.geometric) <= 0
    return below | blocked(source, shadow_point(hits, triangles), triangles)


@dataclass(frozen=True)
class LayerImage:
    """Images (H, W) of levels, and what tells pixels on edges: shadow flags (H, W, m) and hits."""

    diffuse: np.ndarray
    specular: np.ndarray
    shadow: np.ndarray
    hits: object

    @property
    def level(self):
        return self.diffuse + self.specular


def render(camera, light, triangles, normals, *, R_d, R_s, sigma, shadows=True, hits=None):
    """The level of every pixel under one light."""
    hits = trace(camera, triangles, normals) if hits is None else hits
    lit = np.flatnonzero(hits.front)
    seen = hits[lit]
    sources, weights = light.points()
    n = len(hits.face)
    diffuse, specular, flags = np.zeros(n), np.zeros(n), np.zeros((n, len(sources)), dtype=bool)
    for k, (source, weight) in enumerate(zip(sources, weights, strict=True)):
        I_d, I_s = point_terms(seen, light, source, R_d=R_d, R_s=R_s, sigma=sigma)
        if shadows:
            flags[lit, k] = in_shadow(seen, source, triangles)
        open_ = ~flags[lit, k]
        diffuse[lit] += light.gain * weight * np.where(open_, I_d, 0)  # (1), (4)
        specular[lit] += light.gain * weight * np.where(open_, I_s, 0)
    shape = (camera.height, camera.width)
    return LayerImage(diffuse.reshape(shape), specular.reshape(shape), flags.reshape(*shape, -1), hits)
