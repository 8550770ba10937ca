"""Tails of GGX from a converged panel, near its peak at grazing views and across horizons, against a plain sum."""

import numpy as np
import pytest

from lightopt.geometry import RayCaster
from lightopt.lights import place_light
from lightopt.optics import Reflectance, SpecularModel
from lightopt.rendering import SurfacePoints, shade_isolated

PANEL = {"name": "panel", "distance": 330.0, "elevation": np.radians(60.0), "azimuth": 0.0, "size": (60.0, 60.0)}

# α, normal, view, normal of the face if it is another one
CASES = {
    "face 5° off the normal": (0.1, (0.8917, 0.0401, -0.4509), (-0.2892, 0.01, -0.9572), (0.853, -0.01, -0.5218)),
    "face 12° off": (0.005, (0.9238, -0.0301, -0.3816), (-0.1494, 0.0697, -0.9863), (0.8209, -0.02, -0.5707)),
    "ridge aslant": (0.005, (-0.4979, -0.717, 0.4879), (-0.6194, -0.1998, -0.7592), None),
}


def unit(vector):
    return np.array(vector) / np.linalg.norm(vector)


def small_face(face, view):
    """A triangle around the origin, which hides nothing from it."""
    first = unit(np.cross(face, view))
    second = np.cross(face, first)
    corners = np.array([first, second - 0.5 * first, -second - 0.5 * first])
    return RayCaster(corners - corners.mean(axis=0), np.array([[0, 1, 2]], np.int32))


def level_at(normal, view, face, reflectance, shadows, **panel):
    surface = SurfacePoints(np.zeros((1, 3)), normal[None], face[None], view[None], np.ones(1, np.bool_))
    lights, caster = [place_light(**{**PANEL, **panel}, points="auto")], small_face(face, view)
    return shade_isolated(surface, lights, reflectances=[reflectance], caster=caster, shadows=shadows)[0, 0]


def summed(panel, alpha, normal, view, face, places=2000):
    """The mean over the panel of GGX above both horizons, per unit of R_s."""

    def masked(cosine):
        return 2.0 * cosine / (cosine + np.sqrt(alpha**2 + (1.0 - alpha**2) * cosine**2))

    x = 60.0 * ((np.arange(places) + 0.5) / places - 0.5)
    total = 0.0
    for t in x:
        light = panel.centre + x[:, None] * panel.across + t * panel.along
        light /= np.linalg.norm(light, axis=1)[:, None]
        half = light + view
        half /= np.linalg.norm(half, axis=1)[:, None]
        sine_squared = (np.cross(half, normal) ** 2).sum(axis=1)
        lit = (light @ normal > 0.0) & (light @ face > 0.0)
        value = masked(np.maximum(light @ normal, 0.0)) / (1.0 - sine_squared + sine_squared / alpha**2) ** 2
        total += np.sum(value[lit])
    return total / places**2 * masked(normal @ view) / (normal @ view)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("shadows", [True, False])
def test_tails_are_those_of_a_plain_sum(case, shadows):
    alpha, normal, view, face = CASES[case]
    normal, view = unit(normal), unit(view)
    face = normal if face is None or not shadows else unit(face)
    reflectance = Reflectance(R_d=0.0, R_s=41.4 / alpha**2, sigma=0.5 * alpha, model=SpecularModel(name="ggx"))
    level = level_at(normal, view, face, reflectance, shadows)
    expected = reflectance.R_s * summed(place_light(**PANEL, points=1), alpha, normal, view, face)
    np.testing.assert_allclose(level, expected, rtol=1e-3, atol=0.1)


@pytest.mark.parametrize("shadows", [True, False])
def test_no_light_comes_from_a_panel_opposite_the_view(shadows):
    """The half vector of its centre has no direction."""
    normal, up = unit([0.3, 0.2, 0.5]), np.array([0.0, 0.0, 1.0])
    reflectance = Reflectance(R_d=10.0, R_s=1e3, sigma=0.05, model=SpecularModel(name="ggx"))
    view = -unit(place_light(**{**PANEL, "elevation": np.radians(-90.0)}, points=1).centre)
    np.testing.assert_allclose(view, up, atol=1e-12)
    assert level_at(normal, view, normal, reflectance, shadows, elevation=np.radians(-90.0)) == 0.0
