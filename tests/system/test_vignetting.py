"""Vignetting dims images, what is fitted to them, and what a plan and an inspection expect, all by the same factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from captured import PART, PARTS, RIG

from lightopt.config import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.defects import BUILT_IN_CATALOGUE
from lightopt.design import DetectionModel, luminance_matrix, planned_catalogue
from lightopt.design.responses._image_evaluator import patch_points
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.registration import Observation, Placement
from lightopt.estimate.registration._placement import PixelSet, light_at, view_of_placed
from lightopt.rendering import build_patches, cast_rays_at, render_posture
from lightopt.scene import build_scene, lens_share, pixel_directions, project, view_from_part

V2, V4 = -0.3, 0.08
POSTURE = Posture(elevation_deg=-10, rotation_deg=170)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """The same scene without and with vignetting about an axis that is off the image's middle."""
    folder = tmp_path_factory.mktemp("vignetting")
    (folder / "knob.stl").write_bytes((PARTS / "cover-knob.stl").read_bytes())
    (folder / "part.yaml").write_text(PART, encoding="utf-8")
    keys = f"principal_point_px: [90, 50]\n  vignetting: {{v2: {V2}, v4: {V4}}}\n  sensor:"
    (folder / "rig.yaml").write_text(RIG.replace("sensor:", keys), encoding="utf-8")
    dimmed = build_scene(load_rig(folder / "rig.yaml"), load_part(folder / "part.yaml"))
    assert dimmed.camera.vignetting == (V2, V4)
    return replace(dimmed, camera=replace(dimmed.camera, vignetting=(0.0, 0.0))), dimmed


def factor(columns, rows):
    rho2 = ((columns - 90) ** 2 + (rows - 50) ** 2) / (80**2 + 60**2)
    return 1 + V2 * rho2 + V4 * rho2**2


def test_natural_vignetting_is_the_fourth_power_of_the_cosine_to_the_axis(scenes):
    camera = replace(scenes[0].camera, cos4=True)
    rows, columns = (a.ravel() + 0.5 for a in np.indices((120, 160)))
    rays = pixel_directions(camera, columns, rows)
    cosine = rays @ camera.forward / np.linalg.norm(rays, axis=1)
    np.testing.assert_allclose(lens_share(camera, columns, rows), cosine**4, rtol=1e-12)
    both = replace(camera, vignetting=(V2, V4))
    np.testing.assert_allclose(lens_share(both, columns, rows), factor(columns, rows) * cosine**4, rtol=1e-12)


@pytest.mark.parametrize("supersample", [1, 3])
def test_images(scenes, supersample):
    plain, dimmed = (render_posture(s, POSTURE, caster=cast_rays_at(s), supersample=supersample) for s in scenes)
    rows, columns = np.indices((120, 160)) + 0.5
    for one, other in zip(plain.lights, dimmed.lights, strict=True):
        assert (one.level > 50).any()
        np.testing.assert_allclose(
            other.level, one.level * factor(columns, rows), rtol=2e-3 if supersample > 1 else 1e-6
        )


def test_samples_and_pixels_of_a_registration(scenes):
    rows, columns = (a.ravel().astype(np.int32) for a in np.mgrid[30:90:7, 40:120:7])
    levels = np.zeros((120, 160), np.float32)
    seen = Observation(
        posture=POSTURE, light="light2", exposure=1.0, frames=1, levels=levels, saturated=levels > 0, half_width=0.5,
        subtracted=0.0, source=PARTS,
    )  # fmt: skip
    found = []
    for scene in scenes:
        caster = cast_rays_at(scene)
        pixels = PixelSet.look_up(POSTURE, rows, columns, [seen], 0.0)
        light = light_at(scene, pixels, view_of_placed(scene, POSTURE, Placement()), caster, sigmas=[0.05])
        samples = collect_samples(scene, [seen], caster=caster, budget=500)
        found.append((light, samples))
    (diffuse, specular), plain = found[0]
    (dimmed_diffuse, dimmed_specular), dimmed = found[1]
    assert np.nansum(diffuse) > 0
    share = factor(columns + 0.5, rows + 0.5)
    np.testing.assert_allclose(dimmed_diffuse, diffuse * share)
    np.testing.assert_allclose(dimmed_specular, specular * share)
    row, column = (np.concatenate([getattr(g, name) for g in plain.groups]) for name in ("row", "column"))
    share = factor(column + 0.5, row + 0.5)
    np.testing.assert_allclose(dimmed.diffuse, plain.diffuse * share)
    np.testing.assert_allclose(dimmed.specular(0.05), plain.specular(0.05) * share)


@pytest.mark.parametrize("detecting", [False, True])
def test_patches_of_a_plan(scenes, detecting):
    found = []
    for scene in scenes:
        caster = cast_rays_at(scene)
        table = build_patches(scene, caster=caster, budget=400)
        detection = None
        if detecting:
            catalogue = planned_catalogue([one for one in BUILT_IN_CATALOGUE if one.name == "dent"])
            detection = DetectionModel(catalogue=catalogue, sensor=scene.sensor, full_scale=255.0)
        panels = [[light] for light in scene.lights]
        found.append(luminance_matrix(scene, table, POSTURE, panels, caster=caster, detection=detection))
    surface, _ = patch_points(scenes[0], table, POSTURE)
    columns, rows, _ = project(view_from_part(scenes[0], POSTURE).camera, surface.points)
    for one, other in zip(found[0].levels, found[1].levels, strict=True):
        lit = (one[0] > 20) & (one[0] < 255)
        assert np.count_nonzero(lit) > 30
        off = other[0][lit] - one[0][lit] * factor(columns, rows)[lit]
        assert np.abs(off).max() <= 1.5  # of rounding
        assert np.abs(other[0][lit].astype(float) - one[0][lit]).max() > 3
