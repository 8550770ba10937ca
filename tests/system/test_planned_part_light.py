"""Light from the part to the part in plans, against the images that have it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from worlds import merged, scene_from_mesh, sphere

from lightopt import render
from lightopt.defects import BUILT_IN_CATALOGUE
from lightopt.design import DetectionModel, planned_catalogue
from lightopt.design.responses._image_evaluator import ImageEvaluator, patch_points
from lightopt.design.responses._pairs import unpack_flags
from lightopt.geometry import TriangleMesh
from lightopt.optics import SpecularModel
from lightopt.optics._albedo import DEFAULT_ALBEDO
from lightopt.rendering import BouncedPatches, _bounced_patches, build_patches, cast_rays_at
from lightopt.scene import view_from_part
from lightopt.scene._scene import PartRegion

MATTE = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.05}
SATIN = {"R_d": 45.0, "R_s": 12500.0, "sigma": 0.0475}
BRUSHED = {"R_d": 45.0, "R_s": 1000.0, "sigma": 0.04, "model": SpecularModel(across_ratio=5.0)}
CAMERA = ref.Camera(width=200, height=150, pixel_um=35)
LIGHTS = [
    ref.Light(distance=300, elevation=50, azimuth=20, k=2),
    ref.Light(distance=300, elevation=60, azimuth=-70, k=2, gain=0.5),
]


def rectangle(corner, first, second):
    corner, first, second = (np.array(a, float) for a in (corner, first, second))
    corners = np.array([corner, corner + first, corner + first + second, corner + second])
    return TriangleMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), None)


def ditch():
    """Two walls at right angles, open upwards."""
    return merged(
        rectangle((0, -15, 0), (14, 0, 14), (0, 30, 0)), rectangle((0, -15, 0), (0, 30, 0), (-14, 0, 14))
    )  # fmt: skip


def images(scene):
    return np.array([image.level.astype(float) for image in next(iter(render(scene, threads=2))).lights])


def evaluator(scene):
    caster = cast_rays_at(scene)
    return ImageEvaluator(scene, build_patches(scene, caster=caster, edges=False), caster, None)


def bounced(own, posture):
    surface, seen = patch_points(own.scene, own.table, posture)
    return BouncedPatches(
        own.scene, view_from_part(own.scene, posture), surface, own.table.patches.areas[seen], own.caster
    )


@pytest.mark.parametrize("reflectance", [MATTE, SATIN, BRUSHED], ids=["matte", "satin", "brushed"])
@pytest.mark.parametrize("most", [300, pytest.param(10**6, marks=pytest.mark.slow)])
def test_patches_show_the_light_that_images_show(reflectance, most, monkeypatch):
    monkeypatch.setattr(_bounced_patches, "MOST", most)
    scene = scene_from_mesh(CAMERA, LIGHTS, ditch(), reflectance=reflectance)
    bright = replace(scene, bounces=1)
    dark = images(scene)
    added = images(bright) - dark
    own = evaluator(bright)
    view, patches = view_from_part(scene, scene.postures[0]), bounced(own, scene.postures[0])
    found = np.array([patches.levels(light)[0] for light in view.lights])
    cosines = np.einsum("ij,ij->i", patches.surface.normals, patches.surface.views)
    weights = patches.areas * cosines  # about as many pixels, all of them nearly equally far from the camera
    expected = added[:, dark[0] > 0.0].mean(axis=1)
    np.testing.assert_allclose(found @ weights / weights.sum(), expected, rtol=0.07)
    assert expected.min() > 1.0
    if most > len(weights):
        assert np.quantile(found[0], [0.2, 0.8]) == pytest.approx(
            np.quantile(added[0][dark[0] > 0.0], [0.2, 0.8]), rel=0.1
        )


def test_a_convex_part_in_white_surroundings_has_their_light_in_plans():
    """Without a word of bounces, as its images have it: albedo times the surroundings' level times the light's gain."""
    dark = scene_from_mesh(CAMERA, LIGHTS, sphere(8.0), reflectance=SATIN)
    bright = replace(dark, environment=80.0)
    own = evaluator(bright)
    found = bounced(own, dark.postures[0]).levels(view_from_part(bright, dark.postures[0]).lights[1])[0]
    assert np.median(found) == pytest.approx(DEFAULT_ALBEDO * 80.0 * 0.5, rel=0.02)
    delivered = []
    for scene in (dark, bright):
        some = replace(own, scene=scene)
        panels = [[light] for light in scene.lights]
        shown = [replace(some, threads=n).matrices(scene.postures[0], panels)[0].levels for n in (1, 3)]
        assert all(np.array_equal(*pair) for pair in zip(*shown, strict=True))
        alone = some.matrices(scene.postures[0], panels[1:])[0].levels[0]
        assert np.array_equal(shown[0][1], alone), "whatever other lights are worked out"
        delivered.append(alone[0].astype(float))
    assert np.median(delivered[1] - delivered[0]) == pytest.approx(DEFAULT_ALBEDO * 80.0 * 0.5, abs=1.0)


def test_regions_have_their_own_light():
    """Of two walls, one half as bright lights the other one half as much, and shows half of the other one's light."""
    scene = replace(scene_from_mesh(CAMERA, LIGHTS, ditch(), reflectance=MATTE), bounces=1)
    darker = PartRegion(name="darker", reflectance=replace(scene.reflectance, R_d=50.0))
    two = replace(scene, mesh=replace(scene.mesh, material=np.array([0, 0, 1, 1], np.uint8)), regions=(darker,))
    shown = []
    for own in (evaluator(scene), evaluator(two)):
        patches = bounced(own, scene.postures[0])
        shown.append(patches.levels(view_from_part(scene, scene.postures[0]).lights[0])[0])
    assert np.quantile(np.abs(shown[1] - 0.5 * shown[0]) / (0.2 + 0.05 * shown[0]), 0.999) < 1.0
    assert 0.5 * shown[0].mean() == pytest.approx(shown[1].mean(), rel=0.02)


def test_light_that_saturates_hides_defects_in_plans():
    scene = scene_from_mesh(CAMERA, LIGHTS, sphere(8.0), reflectance=SATIN)
    own = evaluator(scene)
    detection = DetectionModel(
        catalogue=planned_catalogue(BUILT_IN_CATALOGUE), sensor=scene.sensor, full_scale=scene.reflectance.full_scale
    )
    shares = []
    for environment in (0.0, 5_000.0):
        lit = replace(own, scene=replace(scene, environment=environment), detection=detection)
        (shown,) = lit.matrices(scene.postures[0], [[light] for light in scene.lights])
        enough = shown.visibility.most_units(lit.needed)[-1]
        shares.append(unpack_flags(enough, len(detection.catalogue.defects)).mean())
    assert shares[0] > 0.3
    assert shares[1] == 0.0


def test_a_posture_that_shows_no_patch():
    scene = scene_from_mesh(CAMERA, LIGHTS, sphere(8.0), reflectance=SATIN)
    own = evaluator(replace(scene, bounces=1))
    hidden = replace(own, table=replace(own.table, visible=np.zeros_like(own.table.visible)))
    assert hidden.matrices(scene.postures[0], [[scene.lights[0]]])[0].levels[0].shape == (1, 0)
