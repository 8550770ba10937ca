"""Frames without light: smoothed, freed of what clipping adds, but with their pattern."""

from __future__ import annotations

import numpy as np
import pytest

from lightopt.estimate.registration._observations import smoothed
from lightopt.optics import Sensor

SENSOR = Sensor(bit_depth=8, read_noise_levels=0.8, electrons_per_level=60.0)


def frame(signal, *, frames=1, black=0.0, seed=1):
    rng = np.random.default_rng(seed)
    noise = 0.8 * rng.standard_normal((frames, *np.shape(signal)))
    return np.clip(np.floor(signal + black + noise + 0.5), 0, 255).mean(axis=0)


@pytest.mark.parametrize("signal", [0.0, 0.25, 1.0, 4.0, 40.0])
@pytest.mark.parametrize("frames", [1, 4])
def test_what_is_clipped_at_zero_adds_nothing(signal, frames):
    even = np.full((120, 160), signal)
    dark = smoothed(frame(even, frames=frames), sensor=SENSOR, frames=frames)
    assert float(dark.mean()) == pytest.approx(signal, abs=0.03)
    assert float(dark.std()) < 0.2


def test_a_pattern_stays():
    signal = np.full((120, 160), 2.0)
    signal[40:80, 50:100] = 30.0
    signal[10, 10] = 90.0
    dark = smoothed(frame(signal), sensor=SENSOR, frames=1)
    assert np.abs(dark - signal)[40:80, 50:100].mean() < 0.6
    assert dark[10, 10] == pytest.approx(90.0, abs=4.0)
    assert dark[60, 49] == pytest.approx(2.0, abs=2.5)
