"""The pieces of a fit, each against something worked out another way."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtr

from lightopt import build_scene, render
from lightopt.estimate.reflectance._likelihood import Likelihood, lagrange, predicted
from lightopt.estimate.reflectance._mismatch_causes import explained_share
from lightopt.estimate.reflectance._quality import Quality, fit_warnings
from lightopt.estimate.reflectance._samples import collect_samples, subsample
from lightopt.estimate.reflectance._validation import compare_image
from lightopt.estimate.reflectance._vector import DARK, LOG_R_S, LOG_SIGMA, R_D
from lightopt.estimate.registration import Observation
from lightopt.optics import expose, image_rng
from lightopt.rendering import cast_rays_at


@pytest.fixture(scope="module")
def samples(shared_bench):
    scene = build_scene(shared_bench.rig, shared_bench.part)
    observations = []
    for p, images in enumerate(render(scene)):
        for k, image in enumerate(images.lights):
            for exposure in (1.0, 0.25):
                rng = image_rng(3, light=k, posture=p, exposure=int(4 * exposure))
                levels = expose(image.level, sensor=scene.sensor, exposure=exposure, full_scale=255.0, rng=rng)
                observations.append(
                    Observation(
                        light=image.light,
                        posture=images.posture,
                        exposure=exposure,
                        levels=levels.astype(np.float32),
                        saturated=levels >= 255,
                        half_width=0.5,
                        source=Path("made-by-test.png"),
                    )
                )
    return collect_samples(scene, observations, caster=cast_rays_at(scene), budget=300)


@pytest.fixture(scope="module")
def likelihood(samples):
    nodes = math.log(0.0475) + np.linspace(-0.02, 0.02, 5)
    return Likelihood(samples, nodes, np.stack([samples.specular(math.exp(n)) for n in nodes], axis=1))


@pytest.fixture
def x(likelihood):
    x = np.zeros(likelihood.size)
    x[R_D], x[LOG_R_S], x[LOG_SIGMA], x[DARK] = 44.0, math.log(12000.0), math.log(0.0477), 0.3
    x[-2], x[-1] = math.log(0.7), -4.0
    return x


def test_the_kernel_is_the_likelihood_written_plainly(samples, likelihood, x):
    mean = predicted(samples, samples.specular(0.0477), x)
    signal = np.maximum(mean - 0.3, 0.0)
    deviation = np.sqrt(0.8**2 + signal / 60.0 + 0.7)
    q = samples.level.astype(float)
    low = np.where(q <= 0, -np.inf, q - 0.5)
    high = np.where(q >= 255, np.inf, q + 0.5)
    inside = ndtr((high - mean) / deviation) - ndtr((low - mean) / deviation)
    epsilon = 1.0 / (1.0 + math.exp(4.0))
    outlier = np.where((q <= 0) | (q >= 255), 0.05, 0.9 / 254.0)
    plain = np.log((1.0 - epsilon) * inside + epsilon * outlier).sum()
    assert (q >= 255).any()
    assert (q <= 0).any()
    assert likelihood.evaluate(x).value == pytest.approx(plain, rel=1e-6)


def test_the_gradient_is_the_slope_of_the_value(likelihood, x):
    gradient = likelihood.evaluate(x).gradient
    for place in range(likelihood.size):
        h = 1e-4
        ahead, behind = x.copy(), x.copy()
        ahead[place] += h
        behind[place] -= h
        slope = (likelihood.evaluate(ahead).value - likelihood.evaluate(behind).value) / (2.0 * h)
        assert gradient[place] == pytest.approx(slope, rel=2e-3, abs=0.05)


def test_pieces_of_the_image_add_up(likelihood, x):
    scores, curvatures = likelihood.by_block(x)
    assert len(scores) > 50
    whole = likelihood.evaluate(x)
    np.testing.assert_allclose(scores.sum(axis=0), whole.gradient, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(curvatures.sum(axis=0), whole.curvature, rtol=1e-9, atol=1e-6)


def test_threads_do_not_change_the_likelihood(samples, likelihood, x):
    values = [
        Likelihood(replace(samples, threads=n), likelihood.log_sigmas, likelihood.specular).evaluate(x).value
        for n in (1, 2)
    ]
    assert values[0] == values[1]


def test_the_table_interpolates_the_lobe(samples, likelihood):
    weights, slopes = lagrange(likelihood.log_sigmas, math.log(0.0479))
    exact = samples.specular(0.0479)
    np.testing.assert_allclose(likelihood.specular @ weights, exact, atol=1e-6 * exact.max())
    h = 1e-4
    slope = (samples.specular(0.0479 * math.exp(h)) - samples.specular(0.0479 * math.exp(-h))) / (2.0 * h)
    np.testing.assert_allclose(likelihood.specular @ slopes, slope, atol=1e-4 * np.abs(slope).max())


def test_lagrange_reproduces_polynomials():
    nodes = np.array([-1.0, -0.2, 0.5, 2.0])
    weights, slopes = lagrange(nodes, 0.7)
    assert weights @ nodes**3 == pytest.approx(0.7**3)
    assert slopes @ nodes**3 == pytest.approx(3 * 0.7**2)


def test_thinning_keeps_only_what_was_kept(samples):
    first = samples.select(samples.image == 0)
    few = subsample(first, 20)
    assert 0 < len(few.diffuse) < len(samples.diffuse)
    assert set(few.image.tolist()) == {0}
    rows = np.concatenate([g.row for g in few.groups])[few.sample]
    columns = np.concatenate([g.column for g in few.groups])[few.sample]
    np.testing.assert_array_equal(few.level, samples.images[0].levels[rows, columns])
    np.testing.assert_array_equal(few.diffuse, np.concatenate([
        np.zeros(len(g)) if g.layer is None else g.layer.diffuse for g in few.groups
    ]))  # fmt: skip


def test_pixels_are_chosen_without_looking_at_the_images(samples):
    other = samples.with_images(
        [replace(o, levels=np.zeros_like(o.levels), saturated=np.zeros_like(o.saturated)) for o in samples.images]
    )
    np.testing.assert_array_equal(subsample(samples, 50).diffuse, subsample(other, 50).diffuse)
    assert not other.level.any()


def test_a_predicted_disc_against_a_larger_one(samples):
    y, x = np.mgrid[:120, :160]
    radius = np.hypot(x - 80.0, y - 60.0)
    levels = np.where(radius <= 20.0, 255.0, 30.0).astype(np.float32)
    seen = replace(samples.images[0], levels=levels, saturated=levels >= 255)
    larger = np.where(radius <= 23.0, 300.0, 33.0).astype(np.float32)
    found = compare_image(seen, larger, np.ones((120, 160), bool), samples.sensor, 255.0)
    assert found.iou == pytest.approx(20.0**2 / 23.0**2, rel=0.02)
    assert found.border == pytest.approx(3.0, abs=0.25)  # of whole pixels
    assert found.area == np.count_nonzero(radius <= 20.0)
    ring = np.count_nonzero(radius <= 23.0) - found.area
    outside = 120 * 160 - found.area - ring
    assert found.rms == pytest.approx(math.sqrt((225.0**2 * ring + 9.0 * outside) / (120 * 160)), rel=1e-6)


def test_both_units_of_a_residual(samples):
    """At exposure 1/4, a level of the sensor is four grey levels."""
    seen = next(image for image in samples.images if image.exposure == 0.25)
    flat = replace(seen, levels=np.full((120, 160), 30.0, np.float32), saturated=np.zeros((120, 160), bool))
    found = compare_image(flat, np.full((120, 160), 33.0, np.float32), np.ones((120, 160), bool), samples.sensor, 255.0)
    assert (found.rms_sensor, found.rms) == (3.0, 12.0)


def test_no_saturation_has_no_overlap(samples):
    levels = np.full((120, 160), 30.0, np.float32)
    seen = replace(samples.images[0], levels=levels, saturated=levels >= 255)
    found = compare_image(seen, levels, np.ones((120, 160), bool), samples.sensor, 255.0)
    assert (found.iou, found.border, found.rms) == (None, None, 0.0)


@pytest.mark.parametrize(
    ("saturated", "shorter", "requested"),
    [
        (0.02, False, "add a shorter exposure, such as 1/16 of this one"),
        (0.02, True, "add a still shorter exposure"),
        (0.0, True, "add images with highlights elsewhere on the part"),
    ],
)
def test_what_separates_r_s_from_sigma_depends_on_what_is_saturated(saturated, shorter, requested):
    quality = Quality(
        rms=1.0, typical=1.0, noise=1.0, image_noise=1.0, explained=1.0, epsilon=0.0, tau=0.0, saturated=saturated
    )
    found = SimpleNamespace(free=(R_D, LOG_R_S, LOG_SIGMA), R_s=12_500.0, correlation=lambda *_: -0.99, describes=True)
    said = [*fit_warnings(found, quality, (12_281.0, 13_141.0), shorter=shorter, placed=True)]
    assert f"(correlation -0.990, R_s between 1.228e+04 and 1.314e+04): {requested}" in said[0]
    assert any("no pixel is saturated" in text for text in said) is (saturated == 0.0)


@pytest.mark.parametrize(
    ("before", "after", "share"),
    [
        ((2.0, 65.0), (0.5, 13.0), 0.8),
        # what is lost in the noise says nothing, neither that all is explained nor that nothing is
        ((0.0, 65.0), (0.0, 0.0), 1.0),
        ((0.001, 65.0), (0.0, 65.0), 0.0),
        ((0.001, 0.001), (0.0, 0.0), 0.0),
    ],
)
def test_what_another_place_explains_is_a_share_of_what_is_beyond_the_noise(before, after, share):
    assert explained_share(np.array(before), np.array(after), noise=1.0) == pytest.approx(share)
