"""Reflectance recovered from images with noise, 8-bit quantisation and saturation.

The images are rendered from a mesh three times finer than the one that is fitted with, except where a test says that
both are matched: intervals that leave out the model's own error only mean something then.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from captured import PART, PARTS, RIG, captured, profile_interval

from lightopt import build_scene
from lightopt.estimate.reflectance._estimate import Estimate
from lightopt.estimate.reflectance._fit_samples import fit_reflectance
from lightopt.estimate.reflectance._quality import assess_quality, poor_fit_warnings
from lightopt.estimate.reflectance._samples import collect_samples
from lightopt.estimate.reflectance._vector import LOG_R_S, LOG_SIGMA
from lightopt.optics import Reflectance
from lightopt.rendering import cast_rays_at

TRUTH = Reflectance(R_d=45.0, R_s=12500.0, sigma=0.0475)
BUDGET = 3000


class World:
    """The knob at 480 × 360 px under three lights in two postures, with a mesh to fit with and a finer one."""

    def __init__(self, folder: Path) -> None:
        shutil.copy(PARTS / "cover-knob.step", folder / "knob.step")
        rig = RIG.replace("[160, 120]", "[480, 360]").replace("pixel_size_um: 44", "pixel_size_um: 14.6667")
        fine = rig.replace("[480, 360]", "[4800, 3600]").replace("14.6667", "1.46667")
        (folder / "rig.yaml").write_text(rig, encoding="utf-8")
        (folder / "fine.yaml").write_text(fine, encoding="utf-8")
        (folder / "part.yaml").write_text(PART.replace("knob.stl, units: mm", "knob.step"), encoding="utf-8")
        self.rig = folder / "rig.yaml"
        self.scene = build_scene(folder / "rig.yaml", folder / "part.yaml", points="auto")
        self.fine = build_scene(folder / "fine.yaml", folder / "part.yaml").mesh
        self.caster = cast_rays_at(self.scene)

    def fit(self, reflectance: Reflectance = TRUTH, **options) -> Estimate:
        images = captured(self.scene, reflectance=reflectance, mesh=self.fine, **options)
        return fit_reflectance(collect_samples(self.scene, images, caster=self.caster, budget=BUDGET))


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> World:
    return World(tmp_path_factory.mktemp("fit"))


@pytest.fixture(scope="module")
def one_exposure(world) -> Estimate:
    return world.fit()


@pytest.fixture(scope="module")
def two_exposures(world) -> Estimate:
    return world.fit(exposures=(1.0, 1 / 16))


def assert_recovers(found: Estimate, truth: Reflectance, *, R_d: float, R_s: float, sigma: float) -> None:
    errors = found.R_d / truth.R_d - 1.0, found.R_s / truth.R_s - 1.0, found.sigma / truth.sigma - 1.0
    print("R_d {:+.3%}  R_s {:+.3%}  σ {:+.3%}".format(*errors))
    assert found.maximum.converged
    assert abs(errors[0]) <= R_d
    assert abs(errors[1]) <= R_s
    assert abs(errors[2]) <= sigma


@pytest.mark.nightly
def test_the_fine_mesh_is_finer(world):
    assert len(world.fine.faces) > 3 * len(world.scene.mesh.faces)


@pytest.mark.nightly
def test_one_exposure_recovers_the_reflectance(one_exposure):
    assert_recovers(one_exposure, TRUTH, R_d=0.01, R_s=0.05, sigma=0.02)


@pytest.mark.nightly
def test_a_second_exposure_pins_r_s_down(world, one_exposure, two_exposures):
    """At least five times."""
    assert_recovers(two_exposures, TRUTH, R_d=0.01, R_s=0.02, sigma=0.01)
    is_narrower(one_exposure, two_exposures)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_second_exposure_pins_r_s_down_in_any_noise(world, seed):
    is_narrower(world.fit(seed=seed), world.fit(exposures=(1.0, 1 / 16), seed=seed))


def is_narrower(wide: Estimate, narrow: Estimate) -> None:
    ratio = np.ptp(profile_interval(wide, LOG_R_S)) / np.ptp(profile_interval(narrow, LOG_R_S))
    print("interval of ln R_s narrower by", ratio)
    assert abs(narrow.correlation(LOG_R_S, LOG_SIGMA)) < abs(wide.correlation(LOG_R_S, LOG_SIGMA))
    assert ratio >= 5.0


@pytest.mark.nightly
def test_one_pixel_in_a_hundred_may_be_garbage(world):
    found = world.fit(exposures=(1.0, 1 / 16), garbage=0.01)
    assert_recovers(found, TRUTH, R_d=0.01, R_s=0.02, sigma=0.01)
    assert found.epsilon == pytest.approx(0.01, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma", "R_s"),
    [
        *(
            pytest.param(*case, marks=pytest.mark.nightly)
            for case in ((0.003, 3e6), (0.15, 12500.0), (0.01, 280e3), (0.0475, 300.0), (0.0475, 3e4), (0.0475, 3e6))
        )
    ],
)
def test_lobes_of_any_width_and_strength(world, sigma, R_s):
    truth = Reflectance(R_d=45.0, R_s=R_s, sigma=sigma)
    found = world.fit(truth, exposures=(1.0, 1 / 16))
    assert_recovers(found, truth, R_d=0.01, R_s=0.02, sigma=0.01)


@pytest.mark.nightly
def test_normals_guessed_from_facets_are_noticed(world, tmp_path):
    """The same images, fitted with the STL file: no figure is far off, the fit says so, and its interval holds."""
    shutil.copy(PARTS / "cover-knob.stl", tmp_path / "knob.stl")
    (tmp_path / "part.yaml").write_text(PART, encoding="utf-8")
    scene = build_scene(world.rig, tmp_path / "part.yaml", points="auto")
    images = captured(world.scene, mesh=world.fine, exposures=(1.0, 1 / 16))
    samples = collect_samples(scene, images, caster=cast_rays_at(scene), budget=BUDGET)
    found = fit_reflectance(samples)
    low, high = np.exp(profile_interval(found, LOG_R_S)) / TRUTH.R_s - 1.0
    quality = assess_quality(samples, found)
    print(f"interval of R_s {low:+.2%} to {high:+.2%}, unexplained {quality.epsilon:.1%}")
    assert_recovers(found, TRUTH, R_d=0.01, R_s=0.06, sigma=0.02)
    assert low < 0.0 < high
    assert quality.epsilon > 0.02
    assert any("describes these images badly" in text for text in poor_fit_warnings(found, quality))
    assert high - low > 0.02
