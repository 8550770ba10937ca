"""Means of frames, merged brackets and the check of the light, against plain references."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lightopt.optics import Sensor
from lightopt.rig.capture._acquisition import ExposureImage, FrameMean, merge_exposures
from lightopt.rig.capture._image_checks import PredictedImages, check_light, find_light_left_on

EIGHT = Sensor(bit_depth=8, saturation_level=250, black_level=4)


def mean_of_frames(frames, *, sensor, exposure) -> ExposureImage:
    mean = FrameMean(sensor)
    for levels in frames:
        mean.add(levels)
    return mean.image(exposure)


def image(levels, exposure, sensor=EIGHT):
    return mean_of_frames([np.asarray(levels, np.uint8)], sensor=sensor, exposure=exposure)


# --- frames


def test_one_frame_stays_as_delivered():
    frame = np.array([[0, 7], [249, 250]], np.uint8)
    found = mean_of_frames([frame], sensor=EIGHT, exposure=1.0)
    assert found.png is frame
    assert found.saturated.tolist() == [[False, False], [False, True]]


@given(st.lists(st.integers(0, 255), min_size=2, max_size=9))
def test_the_mean_is_rounded_half_to_even_and_saturates_with_any_frame(levels):
    frames = [np.array([[level]], np.uint8) for level in levels]
    found = mean_of_frames(frames, sensor=EIGHT, exposure=1.0)
    assert found.mean[0, 0] == pytest.approx(sum(levels) / len(levels), rel=1e-6)
    saturated = max(levels) >= 250
    assert found.saturated[0, 0] == saturated
    assert found.png[0, 0] == (max(levels) if saturated else round(Fraction(sum(levels), len(levels))))
    assert found.png.dtype == np.uint8


def test_the_sum_of_many_16_bit_frames_does_not_overflow():
    frames = [np.full((2, 2), 65535, np.uint16)] * 1000
    found = mean_of_frames(frames, sensor=Sensor(bit_depth=16), exposure=1.0)
    assert (found.mean == 65535).all()


# --- brackets


def plain_merge(stack, exposures, saturation, black, scale):
    """Pixel by pixel: the longest exposure that is not saturated."""
    level, valid, came_from = np.zeros((3, *stack[0].shape))
    for index in np.ndindex(stack[0].shape):
        for k, (values, exposure) in enumerate(zip(stack, exposures, strict=True)):
            good = values[index] < saturation
            if good or k == len(stack) - 1:
                level[index] = (values[index] - black[k][index]) * scale / exposure
                valid[index], came_from[index] = good, exposure
                break
    return level, valid, came_from


@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from([4.0, 1.0, 0.25, 1 / 16]), min_size=1, max_size=4, unique=True),
    st.booleans(),
)
def test_the_merge_is_that_of_the_plain_reference(seed, exposures, with_dark):
    rng = np.random.default_rng(seed)
    exposures = sorted(exposures, reverse=True)
    stack = [rng.integers(0, 256, (5, 6)).astype(np.uint8) for _ in exposures]
    dark = [rng.uniform(3, 6, (5, 6)).astype(np.float32) for _ in exposures] if with_dark else None
    merged = merge_exposures(
        [image(s, e) for s, e in zip(stack, exposures, strict=True)], sensor=EIGHT, full_scale=1000.0, dark=dark
    )
    black = dark or [np.full((5, 6), 4.0)] * len(stack)
    level, valid, came_from = plain_merge(stack, exposures, 250, black, 1000.0 / 255)
    assert merged["Y"] == pytest.approx(level, rel=1e-5, abs=1e-5)
    assert np.array_equal(merged["valid"], valid)
    assert np.array_equal(merged["exposure"], np.array(came_from, np.float32))
    assert {channel.dtype for channel in merged.values()} == {np.dtype(np.float32)}


# --- lit by its light


ROWS, COLUMNS = 24, 30
PART = np.zeros((ROWS, COLUMNS), bool)
PART[4:20, 5:25] = True
RAMP = np.where(PART, 5 + 95 * np.linspace(0, 1, COLUMNS) ** 3, 0.0)
SENSOR = Sensor(bit_depth=8)
TWO = PredictedImages(sensor=SENSOR, cell=2, levels={"left": RAMP[:, ::-1], "right": RAMP}, part=PART)


def seen(level, *, exposure=1.0, dark=3.0, noise=1.0, seed=0):
    full = np.kron(level, np.ones((2, 2))) * exposure + dark
    full = full + noise * np.random.default_rng(seed).standard_normal(full.shape)
    return np.clip(np.floor(full + 0.5), 0, 255).astype(np.float32)


def check(light, level, predictions=TWO, **options):
    dark = options.get("dark", 3.0)
    exposure = options.get("exposure", 1.0)
    return check_light(light, seen(level, **options), dark, predictions=predictions, exposure=exposure)


@pytest.mark.parametrize("gain", [0.3, 1.0, 2.2])
def test_a_light_that_is_right_is_right_at_any_gain(gain):
    found = check("right", gain * RAMP)
    assert found.problem is None
    assert found.undecided is None
    assert found.brightness == pytest.approx(gain, rel=0.03)
    assert found.resemblance > 0.95
    assert found.next_best is not None
    assert found.next_best[0] == "left"


def test_a_swapped_light_is_named():
    found = check("left", RAMP)
    assert found.problem is not None
    assert "left was lit, but the image looks like right" in found.problem


def test_a_dark_light_is_named():
    found = check("left", 0.0 * RAMP)
    assert found.problem is not None
    assert "left stays dark" in found.problem


def test_a_second_light_is_named():
    found = check("left", RAMP + RAMP[:, ::-1])
    assert found.problem is not None
    assert "right is on together with left" in found.problem


@pytest.mark.parametrize("seed", range(20))
def test_lights_that_look_alike_accuse_nobody(seed):
    flat = np.where(PART, 50.0, 0.0)
    alike = PredictedImages(sensor=SENSOR, cell=2, levels={"left": flat * 1.01, "right": flat}, part=PART)
    found = check("left", flat, alike, noise=3.0, seed=seed)
    assert found.problem is None
    assert found.undecided is not None


def test_another_part_is_reported_and_no_light_accused():
    rng = np.random.default_rng(5)
    found = check("left", np.where(PART, rng.uniform(0, 100, PART.shape), 0.0))
    assert found.problem is not None
    assert found.problem.startswith("the part does not look as predicted under any light")


def test_an_exposure_that_shows_nothing_is_not_judged():
    found = check("left", RAMP[:, ::-1], exposure=1e-4)
    assert found.undecided == "too dark at this exposure"


def test_saturation_is_predicted_too():
    assert (
        check(
            "right",
            10 * RAMP,
            PredictedImages(sensor=SENSOR, cell=2, levels={"left": 10 * RAMP[:, ::-1], "right": 10 * RAMP}, part=PART),
        ).problem
        is None
    )


def test_a_light_left_on_shows_in_the_dark_frame():
    frames = {"left": seen(RAMP[:, ::-1], dark=0.0), None: seen(0.0 * RAMP, dark=0.0)}
    for light, frame in frames.items():
        assert find_light_left_on(frame, predictions=TWO, exposure=1.0) == light
    ambient = seen(np.full(PART.shape, 30.0), dark=0.0)
    assert find_light_left_on(ambient, predictions=TWO, exposure=1.0) is None


def test_means_are_rounded_without_a_bias():
    sensor = Sensor(bit_depth=8)
    rng = np.random.default_rng(1)
    frames = [rng.integers(20, 61, (300, 300)).astype(np.uint8) for _ in range(4)]
    for count in (1, 2, 3, 4):
        image = mean_of_frames(frames[:count], sensor=sensor, exposure=1.0)
        assert np.abs(image.png - image.mean).max() <= 0.5
        assert float(np.mean(image.png - image.mean)) == pytest.approx(0.0, abs=0.005)
