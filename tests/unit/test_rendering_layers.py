"""Layers per unit of reflectance against the images that the renderer makes of the same scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lightopt import build_scene, render
from lightopt.config import load_rig
from lightopt.optics import LAMBERT, Reflectance
from lightopt.rendering import UNLIT, WHOLE, cast_rays_at, light_layer, mask_pixels, specular_of_layers, trace_pixels
from lightopt.rendering._pixels import LEFT_OUT, visibility_of_lights
from lightopt.rendering._surface import GRAZING_COSINE
from lightopt.scene import build_lights, pixel_directions


def of_width(sigma):
    return Reflectance(R_d=0.0, R_s=1.0, sigma=sigma)


@pytest.mark.parametrize("points", [1, 9, "auto"])
@pytest.mark.parametrize("sigma", [0.01, 0.0475, 0.2])
def test_layers_are_the_renderers(shared_bench, points, sigma):
    scene = build_scene(shared_bench.rig, shared_bench.part, points=points)
    scene = replace(scene, reflectance=replace(scene.reflectance, sigma=sigma))
    caster = cast_rays_at(scene)
    for images in render(scene, layers=True):
        pixels = trace_pixels(scene, images.posture, caster)
        for panel, image in zip(pixels.view.lights, images.lights, strict=True):
            visibility = visibility_of_lights(pixels, [panel], caster)[0]
            whole = np.flatnonzero(visibility == WHOLE)
            layer = light_layer(pixels.surface.take(whole), panel, caster, form=LAMBERT)
            place = pixels.row[whole], pixels.column[whole]
            assert len(whole) > 3000
            diffuse = scene.reflectance.R_d * layer.diffuse
            np.testing.assert_allclose(diffuse, image.diffuse[place], atol=0.02)
            specular = scene.reflectance.R_s * layer.specular(of_width(sigma))
            np.testing.assert_allclose(specular, image.specular[place], rtol=1e-5, atol=1e-2)
            dark = visibility == UNLIT
            assert not image.level[pixels.row[dark], pixels.column[dark]].any()


def test_pixels_of_penumbrae_and_silhouettes_are_left_out(shared_bench):
    scene = build_scene(shared_bench.rig, shared_bench.part)
    caster = cast_rays_at(scene)
    pixels = trace_pixels(scene, scene.postures[0], caster)
    hit = np.zeros(pixels.shape, bool)
    hit[pixels.row, pixels.column] = True
    clean = np.zeros(pixels.shape, bool)
    clean[pixels.row[pixels.clean], pixels.column[pixels.clean]] = True
    # no clean pixel has a neighbour that misses the part
    misses = ~hit
    near = misses.copy()
    near[1:] |= misses[:-1]
    near[:-1] |= misses[1:]
    near[:, 1:] |= misses[:, :-1]
    near[:, :-1] |= misses[:, 1:]
    assert not (clean & near).any()
    assert clean.sum() > 0.8 * hit.sum()
    visibility = visibility_of_lights(pixels, [pixels.view.lights[0]], caster)[0]
    assert (visibility == LEFT_OUT).any()


def test_threads_do_not_matter(shared_bench):
    scene = build_scene(shared_bench.rig, shared_bench.part, points="auto")
    caster = cast_rays_at(scene)
    layers = []
    for threads in (1, 2):
        pixels = trace_pixels(scene, scene.postures[1], caster, threads=threads)
        panel = pixels.view.lights[1]
        whole = np.flatnonzero(visibility_of_lights(pixels, [panel], caster, threads=threads)[0] == WHOLE)
        layer = light_layer(pixels.surface.take(whole), panel, caster, form=LAMBERT, threads=threads)
        layers.append((layer.diffuse, layer.specular(of_width(0.05), threads=threads)))
    assert all(np.array_equal(a, b) for a, b in zip(*layers, strict=True))


def test_the_deflection_is_never_more_than_that_of_a_point_of_the_panel(shared_bench):
    """A lobe that is dark beyond the deflection sees nothing of any of the panel's points."""
    scene = build_scene(shared_bench.rig, shared_bench.part, points=64)
    caster = cast_rays_at(scene)
    pixels = trace_pixels(scene, scene.postures[0], caster)
    panel = pixels.view.lights[0]
    whole = np.flatnonzero(visibility_of_lights(pixels, [panel], caster)[0] == WHOLE)
    layer = light_layer(pixels.surface.take(whole), panel, caster, form=LAMBERT)
    sigma = 0.05
    bound = np.exp(-0.5 * (layer.deflection / sigma) ** 2) / 0.1
    assert np.all(layer.specular(of_width(sigma)) <= 1.05 * bound + 1e-12)


def test_pixels_near_flagged_ones_are_those_within_two_rows_and_columns():
    from lightopt.rendering._pixels import _spread

    rng = np.random.default_rng(2)
    shown = rng.random((23, 31)) < 0.7
    row, column = (a.astype(np.int32) + 40 for a in np.nonzero(shown))
    flags = rng.random(len(row)) < 0.02
    assert 3 < flags.sum() < 30
    apart = np.maximum(abs(row[:, None] - row[flags]), abs(column[:, None] - column[flags])).min(axis=1)
    assert np.array_equal(_spread(flags, row, column), apart <= 2)
    assert _spread(flags[:0], row[:0], column[:0]).shape == (0,)


def test_the_range_nearby_is_that_of_pixels_within_two_rows_and_columns():
    from lightopt.rendering._pixels import _range_nearby

    rng = np.random.default_rng(3)
    row, column = (a.astype(np.int32) + 40 for a in np.nonzero(rng.random((23, 31)) < 0.7))
    values = rng.random(len(row))
    near = np.maximum(abs(row[:, None] - row), abs(column[:, None] - column)) <= 2
    least, most = _range_nearby(values, row, column)
    assert np.array_equal(least, np.where(near, values, np.inf).min(axis=1))
    assert np.array_equal(most, np.where(near, values, -np.inf).max(axis=1))
    assert _range_nearby(values[:0], row[:0], column[:0])[0].shape == (0,)


def test_quadrature_rules_are_read_only():
    from lightopt.rendering._panel_quadrature import NODES, WEIGHTS

    assert not NODES.flags.writeable
    assert np.allclose(WEIGHTS.sum(axis=1)[1:], 1.0)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("posture", [0, 1])
def test_masks_of_pixels_are_those_of_their_surface(shared_bench, threads, posture):
    scene = build_scene(shared_bench.rig, shared_bench.part)
    caster = cast_rays_at(scene)
    masks = mask_pixels(scene, scene.postures[posture], caster, threads=threads)
    pixels = trace_pixels(scene, scene.postures[posture], caster)
    at, surface, camera = (pixels.row, pixels.column), pixels.surface, pixels.view.camera
    facing = np.einsum("ij,ij->i", surface.normals, surface.views)
    away = surface.points - camera.position
    distance = np.linalg.norm(away, axis=1)
    axial = np.abs(away @ camera.forward) / distance
    cosine = np.maximum(np.abs(np.einsum("ij,ij->i", surface.facets, surface.views)), 0.02)
    area = (camera.pixel_size / camera.image_distance) ** 2 * axial**3 * distance**2 / cosine
    for found, expected in (
        (masks.hit, np.ones(len(facing), bool)),
        (masks.clean, pixels.clean),
        (masks.grazing, surface.front & (facing < GRAZING_COSINE)),
        (masks.area, area),
    ):
        whole = np.zeros(pixels.shape, found.dtype)
        whole[at] = expected
        assert np.allclose(found, whole, rtol=1e-5)
    assert 0 < masks.clean.sum() < masks.hit.sum()
    rays = pixel_directions(camera, pixels.column + 0.5, pixels.row + 0.5)
    assert set(np.flatnonzero(masks.faces)) == set(caster.first_hit(camera.position, rays))


def test_layers_of_channels_are_those_of_each(shared_bench):
    """Whether they are worked out together, which takes the same points, or apart, and whatever lies between them."""
    rig = load_rig(Path(__file__).parents[2] / "configs" / "rigs" / "display-stripes.yaml")
    scene = build_scene(shared_bench.rig, shared_bench.part)
    scene = replace(scene, lights=(*build_lights(rig)[:6], *scene.lights[:1], *build_lights(rig)[6:]))
    caster = cast_rays_at(scene)
    pixels = trace_pixels(scene, scene.postures[0], caster)
    some = np.flatnonzero(pixels.clean)[::7]
    layers = [
        light_layer(pixels.surface.take(some[: 500 + (k == 2)]), light, caster, form=LAMBERT)
        for k, light in enumerate(pixels.view.lights)
    ]
    together = specular_of_layers(layers, of_width(0.0475))
    for layer, found in zip(layers, together, strict=True):
        alone = layer.specular(of_width(0.0475))
        np.testing.assert_allclose(found, alone, atol=1e-4 * max(alone.max(), 1e-12))
