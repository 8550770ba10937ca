"""Images that are of the part but lie a little off, and images that fit badly for other reasons.

Expected: the former are refused with the shift in pixels, since R_s and σ fitted to them are worth nothing; the latter
get their numbers and a warning.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from captured import PART, PARTS, RIG, captured

from lightopt import build_scene
from lightopt.core.errors import InputError
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._mismatch_causes import refuse_unexplained_images
from lightopt.estimate.reflectance._quality import assess_quality, poor_fit_warnings
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.reflectance._setup import FitSetup
from lightopt.estimate.registration import Placement, place_part
from lightopt.rendering import cast_rays_at

pytestmark = pytest.mark.slow

PIXEL_MM = 0.44
TWO = (1.0, 1 / 16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strangers")
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    (folder / "stl.yaml").write_text(PART, encoding="utf-8")
    (folder / "part.yaml").write_text(PART.replace("knob.stl, units: mm", "knob.step"), encoding="utf-8")
    for kind in ("stl", "step"):
        shutil.copy(PARTS / f"cover-knob.{kind}", folder / f"knob.{kind}")
    return folder


@pytest.fixture(scope="module")
def scene(folder):
    return build_scene(folder / "rig.yaml", folder / "part.yaml")


def judged(scene, images):
    samples = collect_samples(scene, images, caster=cast_rays_at(scene), budget=500)
    found = fit_reflectance(samples)
    quality = assess_quality(samples, found)
    world = FitSetup(scene, cast_rays_at(scene), images)
    refuse_unexplained_images(world, samples, found, quality)
    return found, quality


def rolled(images, pixels, axis):
    return tuple(
        replace(
            o, levels=np.roll(o.levels, pixels, axis), saturated=np.roll(o.saturated, pixels, axis)
        )
        for o in images
    )  # fmt: skip


def refused_shift(scene, images, reported="Register the part"):
    with pytest.raises(InputError, match=reported) as refused:
        judged(scene, images)
    found = re.search(r"shifted by ([0-9.]+) px", str(refused.value))
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize(
    ("pixels", "axis", "exposures"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in ((3, 1, (1.0,)), (1, 1, TWO), (-3, 0, TWO), (12, 1, (1.0,)))
        )
    ],
)
def test_a_camera_that_is_off_is_refused(scene, pixels, axis, exposures):
    """All images are shifted alike, which no place of the part does once the stage has turned it."""
    images = rolled(captured(scene, exposures=exposures), pixels, axis)
    reported = "no single placement explains the images of all postures: correct the camera"
    # 1.1 is within a tenth of 1, but for rounding
    assert refused_shift(scene, images, reported) == pytest.approx(abs(pixels), rel=0.1 + 1e-9)


@pytest.mark.nightly
def test_a_part_that_lies_a_millimetre_off_is_refused(scene):
    placed = place_part(scene, Placement(x=0.8, y=-0.6))
    assert refused_shift(scene, captured(placed, exposures=TWO)) == pytest.approx(1.0 / PIXEL_MM, rel=0.1)


@pytest.mark.nightly
def test_good_images_and_garbage_are_not_refused(scene):
    for garbage in (0.0, 0.05):
        found, quality = judged(scene, captured(scene, garbage=garbage))
        assert quality.poor == (garbage > 0.02)
        assert found.R_s == pytest.approx(12500.0, rel=0.03)


@pytest.mark.nightly
def test_normals_guessed_from_facets_are_not_refused(folder, scene):
    coarse = build_scene(folder / "rig.yaml", folder / "stl.yaml")
    _, quality = judged(coarse, captured(scene, exposures=TWO))
    assert quality.poor


# --- noise that the rig file does not have


@pytest.mark.parametrize("R_d", [6.0, 45.0])
def test_noise_that_the_rig_does_not_give_is_not_held_against_the_images(scene, R_d):
    noisy = replace(scene, sensor=replace(scene.sensor, read_noise_levels=2.0, electrons_per_level=30.0))
    matte = replace(scene.reflectance, R_d=R_d, R_s=0.0)
    images = captured(noisy, reflectance=matte)
    silent = replace(scene, sensor=replace(scene.sensor, read_noise_levels=0.0, electrons_per_level=None))
    found, quality = judged(silent, images)
    assert not quality.poor
    assert quality.image_noise == pytest.approx(2.1, abs=0.4)
    text = " ".join(poor_fit_warnings(found, quality))
    assert "rig file" in text
    assert "read_noise_levels" in text
    assert "badly" not in text
    assert found.R_d == pytest.approx(R_d, rel=0.02)
