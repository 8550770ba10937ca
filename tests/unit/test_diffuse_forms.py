"""The forms of the diffuse component: plain formulas, closed forms of their energy, and integrals over large lights."""

import math

import numpy as np
import pytest
import reference as ref

from lightopt.config import RigConfig
from lightopt.core.arrays import Float64
from lightopt.lights import SurfaceLight
from lightopt.optics import LAMBERT, DiffuseForm, Reflectance, diffuse_term, is_lambert, lambert, white_level
from lightopt.optics._albedo import DEFAULT_ALBEDO, diffuse_albedo
from lightopt.rendering import SurfacePoints
from lightopt.rendering._surface_light import shade_surface_lights
from lightopt.scene import build_lights

FORMS = {
    "exponent": DiffuseForm(exponent=1.12),
    "shallow": DiffuseForm(exponent=0.6),
    "steep": DiffuseForm(exponent=3.0),
    "oren-nayar": DiffuseForm(roughness=0.4),
    "rough": DiffuseForm(roughness=1.0),
}


def unit(vectors: Float64) -> Float64:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def terms(normal: Float64, view: Float64, light: Float64, form: DiffuseForm) -> Float64:
    rows = zip(normal, view, light, strict=True)
    return np.array([diffuse_term(float(n @ to), float(n @ v), float(to @ v), form) for n, v, to in rows])


def directions(seed: int) -> tuple[Float64, Float64, Float64]:
    """Normals, views and lights; views are above the horizon, most lights are."""
    rng = np.random.default_rng(seed)
    normal, view = unit(rng.normal(size=(2, 3000, 3)))
    view = np.where(np.sum(normal * view, axis=1)[:, None] > 0.0, view, -view)
    return normal, view, unit(normal + rng.normal(size=(3000, 3)))


@pytest.mark.parametrize("name", FORMS)
def test_terms_are_the_published_formulas(name: str) -> None:
    normal, view, light = directions(1)
    found = terms(normal, view, light, FORMS[name])
    np.testing.assert_allclose(found, ref.diffuse(normal, view, light, FORMS[name]), rtol=1e-9, atol=1e-9)


def test_exponent_1_and_roughness_0_are_lambert() -> None:
    normal, view, light = directions(2)
    cosine = np.sum(normal * light, axis=1)
    assert is_lambert(LAMBERT)
    assert not any(map(is_lambert, FORMS.values()))
    np.testing.assert_allclose(terms(normal, view, light, LAMBERT), [lambert(float(c)) for c in cosine], atol=1e-15)
    for form in (DiffuseForm(exponent=1.0 + 1e-9), DiffuseForm(roughness=1e-9)):
        np.testing.assert_allclose(terms(normal, view, light, form), np.maximum(0.0, cosine), atol=2e-9)


@pytest.mark.parametrize("name", ["oren-nayar", "rough"])
def test_oren_and_nayar_reflect_as_much_backwards(name: str) -> None:
    normal, view, light = directions(3)
    cosines = np.sum(normal * light, axis=1), np.sum(normal * view, axis=1)
    both = (cosines[0] > 0.01) & (cosines[1] > 0.01)
    forth = terms(normal, view, light, FORMS[name])[both] / cosines[0][both]
    back = terms(normal, light, view, FORMS[name])[both] / cosines[1][both]
    np.testing.assert_allclose(forth, back, rtol=1e-9)


def albedo(cos_view: float, form: DiffuseForm) -> float:
    """(1/π) ∫ term dω over the light's directions, by nodes that are dense at the horizon."""
    x, w = np.polynomial.legendre.leggauss(80)
    theta, phi = 0.25 * math.pi * (x + 1.0), (np.arange(200) + 0.5) * math.pi / 200
    light = np.stack(
        np.broadcast_arrays(
            np.sin(theta)[:, None] * np.cos(phi), np.sin(theta)[:, None] * np.sin(phi), np.cos(theta)[:, None]
        ),
        axis=-1,
    ).reshape(-1, 3)
    view = np.array([math.sqrt(1.0 - cos_view**2), 0.0, cos_view])
    values = terms(np.tile([0.0, 0.0, 1.0], (len(light), 1)), np.tile(view, (len(light), 1)), light, form)
    return float(np.sum(values.reshape(80, 200).mean(axis=1) * np.sin(theta) * w) * 0.5 * math.pi)


def fujii_albedo(mu: float, roughness: float) -> float:
    """Directional albedo of Fujii's form (Portsmouth, Kutz, Hill 2024)."""
    sine = math.sqrt(1.0 - mu * mu)
    g = sine * (math.acos(mu) - sine * mu) + 2.0 / 3.0 * (sine / mu * (1.0 - sine**3) - sine)
    return (1.0 + roughness * g / math.pi) / (1.0 + (0.5 - 2.0 / (3.0 * math.pi)) * roughness)


@pytest.mark.parametrize("name", FORMS)
def test_energy(name: str) -> None:
    form = FORMS[name]
    for mu in (0.02, 0.2, 0.5, 0.8, 1.0):
        expected = fujii_albedo(mu, form.roughness) if form.roughness else 2.0 / (form.exponent + 1.0)
        assert albedo(mu, form) == pytest.approx(expected, rel=2e-4)
        if form.roughness:
            assert expected <= 1.0
    x, w = np.polynomial.legendre.leggauss(40)
    mu = 0.5 * (x + 1.0)
    if form.roughness:
        mean = float(np.sum(w * mu * [fujii_albedo(m, form.roughness) for m in mu]))
        assert diffuse_albedo(form) == pytest.approx(mean, rel=1e-6)
    else:
        assert diffuse_albedo(form) == 2.0 / (form.exponent + 1.0)
    level = white_level(Reflectance(R_d=50.0, R_s=0.0, sigma=0.05, diffuse=form))
    assert level == pytest.approx(50.0 * diffuse_albedo(form) / DEFAULT_ALBEDO)


CAMERA = {
    "distance_mm": 500,
    "elevation_deg": 90,
    "resolution_px": [32, 24],
    "pixel_size_um": 220,
    "image_distance_mm": 50,
    "sensor": {"bit_depth": 8},
}
LARGE = {
    "bar": (
        {"kind": "bar", "distance_mm": 250, "elevation_deg": 30, "azimuth_deg": 180, "size_mm": [200, 20]},
        {"kind": "bar", "distance": 250, "elevation": 30, "azimuth": 180, "size": (200, 20)},
    ),
    "dome": (
        {"kind": "dome", "distance_mm": 0, "elevation_deg": 90, "azimuth_deg": 270, "radius_mm": 100}
        | {"camera_hole_mm": 30},
        {"kind": "dome", "distance": 0, "elevation": 90, "azimuth": 270, "radius": 100, "hole": 30},
    ),
}


def large_light(name: str) -> SurfaceLight:
    rig = {"format": "lightopt-rig/1", "name": "x", "camera": CAMERA, "lights": [{"name": "light", **LARGE[name][0]}]}
    (light,) = build_lights(RigConfig.model_validate(rig))
    assert isinstance(light, SurfaceLight)
    return light


def half_sphere(count: int) -> SurfacePoints:
    rng = np.random.default_rng(1)
    z, phi = rng.uniform(0.25, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    root = np.sqrt(1.0 - z * z)
    normals = np.stack([root * np.cos(phi), root * np.sin(phi), z], axis=1)
    points = 25.0 * normals - [0.0, 0.0, 12.5]
    return SurfacePoints(points, normals, normals, unit([0.0, 0.0, 500.0] - points), np.ones(count, np.bool_), True)


@pytest.mark.parametrize("light", LARGE)
@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.nightly) if one not in ("exponent", "rough") else one for one in FORMS]
)
def test_large_lights_integrate_each_form(name: str, light: str) -> None:
    """To a tenth of a level or a thousandth where R_d is 100."""
    surface, form = half_sphere(30), FORMS[name]
    reflectance = Reflectance(R_d=100.0, R_s=0.0, sigma=0.05, diffuse=form)
    (found,), _ = shade_surface_lights(surface, [large_light(light)], reflectance=reflectance, caster=None)
    emitter = ref.emitter(**LARGE[light][1])
    rows = zip(surface.points, surface.normals, surface.views, strict=True)

    def value(n: Float64, v: Float64, towards: Float64) -> Float64:
        return ref.diffuse(n, v, towards, form)

    expected = np.array([emitter.light(*row, 0.05, form=value, diffuse_cells=96)[0] for row in rows])
    off = 100.0 * np.abs(found - expected) / np.maximum(0.1, 0.001 * 100.0 * expected)
    print(f"at most {off.max():.2f} of 0.1 level or 0.1 %, {np.mean(off > 1.0):.1%} more than it")
    assert np.mean(off > 1.0) <= 0.01
    assert off.max() <= 2.0
