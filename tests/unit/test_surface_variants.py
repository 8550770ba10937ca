"""Many variants of many points at once, against the reflection model point by point."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from reference import diffuse, specular

from lightopt.config import RigConfig
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight
from lightopt.optics import LAMBERT, DiffuseForm, Reflectance, SpecularModel
from lightopt.rendering import SurfacePoints, shade_variants, surface_variants
from lightopt.rendering._converged_panel import converged_panel, shade_converged
from lightopt.rendering._surface_light import shade_surface_lights
from lightopt.rendering._surface_variants import NEGLIGIBLE_LEVEL
from lightopt.scene import build_lights

MODELS = {
    "torrance-sparrow": (SpecularModel(), LAMBERT),
    "ggx": (SpecularModel(name="ggx", refractive_index=(1.98, 3.74)), LAMBERT),
    "two-lobe": (SpecularModel(name="two-lobe", wide_share=0.03, wide_ratio=5.0), LAMBERT),
    "measured": (SpecularModel(name="measured", measured=((0.7, 0.01), (0.25, 0.03), (0.05, 0.06))), LAMBERT),
    "brushed": (SpecularModel(across_ratio=6.0), LAMBERT),
    "brushed ggx": (SpecularModel(name="ggx", across_ratio=4.0, refractive_index=(1.98, 3.74)), LAMBERT),
    "exponent": (SpecularModel(), DiffuseForm(exponent=1.4)),
    "oren-nayar": (SpecularModel(), DiffuseForm(roughness=0.7)),
}
POINTS = 700  # more than are computed together, and no multiple of them
SLOPES = np.radians([0.0, 2.0, 2.0, 12.0, 30.0, 0.0])
DIRECTIONS = np.radians([0.0, 30.0, 210.0, 90.0, 300.0, 0.0])
R_D_FACTOR, SIGMA_FACTOR = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.7]), np.array([1.0, 1.0, 1.0, 1.0, 1.0, 2.0])


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def surface_of(rng):
    """Points of a bowl that turns round slowly from one to the next, seen from above."""
    turn = np.linspace(0.0, 4.0 * math.pi, POINTS)
    lean = np.linspace(0.0, 0.9, POINTS)
    normals = np.stack([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)], axis=1)
    points = 20.0 * normals + rng.normal(0.0, 0.1, (POINTS, 3))
    views = unit(np.array([0.0, 0.0, 500.0]) - points)
    references = unit(np.cross(normals, [0.3, -0.8, 0.1]))
    across = unit(np.cross(normals, [0.7, 0.2, -0.5]))
    return SurfacePoints(points, normals, normals, views, np.ones(POINTS, np.bool_), across=across), references


def panel_at(elevation, azimuth, **further):
    outward = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    across = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    return PanelLight(
        name="light",
        elevation=elevation,
        azimuth=azimuth,
        distance=300.0,
        centre=300.0 * outward,
        across=across,
        along=np.cross(outward, across),
        outward=outward,
        size=(60.0, 40.0),
        points=4,
        **further,
    )


def plain_levels(surface, references, panel, slope, direction, reflectance):
    """Levels of one variant: every term as equations 2 and 3 of the paper have it."""
    across = np.cross(surface.normals, references)
    normals = math.cos(slope) * surface.normals + math.sin(slope) * (
        math.cos(direction) * references + math.sin(direction) * across
    )
    along = np.sum(normals * surface.across, axis=1)[:, None]
    brushed = unit(surface.across - along * normals) if reflectance.model.across_ratio > 1.0 else None
    total = np.zeros(len(surface))
    for s in (-0.25, 0.25):
        for t in (-0.25, 0.25):
            place = panel.centre + s * panel.size[0] * panel.across + t * panel.size[1] * panel.along
            light = place - surface.points
            r2 = (light**2).sum(axis=1)
            light = unit(light)
            weight = 0.25 * panel.gain
            if panel.inverse_square:
                weight = weight * panel.distance**2 / r2
            weight = weight * np.maximum(0.0, light @ panel.outward) ** panel.emission_exponent
            total += weight * reflectance.R_d * diffuse(normals, surface.views, light, reflectance.diffuse)
            total += weight * reflectance.R_s * specular(normals, surface.views, light, reflectance, brushed)
    return total


@pytest.mark.parametrize("sigma", [0.02, 0.05, 0.3])
@pytest.mark.parametrize("further", [{}, {"inverse_square": True, "emission_exponent": 2.0, "gain": 1.7}])
@pytest.mark.parametrize("model", MODELS)
def test_levels_are_those_of_the_equations(model, sigma, further):
    """Narrow lobes that few points are near, and wide ones that the series of narrow ones does not reach."""
    surface, references = surface_of(np.random.default_rng(5))
    lobe, form = MODELS[model]
    reflectance = Reflectance(R_d=45.0, R_s=4000.0, sigma=sigma, model=lobe, diffuse=form)
    (variants,) = surface_variants(
        slope=SLOPES, direction=DIRECTIONS, R_d_factor=R_D_FACTOR, sigma_factor=SIGMA_FACTOR, reflectances=[reflectance]
    )
    for elevation, azimuth in ((1.0, 0.4), (0.5, 3.5)):
        panel = panel_at(elevation, azimuth, **further)
        (found,) = shade_variants(surface, references, [panel], [variants], caster=None)
        assert found.varied.shape == (len(SLOPES), POINTS)
        for t, (slope, direction) in enumerate(zip(SLOPES, DIRECTIONS, strict=True)):
            changed = reflectance.changed(R_d_factor=float(R_D_FACTOR[t]), sigma_factor=float(SIGMA_FACTOR[t]))
            plain = plain_levels(surface, references, panel, slope, direction, changed)
            assert np.allclose(found.varied[t], plain, rtol=1e-7, atol=NEGLIGIBLE_LEVEL)
        plain = plain_levels(surface, references, panel, 0.0, 0.0, reflectance)
        assert np.allclose(found.good, plain, rtol=1e-7, atol=NEGLIGIBLE_LEVEL)


def test_no_points_have_no_levels():
    surface, references = surface_of(np.random.default_rng(5))
    reflectance = Reflectance(R_d=45.0, R_s=4000.0, sigma=0.05)
    (variants,) = surface_variants(
        slope=SLOPES, direction=DIRECTIONS, R_d_factor=R_D_FACTOR, sigma_factor=SIGMA_FACTOR, reflectances=[reflectance]
    )
    none = slice(0, 0)
    panel = panel_at(1.0, 0.4)
    (found,) = shade_variants(surface.take(none), references[none], [panel], [variants], caster=None)
    assert found.varied.shape == (len(SLOPES), 0)
    assert len(found.good) == 0


@pytest.mark.parametrize("sigma", [0.03, 0.1])
@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", ["panel", "ring"])
def test_variants_of_whole_lights_are_the_light_on_other_surfaces(kind, model, sigma):
    """A converged panel and a ring on leaning normals, against the light of the leaning surface itself."""
    surface, references = surface_of(np.random.default_rng(5))
    few = np.arange(0, POINTS, 5)
    surface, references = surface.take(few), references[few]
    lobe, form = MODELS[model]
    R_s = 4000.0 * (0.05 / sigma) ** 2
    reflectance = Reflectance(R_d=45.0, R_s=R_s, sigma=sigma, model=lobe, diffuse=form)
    if kind == "panel":
        light = replace(panel_at(1.0, 0.4), points="auto")
        light = converged_panel(light, centre=np.zeros(3), radius=25.0)
    else:
        camera = {"distance_mm": 500, "elevation_deg": 90, "resolution_px": [32, 24], "pixel_size_um": 220}
        camera |= {"image_distance_mm": 50, "sensor": {"bit_depth": 8}}
        ring = {"name": "ring", "kind": "ring", "distance_mm": 200, "elevation_deg": 90, "azimuth_deg": 270}
        ring |= {"inner_radius_mm": 40, "outer_radius_mm": 70, "ring_tilt_deg": 20}
        rig = {"format": "lightopt-rig/1", "name": "x", "camera": camera, "lights": [ring]}
        (light,) = build_lights(RigConfig.model_validate(rig))
    slope, direction = SLOPES[:4], DIRECTIONS[:4]
    variants = surface_variants(
        slope=slope, direction=direction, R_d_factor=np.ones(4), sigma_factor=np.ones(4), reflectances=[reflectance]
    )
    (found,) = shade_variants(surface, references, [light], variants, caster=None)
    across = np.cross(surface.normals, references)
    for t in range(4):
        towards = math.cos(direction[t]) * references + math.sin(direction[t]) * across
        turned = math.cos(slope[t]) * surface.normals + math.sin(slope[t]) * towards
        leaning = replace(surface, normals=turned)
        if kind == "panel":
            sample, shape = 2 * np.arange(len(few)), (1, 2 * len(few))
            how = {"sample": sample, "shape": shape, "reflectance": reflectance, "caster": None}
            diffuse_light, specular_light, _ = shade_converged(leaning, light, **how)
        else:
            how = {"reflectance": reflectance, "caster": None}
            (diffuse_light,), (specular_light,) = shade_surface_lights(leaning, [light], **how)
        expected = reflectance.R_d * diffuse_light + reflectance.R_s * specular_light
        # a few points stand for a panel, and a few nodes for an element, to a few per cent of most lobes
        off = np.abs(found.varied[t] - expected) > 0.03 * expected + 0.02 * expected.max()
        assert off.mean() <= 0.02


def quadrants():
    camera = {"distance_mm": 500, "elevation_deg": 90, "resolution_px": [32, 24], "pixel_size_um": 220}
    camera |= {"image_distance_mm": 50, "sensor": {"bit_depth": 8}}
    dome = {"name": "dome", "kind": "dome", "distance_mm": 0, "radius_mm": 100, "camera_hole_mm": 30}
    dome |= {"segments": 4, "leak": 0.2}
    rig = {"format": "lightopt-rig/1", "name": "x", "camera": camera, "lights": [dome]}
    return build_lights(RigConfig.model_validate(rig))


@pytest.mark.parametrize("name", ["torrance-sparrow", "ggx"])
def test_lobes_of_variants_see_lights_that_the_part_half_hides(name):
    """A torus under a low ring shades itself: its highlights are in what is left of the ring's elements."""
    mesh = trimesh.creation.torus(17.0, 10.0, major_sections=96, minor_sections=48)
    caster = RayCaster(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32))
    rng = np.random.default_rng(2)
    around, about = rng.uniform(0.0, 2.0 * math.pi, 1500), rng.uniform(0.0, math.pi, 1500)
    out = np.stack([np.cos(around), np.sin(around), np.zeros(1500)], axis=1)
    normals = np.cos(about)[:, None] * out + np.sin(about)[:, None] * [0.0, 0.0, 1.0]
    points = 17.0 * out + 10.0 * normals
    front = normals[:, 2] > 0.2
    views = unit(np.array([0.0, 0.0, 500.0]) - points)
    references = unit(np.cross(normals, [0.3, -0.8, 0.1]))
    surface = SurfacePoints(points, normals, normals, views, front)
    camera = {"distance_mm": 500, "elevation_deg": 90, "resolution_px": [32, 24], "pixel_size_um": 220}
    camera |= {"image_distance_mm": 50, "sensor": {"bit_depth": 8}}
    ring = {"name": "low", "kind": "low_angle_ring", "distance_mm": 10, "radius_mm": 90, "height_mm": 15, "segments": 4}
    rig = {"format": "lightopt-rig/1", "name": "x", "camera": camera, "lights": [ring]}
    lights = build_lights(RigConfig.model_validate(rig))
    reflectance = Reflectance(R_d=45.0, R_s=4000.0, sigma=0.05, model=MODELS[name][0])
    one, wider = np.ones(1), np.full(1, 1.5)
    variants = surface_variants(
        slope=0.0 * one, direction=0.0 * one, R_d_factor=one, sigma_factor=wider, reflectances=[reflectance]
    )
    found = shade_variants(surface, references, lights, variants, caster=caster)
    own = reflectance.changed(R_d_factor=1.0, sigma_factor=1.5)
    diffuse_light, specular_light = shade_surface_lights(surface, lights, reflectance=own, caster=caster)
    for variant, diffuse_level, lobe in zip(found, diffuse_light, own.R_s * specular_light, strict=True):
        shows = front & (lobe > 5.0)
        assert shows.sum() > 50
        off = np.abs(variant.varied[0] - own.R_d * diffuse_level - lobe)
        assert np.mean(off[shows] > 0.2 * lobe[shows] + 1.0) < 0.01


def test_threads_do_not_matter():
    """The same bytes, though each number of threads works on other points at once."""
    surface, references = surface_of(np.random.default_rng(5))
    factors = {"R_d_factor": R_D_FACTOR, "sigma_factor": SIGMA_FACTOR}
    reflectance = Reflectance(R_d=45.0, R_s=4000.0, sigma=0.05)
    variants = surface_variants(slope=SLOPES, direction=DIRECTIONS, **factors, reflectances=[reflectance])
    first, *others = (
        shade_variants(surface, references, quadrants(), variants, caster=None, threads=threads)
        for threads in (1, 2, 3)
    )
    for other in others:
        assert all(np.array_equal(a.varied, b.varied) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("sigma", [0.01, 0.0475, 0.15])
@pytest.mark.parametrize("model", MODELS)
def test_variants_under_the_quadrants_of_a_dome(model, sigma):
    """Steep and gentle variants in any order, channels together: within about a percent of leaning surfaces."""
    surface, references = surface_of(np.random.default_rng(5))
    few = np.arange(0, POINTS, 10)
    surface, references = surface.take(few), references[few]
    lobe, form = MODELS[model]
    reflectance = Reflectance(R_d=45.0, R_s=4000.0 * (0.05 / sigma) ** 2, sigma=sigma, model=lobe, diffuse=form)
    lights = quadrants()
    slope, direction = np.radians([12.0, 2.0, 20.0, 2.0, 0.0, 0.0]), np.radians([30.0, 210.0, 300.0, 10.0, 0.0, 0.0])
    factors = {"R_d_factor": np.array([1.0, 1.0, 1.0, 1.0, 0.7, 1.0]), "sigma_factor": np.array([1.0] * 5 + [1.5])}
    variants = surface_variants(slope=slope, direction=direction, **factors, reflectances=[reflectance])
    found = shade_variants(surface, references, lights, variants, caster=None)
    across = np.cross(surface.normals, references)
    for t in range(len(slope)):
        towards = math.cos(direction[t]) * references + math.sin(direction[t]) * across
        leaning = replace(surface, normals=math.cos(slope[t]) * surface.normals + math.sin(slope[t]) * towards)
        own = reflectance.changed(**{key: float(values[t]) for key, values in factors.items()})
        diffuse_light, specular_light = shade_surface_lights(leaning, lights, reflectance=own, caster=None)
        expected = own.R_d * diffuse_light + own.R_s * specular_light
        for one, level in zip(found, expected, strict=True):
            assert np.mean(np.abs(one.varied[t] - level) > 0.012 * level.max() + 0.1) <= 0.02
