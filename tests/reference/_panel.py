"""The converged panel: the reflected light integrated over the panel instead of summed over m points."""

from __future__ import annotations

from functools import cache

import numpy as np

from ._casting import blocked
from ._shading import dot, lambert, point_terms, shadow_point

CHUNK = 2**15  # pairs of pixel and node shaded together, as many as stay in a processor's cache


gauss_legendre = cache(np.polynomial.legendre.leggauss)


def product_rule(n, cells=1):
    """Gauss–Legendre nodes u, v in -1/2 … 1/2 and weights (sum 1), n × n in each of cells²."""
    x, w = gauss_legendre(n)
    x = ((x[None] / 2 + 0.5 + np.arange(cells)[:, None]) / cells - 0.5).ravel()
    w = np.tile(w / 2 / cells, cells)
    u, v = np.meshgrid(x, x)
    return u.ravel(), v.ravel(), np.outer(w, w).ravel()


def equally_spaced(n):
    """Cell centres of an n × n grid: the rule of m = n² point lights."""
    x = (np.arange(n) + 0.5) / n - 0.5
    u, v = np.meshgrid(x, x)
    return u.ravel(), v.ravel(), np.full(n * n, 1 / n**2)


def panel_radiance(hits, light, *, R_d, R_s, sigma=None, form=lambert, lobe=None, triangles=None, rule=None):
    """I_d and I_s (N,) of a panel with its output spread evenly, at front-facing hits.

    `triangles` cast shadows, tested by a ray to every node; without them only the horizons do. Where a shadow's
    edge crosses the panel a product rule is itself off by about a node's weight; `subtract_convex` is exact there.
    """
    u, v, weights = product_rule(64) if rule is None else rule
    sources = light.at(u, v)
    sum_d, sum_s = np.zeros(len(hits.face)), np.zeros(len(hits.face))
    step = max(1, CHUNK // len(weights))
    for start in range(0, len(hits.face), step):
        part = slice(start, start + step)
        seen = hits[part]
        visible = dot(sources - seen.point[:, None], seen.geometric[:, None]) > 0
        if triangles is not None:
            ends = shadow_point(seen, triangles)
            for i in range(len(ends)):  # from the surface point, which all its rays share, to the nodes
                near = may_hide(light, ends[i], triangles)
                visible[i] &= ~blocked(ends[i], sources, triangles[near])
        I_d, I_s = point_terms(seen, light, sources, R_d=R_d, R_s=R_s, sigma=sigma, form=form, lobe=lobe)
        sum_d[part] = light.gain * (np.where(visible, I_d, 0) @ weights)
        sum_s[part] = light.gain * (np.where(visible, I_s, 0) @ weights)
    return sum_d, sum_s


def may_hide(light, point, triangles):
    """Triangles that are not surely outside the pyramid between a point and the panel."""
    far = light.distance - dot(point, light.axis)
    depth = light.distance - dot(triangles, light.axis)
    ahead = (depth < far).all(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        projected = panel_coordinates(light, point + (triangles - point) * (far / (far - depth))[..., None])
        beside = (projected.min(axis=1) > 0.5) | (projected.max(axis=1) < -0.5)
    return (depth < far).any(axis=1) & ~(ahead & beside.any(axis=1))


def panel_coordinates(light, points):
    """u and v (..., 2) of points in the panel's plane."""
    across, along = light.at(1.0, 0.0) - light.at(0.0, 0.0), light.at(0.0, 1.0) - light.at(0.0, 0.0)
    relative = points - light.at(0.0, 0.0)
    return np.stack([dot(relative, across) / dot(across, across), dot(relative, along) / dot(along, along)], -1)


def convex_hull(points):
    """Corners of the hull of points (N, 2), counter-clockwise (Andrew's monotone chain)."""
    order = points[np.lexsort((points[:, 1], points[:, 0]))]

    def chain(sequence):
        hull = []
        for p in sequence:
            while len(hull) > 1 and cross2(hull[-1] - hull[-2], p - hull[-2]) <= 0:
                hull.pop()
            hull.append(p)
        return hull[:-1]

    return np.array(chain(order) + chain(order[::-1]))


def cross2(a, b):
    return a[0] * b[1] - a[1] * b[0]


def clip_to_square(polygon):
    """The part of a convex polygon (N, 2) inside -1/2 … 1/2 (Sutherland–Hodgman); may be empty."""
    for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
        kept = []
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            inside_a, inside_b = 0.5 - sign * a[axis], 0.5 - sign * b[axis]
            if inside_a >= 0:
                kept.append(a)
            if inside_a * inside_b < 0:
                kept.append(a + (b - a) * inside_a / (inside_a - inside_b))
        polygon = np.array(kept).reshape(-1, 2)
        if len(polygon) < 3:
            return np.zeros((0, 2))
    return polygon


def hidden_polygon(light, point, corners):
    """The part of the panel (u, v) that a convex body with these corners hides from a surface point outside it."""
    d = light.axis
    far = light.distance - dot(point, d)  # depths count from the panel's plane towards the part
    depth = light.distance - dot(corners, d)
    assert (depth > 0).all(), "the body reaches behind the panel"
    # what lies deeper than the point hides nothing: cut the body there, a hair above, so that it can be projected
    cut = far * (1 - 1e-5)
    i, j = (index.ravel() for index in np.meshgrid(*[np.arange(len(corners))] * 2))
    crossing = (depth[i] < cut) & (depth[j] > cut)
    i, j = i[crossing], j[crossing]
    share = (cut - depth[i]) / (depth[j] - depth[i])
    body = np.concatenate([corners[depth <= cut], corners[i] + share[:, None] * (corners[j] - corners[i])])
    if len(body) < 3:
        return np.zeros((0, 2))
    depth = light.distance - dot(body, d)
    projected = point + (body - point) * (far / (far - depth))[:, None]
    return clip_to_square(convex_hull(panel_coordinates(light, projected)))


def polygon_area(polygon):
    """Of a polygon (N, 2); 0 of an empty one."""
    x, y = polygon.T
    return abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2


def hidden_share(light, point, corners):
    """Share of the panel that a convex body hides from a surface point; 0 and 1 are exact."""
    area = polygon_area(hidden_polygon(light, point, corners))
    return 1.0 if area > 1 - 1e-9 else area


def triangle_rule(a, b, c, n):
    """Nodes and weights (sum: the triangle's area) of a collapsed n × n Gauss–Legendre rule."""
    x, w = gauss_legendre(n)
    s, t = np.meshgrid(x / 2 + 0.5, x / 2 + 0.5)
    w = np.outer(w, w).ravel() / 4 * abs(cross2(b - a, c - a)) * s.ravel()
    uv = a + s.reshape(-1, 1) * ((b - a) + t.reshape(-1, 1) * (c - b))
    return uv[:, 0], uv[:, 1], w


def subtract_convex(hits, light, diffuse, specular, corners, *, n=64, **reflection):
    """`panel_radiance` less the light that a convex body hides, integrated over the hidden polygon.

    Returns the two components and whether the body's shadow edge crosses the panel (penumbra).
    """
    diffuse, specular = diffuse.copy(), specular.copy()
    penumbra = np.zeros(len(hits.face), dtype=bool)
    for i in range(len(hits.face)):
        polygon = hidden_polygon(light, hits.point[i], corners)
        if len(polygon) == 0:
            continue
        if polygon_area(polygon) > 1 - 1e-9:
            diffuse[i] = specular[i] = 0
            continue
        penumbra[i] = True
        one = hits[i : i + 1]
        for k in range(1, len(polygon) - 1):
            rule = triangle_rule(polygon[0], polygon[k], polygon[k + 1], n)
            hidden = panel_radiance(one, light, **reflection, rule=rule)
            diffuse[i] -= hidden[0][0]
            specular[i] -= hidden[1][0]
    return diffuse, specular, penumbra
