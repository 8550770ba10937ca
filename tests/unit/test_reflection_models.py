"""The specular lobes against plain formulas, and how exactly lights of panels and elements integrate them."""

import math

import numpy as np
import pytest
from reference import fresnel, specular

from lightopt.core.arrays import Float64
from lightopt.core.vectors import Vector
from lightopt.lights import PanelLight
from lightopt.optics import (
    Reflectance,
    SpecularModel,
    fresnel_factor,
    light_factor,
    lobe_across,
    round_ggx,
    specular_divisor,
    specular_lobe,
    square_across,
)
from lightopt.optics._reflection_model import conductor_reflectance
from lightopt.rendering import SurfacePoints
from lightopt.rendering._converged_panel import converged_panel, shade_converged

NICKEL = (1.98, 3.74)

MODELS = {
    "torrance-sparrow": SpecularModel(),
    "ggx": SpecularModel(name="ggx"),
    "ggx-metal": SpecularModel(name="ggx", refractive_index=NICKEL),
    "two-lobe": SpecularModel(name="two-lobe", wide_share=0.02, wide_ratio=8.0),
    "two-lobe-metal": SpecularModel(name="two-lobe", wide_share=0.1, wide_ratio=3.0, refractive_index=NICKEL),
    "measured": SpecularModel(name="measured", measured=((0.6, 0.01), (0.3, 0.022), (0.09, 0.05), (0.01, 0.09))),
    "brushed": SpecularModel(across_ratio=8.0),
    "brushed-ggx": SpecularModel(name="ggx", across_ratio=5.0),
    "brushed-two-lobe-metal": SpecularModel(
        name="two-lobe", wide_share=0.1, wide_ratio=3.0, refractive_index=NICKEL, across_ratio=3.0
    ),
}


def _unit(vectors: Float64) -> Float64:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _surface(count: int, seed: int = 3) -> SurfacePoints:
    # normals all over the upper half, seen from above: near the lobe, on its flank, at the horizon
    rng = np.random.default_rng(seed)
    points = rng.uniform(-30.0, 30.0, (count, 3)) * (1.0, 1.0, 0.5)
    views = _unit(np.array([0.0, 0.0, 550.0]) - points)
    tilt, turn = np.arccos(rng.uniform(0.2, 1.0, count)), rng.uniform(0.0, 2.0 * math.pi, count)
    normals = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    front = np.sum(normals * views, axis=1) > 0.0
    return SurfacePoints(points, normals, normals, views, front, across=_across(normals))


def _across(normals: Float64) -> Float64:
    # aslant to everything else
    return _unit(np.cross(normals, [0.8, -0.3, 0.2]))


def _panel() -> PanelLight:
    outward, across = _unit(np.array([1.0, 0.0, math.sqrt(3.0)])), np.array([0.0, 1.0, 0.0])
    return PanelLight(
        name="panel",
        elevation=math.radians(60.0),
        azimuth=0.0,
        distance=330.0,
        centre=330.0 * outward,
        across=across,
        along=np.cross(outward, across),
        outward=outward,
        size=(60.0, 60.0),
        points="auto",
    )


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("sigma", [0.003, 0.03, 0.15])
def test_lobe_is_the_published_formula(name: str, sigma: float) -> None:
    r = Reflectance(R_d=0.0, R_s=1.0, sigma=sigma, model=MODELS[name])
    rng = np.random.default_rng(1)
    view, light = (_unit(rng.normal((0.0, 0.0, 1.5), 1.0, (400, 3))) for _ in range(2))
    # half of the normals near the half vectors
    normal = _unit(_unit(light + view) + rng.normal(size=(400, 3)) * np.where(np.arange(400) % 2, 0.7, sigma)[:, None])
    found, brushed, across = np.zeros(400), r.model.across_ratio > 1.0, _across(normal)
    for i, (n, v, towards) in enumerate(zip(normal, view, light, strict=True)):
        if n @ towards <= 0.0 or n @ v <= 0.0:
            continue
        half = towards + v
        size = float(np.linalg.norm(half))
        chord = n - half / size
        lobe = lobe_across(r.lobe, Vector(*across[i])) if brushed else r.lobe
        squares = [square_across(Vector(*way), lobe) for way in (chord, towards, v)]
        value = specular_lobe(float(chord @ chord), squares[0], lobe) * light_factor(
            float(n @ towards), squares[1], size, lobe
        )
        if lobe.ggx and not brushed:
            few = round_ggx(float(chord @ chord), float(n @ towards), lobe.inverse)
            few *= fresnel_factor(size, lobe.n, lobe.k, lobe.normal_reflectance) if lobe.n > 0.0 else 1.0
            assert few == pytest.approx(value, rel=1e-12)
        found[i] = value / specular_divisor(float(n @ v), squares[2], lobe)
    expected = specular(normal, view, light, r, across if brushed else None)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)
    # the reversed path carries the same: f(l, v)·cosθ_i is what a level has of it
    swapped = specular(normal, light, view, r, across if brushed else None)
    cosines = np.sum(normal * light, axis=1), np.sum(normal * view, axis=1)
    both = (cosines[0] > 0.02) & (cosines[1] > 0.02)
    np.testing.assert_allclose((expected / cosines[0])[both], (swapped / cosines[1])[both], rtol=1e-9, atol=1e-200)


@pytest.mark.parametrize("index", [NICKEL, (0.2, 3.9), (3.2, 3.3)])
def test_fresnel_is_that_of_complex_numbers(index: tuple[float, float]) -> None:
    cosines = np.linspace(0.0, 1.0, 50)
    found = [conductor_reflectance(float(c), *index) for c in cosines]
    np.testing.assert_allclose(found, fresnel(cosines, index), rtol=1e-12)


def composite(surface: SurfacePoints, panel: PanelLight, r: Reflectance) -> Float64:
    """Mean of the lobe over a panel, by 6 × 6 Gauss–Legendre nodes in each of many squares; shape (k,)."""
    squares = math.ceil(np.clip(0.2 / r.sigma, 8, 64))
    x, w = np.polynomial.legendre.leggauss(6)
    at = ((np.arange(squares)[:, None] + 0.5 * (x + 1.0)) / squares - 0.5).ravel()
    weight = np.tile(0.5 * w / squares, squares)
    s, t = (a.ravel() for a in np.meshgrid(panel.size[0] * at, panel.size[1] * at))
    places = panel.centre + s[:, None] * panel.across + t[:, None] * panel.along
    whole = np.outer(weight, weight).ravel()
    brushed = r.model.across_ratio > 1.0
    across = surface.across if brushed else [None] * len(surface)
    rows = zip(surface.points, surface.normals, surface.views, across, strict=True)
    return np.array([specular(n, v, _unit(places - p), r, to) @ whole for p, n, v, to in rows])


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("sigma", [0.003, 0.0475, 0.15])
def test_converged_panel_integrates_the_lobe(name: str, sigma: float) -> None:
    # R_s so that the peak of a small panel is 1e4 levels, to a tenth of a level or a thousandth
    r = Reflectance(R_d=1.0, R_s=12500.0 * (0.0475 / sigma) ** 2, sigma=sigma, model=MODELS[name])
    # the reference takes 64 times as long for narrow lobes
    panel, surface = _panel(), _surface(60 if sigma > 0.01 else 8)
    half = _unit(_unit(panel.centre - surface.points) + surface.views)
    rng = np.random.default_rng(5)
    near = _unit(half + rng.normal(size=half.shape) * (4.0 * sigma + 0.03))
    normals = np.where(np.arange(len(surface))[:, None] % 2 == 1, near, surface.normals)
    front = np.sum(normals * surface.views, axis=1) > 0.0
    surface = SurfacePoints(surface.points, normals, normals, surface.views, front, across=_across(normals))
    converged = converged_panel(panel, centre=np.zeros(3), radius=40.0)
    sample, shape = 2 * np.arange(len(surface)), (1, 2 * len(surface))
    _, found, _ = shade_converged(surface, converged, sample=sample, shape=shape, reflectance=r, caster=None)
    expected = composite(surface, panel, r)
    error = np.abs(found - expected) * r.R_s
    wrong = error > np.maximum(0.1, 1e-3 * expected * r.R_s)
    assert not wrong.any(), (wrong.sum(), error[wrong], (expected * r.R_s)[wrong])
