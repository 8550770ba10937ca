"""The polynomial of GGX's tail over a panel, against sums of the published formula over parts of it.

Expected: an error of at most 0.5 % of the panel's greatest light where it is faint, where rules of nodes may have 1 %;
no polynomial near the peak, across the horizon, and for other lobes.
"""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from worlds import plane, scene_from_mesh

from lightopt.core.vectors import Vector
from lightopt.lights import panel_numbers
from lightopt.optics import Reflectance, SpecularModel
from lightopt.rendering._panel_quadrature import MOST_TAIL_ERROR, PEAK_ERROR, WHOLE_PANEL, Rectangle
from lightopt.rendering._surface import surface_point
from lightopt.rendering._tail_polynomial import MOST_TERMS, polynomial_light, tail_polynomial

VIEW = np.array([0.0, 0.0, 1.0])
LIGHT = ref.Light(elevation=50, azimuth=270)
PANEL = scene_from_mesh(ref.Camera(width=80, height=60), [LIGHT], plane(40), points="auto").lights[0]


def lobe(sigma, **model):
    return Reflectance(R_d=1.0, R_s=1.0, sigma=sigma, model=SpecularModel(**model))


def tilted(angle, azimuth):
    """Unit normal [degrees]."""
    a, b = np.radians(angle), np.radians(azimuth)
    return np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])


def density(normal, own, s, t):
    places = PANEL.centre + s[:, None] * PANEL.size[0] * PANEL.across + t[:, None] * PANEL.size[1] * PANEL.along
    light = places / np.linalg.norm(places, axis=1, keepdims=True)
    return ref.specular(normal[None], VIEW[None], light, own)


def polynomial(normal, own):
    at = surface_point(Vector(0.0, 0.0, 0.0), Vector(*normal), Vector(*VIEW))
    found = np.zeros((MOST_TERMS, MOST_TERMS))
    return found, tail_polynomial(at, panel_numbers(PANEL), WHOLE_PANEL, own.lobe, 2, found)


@pytest.mark.parametrize("index", [None, (1.96, 3.80)])
@pytest.mark.parametrize("sigma", [0.003, 0.02, 0.0475])
def test_light_of_parts_of_a_panel(sigma, index):
    own, rng, worst, smooth = lobe(sigma, name="ggx", refractive_index=index), np.random.default_rng(3), 0.0, 0
    u, v, weights = ref.product_rule(16)
    for _ in range(300):
        normal = tilted(rng.uniform(0.0, 70.0), rng.uniform(0.0, 360.0))
        found, terms = polynomial(normal, own)
        if terms == 0:
            continue
        smooth += 1
        brightest = density(normal, own, u, v).max()
        for _ in range(4):
            (s0, s1), (t0, t1) = np.sort(rng.uniform(-0.5, 0.5, (2, 2)), axis=1)
            s, t = 0.5 * (s0 + s1) + (s1 - s0) * u, 0.5 * (t0 + t1) + (t1 - t0) * v
            expected = (s1 - s0) * (t1 - t0) * (density(normal, own, s, t) @ weights)
            light = polynomial_light(found, terms, WHOLE_PANEL, Rectangle(s0, s1, t0, t1))
            error = abs(light - expected) / ((s1 - s0) * (t1 - t0))
            worst = max(worst, error / max(PEAK_ERROR, MOST_TAIL_ERROR * brightest))
    print(f"σ {sigma}: {smooth} of 300 normals, error {worst:.2f} of what is allowed")
    assert smooth > 100
    assert worst <= 0.5


def test_no_polynomial_where_the_light_is_not_smooth():
    mirror = PANEL.centre / np.linalg.norm(PANEL.centre) + VIEW
    mirror /= np.linalg.norm(mirror)
    away = tilted(30.0, 90.0)
    assert polynomial(away, lobe(0.003, name="ggx"))[1] > 0
    assert polynomial(mirror, lobe(0.003, name="ggx"))[1] == 0
    assert polynomial(tilted(50.0, 90.0), lobe(0.003, name="ggx"))[1] == 0, "the horizon crosses the panel"
    assert polynomial(away, lobe(0.003))[1] == 0
    assert polynomial(away, lobe(0.003, name="ggx", across_ratio=3.0))[1] == 0
