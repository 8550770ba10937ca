"""Brightness of lights and of black, as images have them: not what another lobe would make of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightopt import build_scene
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation
from lightopt.inspection.prediction._posture_view import fit_photometry

CLEAN = np.ones((80, 120), np.bool_)


def highlight(width):
    """A round one on a part that is all but black [grey level]."""
    y, x = np.mgrid[-40:40, -60:60]
    return (0.4 + 900.0 * np.exp(-(x**2 + y**2) / (2.0 * width**2))).astype(np.float32)


def fitted(bench, light, predicted, *, gain=1.0, dark=0.0):
    scene = build_scene(bench.rig, bench.part)
    levels = np.floor(np.clip(gain * light + dark, 0.0, 255.0) + 0.5)
    image = Observation(
        light=scene.lights[0].name, posture=Posture(0.0, 0.0), exposure=1.0, levels=levels.astype(np.float32),
        saturated=levels >= 255, half_width=0.5, source=Path("made-by-test.png"),
    )  # fmt: skip
    found = fit_photometry([image], [predicted], CLEAN, scene)
    return found.gains[scene.lights[0].name], found.dark


def test_a_wider_lobe_than_the_models_is_no_dark_level(bench):
    """Around the model's highlight the images are lighter; where it predicts nothing they are black."""
    _, dark = fitted(bench, highlight(9.0), highlight(7.0))
    assert dark < 4.0  # four times the noise of black


@pytest.mark.parametrize(("gain", "level"), [(0.95, 255.0), (0.97, 255.0), (1.05, 0.0)])
def test_a_defect_tells_nothing_of_the_lights(bench, gain, level):
    """A twentieth of the part is as bright or as dark as can be: lamps that have aged are still told."""
    y, x = np.mgrid[-40:40, -60:60]
    predicted = (90.0 + x / 2.0 + 20.0 * np.sin(y / 9.0)).astype(np.float32)
    light = gain * predicted
    light[10:32, 10:32] = level
    assert fitted(bench, light, predicted)[0] == pytest.approx(gain, abs=0.01)


@pytest.mark.parametrize(("gain", "dark"), [(0.8, 0.0), (1.2, 2.0), (1.0, 3.0)])
def test_gain_and_dark_of_the_models_own_lobe_are_found(bench, gain, dark):
    light = highlight(9.0) + 30.0
    assert fitted(bench, light, light, gain=gain, dark=dark) == pytest.approx((gain, dark), abs=0.5)


def test_haze_on_a_tenth_of_a_dark_part_is_neither_light_nor_black(bench):
    """Its halo is within the noise of single pixels; a quarter of a level over all others would be a stain."""
    y, x = np.mgrid[-40:40, -60:60]
    predicted = (25.0 + x / 4.0).astype(np.float32)
    haze = 60.0 * np.exp(-((x - 30.0) ** 2 + (y + 10.0) ** 2) / (2.0 * 5.0**2))
    noise = np.random.default_rng(3).normal(scale=0.8, size=predicted.shape)
    gain, dark = fitted(bench, predicted + haze + noise, predicted)
    assert (gain, dark) == (pytest.approx(1.0, abs=6e-3), pytest.approx(0.0, abs=0.1))  # with Huber's weights 0.014
