"""The thin lens: depth of field, places in the pupil, diffraction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lightopt.optics import airy_diameter, airy_kernel, circle_of_confusion, depth_of_field, pupil_points


def airy_mtf(frequency, cutoff):
    """Contrast that a circular aperture leaves (Goodman, Introduction to Fourier Optics, eq. 6-32)."""
    share = np.minimum(frequency / cutoff, 1.0)
    return (2 / math.pi) * (np.arccos(share) - share * np.sqrt(1 - share * share))


@given(focal=st.floats(5, 100), f_number=st.floats(1, 22), focus=st.floats(200, 2000), depth=st.floats(150, 4000))
def test_circle_of_confusion_is_that_of_the_image_before_or_behind_the_sensor(focal, f_number, focus, depth):
    """By similar triangles between the lens, the point's own image and the sensor."""
    sensor, image = (1 / (1 / focal - 1 / a) for a in (focus, depth))
    expected = focal / f_number * abs(sensor - image) / image
    found = circle_of_confusion(np.array([depth]), focus=focus, aperture=focal / f_number, image_distance=sensor)
    assert found[0] == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_depth_of_field_ends_where_the_circle_is_as_wide_as_allowed():
    lens = {"focus": 550.0, "aperture": 6.25, "image_distance": 55.0}
    near, far = depth_of_field(0.0044, **lens)
    assert near < 550 < far
    np.testing.assert_allclose(circle_of_confusion(np.array([near, far]), **lens), 0.0044)
    assert depth_of_field(1.0, **lens)[1] == math.inf  # focused beyond the hyperfocal distance


def test_places_in_the_lens_are_spread_evenly_and_prefixes_stay():
    lens, pixel = pupil_points(128)
    assert np.array_equal(pupil_points(32)[0], lens[:32])
    assert np.hypot(*lens.T).max() <= 1
    assert np.abs(pixel).max() <= 0.5
    rng = np.random.default_rng(0)
    errors = {"spread": [], "random": []}
    for angle in np.linspace(0, math.pi, 12, endpoint=False):
        axis = np.array([math.cos(angle), math.sin(angle)])
        radius, turn = np.sqrt(rng.random(128)), 2 * math.pi * rng.random(128)
        independent = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
        for t in np.linspace(-0.9, 0.9, 19):
            share = 0.5 + (math.asin(t) + t * math.sqrt(1 - t * t)) / math.pi  # of the disc, beyond a chord
            for name, places in (("spread", lens), ("random", independent)):
                errors[name].append(np.mean(places @ axis < t) - share)
    spread, random = (np.sqrt(np.mean(np.square(e))) for e in errors.values())
    assert spread < 0.012 < 0.02 < random
    assert np.abs(lens.mean(axis=0)).max() < 0.005


@pytest.mark.parametrize("cutoff", [0.3, 0.5, 0.9, 1.5, 3.0, 6.0])
def test_kernel_of_diffraction_has_the_contrast_of_a_circular_aperture(cutoff):
    kernel = airy_kernel(cutoff)
    assert kernel.sum() == pytest.approx(1)
    assert kernel.min() > 0
    places = np.arange(len(kernel)) - len(kernel) // 2
    for frequency in (0.05, 0.1, 0.25):
        contrast = float(kernel.sum(axis=0) @ np.cos(2 * math.pi * frequency * places))
        assert contrast == pytest.approx(float(airy_mtf(np.array(frequency), cutoff)), abs=0.04)
    # light within the first dark ring: 83.8 % (Born and Wolf, section 8.5.2)
    radius = np.hypot(places[:, None], places)
    if 1.22 / cutoff > 2.2:
        assert kernel[radius < 1.22 / cutoff].sum() == pytest.approx(0.838, abs=0.03)


def test_disc_of_the_same_spread_as_diffraction():
    """Contrasts agree where both are above a half."""
    from scipy.special import j1

    frequency, cutoff = np.linspace(0.01, 0.35, 20), 1.0
    v = math.pi * frequency * airy_diameter(cutoff)
    np.testing.assert_allclose(2 * j1(v) / v, airy_mtf(frequency, cutoff), atol=0.12)
