"""Photon transfer: a known sensor is found again, an independent program agrees, and bad frames are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.estimate.rig_calibration._photon_transfer import FramePair, gaussian_of_levels, photon_transfer
from lightopt.optics import Sensor, expose

EIGHT_BITS = Sensor(bit_depth=8, read_noise_levels=0.8, electrons_per_level=60.0)
SENSORS = {
    "8 bits, black at 0": EIGHT_BITS,
    "8 bits, black at 10": replace(EIGHT_BITS, black_level=10.0),
    "8 bits, noise below rounding": replace(EIGHT_BITS, black_level=5.3, read_noise_levels=0.3),
    "12 bits": Sensor(bit_depth=12, read_noise_levels=3.0, electrons_per_level=4.0, black_level=100.0),
}

EXPOSURES = tuple(np.linspace(0.075, 0.9, 12))


def flat(shape):
    rows, columns = np.indices(shape) / np.array(shape)[:, None, None] - 0.5
    return 255.0 * (1.0 - 0.1 * (rows**2 + columns**2))


def frames(sensor, rng, *, shape=(128, 160), exposures=EXPOSURES, level=None):
    def pair(levels, exposure):
        first, second = (expose(levels, sensor=sensor, exposure=exposure, full_scale=255.0, rng=rng) for _ in range(2))
        return FramePair(first=first, second=second, exposure=exposure)

    level = flat(shape) if level is None else level
    return [pair(level, exposure) for exposure in exposures], [pair(np.zeros(shape), 0.5)]


def statistics(sensor, seeds, **options):
    errors, inside = [], []
    for seed in range(seeds):
        found = photon_transfer(*frames(sensor, np.random.default_rng(seed), **options), bit_depth=sensor.bit_depth)
        values = (found.electrons_per_level, found.read_noise_levels, found.black_level)
        true = (sensor.electrons_per_level, sensor.read_noise_levels, sensor.black_level)
        errors.append([value.value - t for value, t in zip(values, true, strict=True)])
        inside.append(
            [value.interval_95[0] <= t <= value.interval_95[1] for value, t in zip(values, true, strict=True)]
        )
    return np.sqrt(np.mean(np.square(errors), axis=0)), np.array(inside)


@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS.keys())
def test_sensor_is_found(sensor):
    rms, inside = statistics(sensor, 4, shape=(300, 300))
    assert rms[0] < 0.01 * sensor.electrons_per_level
    assert rms[1:].max() < 0.02 * max(1.0, sensor.read_noise_levels)
    assert inside.mean() > 0.7


def test_a_target_that_does_not_fill_the_view():
    """Around it, noise is clipped at level 0, which few levels show at the shortest exposures."""
    shape = (300, 400)
    level = 0.65 * flat(shape)
    level[:, :40] = level[270:] = 0.0
    exposures = [1.0, 1 / 2, 1 / 3, 1 / 4, 1 / 6, 1 / 8, 1 / 12, 1 / 16, 1 / 24]
    rng = np.random.default_rng(5)
    found = photon_transfer(*frames(EIGHT_BITS, rng, shape=shape, exposures=exposures, level=level), bit_depth=8)
    assert found.electrons_per_level.value == pytest.approx(60.0, rel=0.015)
    low, high = found.electrons_per_level.interval_95
    assert low < 60.0 < high


@pytest.mark.nightly
@pytest.mark.parametrize("sensor", SENSORS.values(), ids=SENSORS.keys())
def test_intervals_cover_as_often_as_they_say(sensor):
    _, inside = statistics(sensor, 300)
    assert inside.mean(axis=0).min() > 0.92
    assert inside.mean(axis=0).max() < 0.98


def test_gain_is_the_inverse_and_curve_is_the_line():
    found = photon_transfer(*frames(SENSORS["12 bits"], np.random.default_rng(0)), bit_depth=12)
    assert np.allclose(found.variances[found.fitted], found.means[found.fitted] / 4.0 + 9.0, rtol=0.06)
    assert found.linearity_error < 0.05
    assert found.saturation_level is None


@pytest.mark.parametrize(("centre", "spread"), [(0.0, 0.8), (5.3, 0.3), (1.0, 2.5), (-0.4, 1.0), (100.0, 3.0)])
def test_gaussian_behind_rounded_and_clipped_levels(centre, spread):
    drawn = np.random.default_rng(0).normal(centre, spread, 2_000_000)
    levels = np.clip(np.floor(drawn + 0.5), 0, None)
    found = gaussian_of_levels(float(levels.mean()), float(levels.var()))
    assert found == pytest.approx((centre, spread), abs=0.01)


def test_saturation_level_and_bend_of_the_line_are_found():
    sensor = SENSORS["12 bits"]
    pairs, darks = frames(sensor, np.random.default_rng(1), exposures=(*np.linspace(0.05, 0.8, 12), 1.4))
    clipped = [
        replace(pair, first=np.minimum(pair.first, 3900), second=np.minimum(pair.second, 3900)) for pair in pairs
    ]
    found = photon_transfer(clipped, darks, bit_depth=12)
    assert found.saturation_level == 3900
    assert found.electrons_per_level.value == pytest.approx(4.0, rel=0.03)
    # a camera that loses 2 % of its range, quadratically
    bent = [replace(pair, exposure=pair.exposure * (1.0 + 0.05 * pair.exposure)) for pair in pairs[:-1]]
    assert photon_transfer(bent, darks, bit_depth=12).linearity_error > 0.3


def test_what_is_wrong_with_the_frames_is_said():
    rng = np.random.default_rng(2)
    pairs, darks = frames(EIGHT_BITS, rng)

    def refused(match, pairs=pairs, darks=darks, bit_depth=8):
        with pytest.raises(InputError, match=match):
            photon_transfer(pairs, darks, bit_depth=bit_depth)

    refused("no dark frames: cover the lens", darks=[])
    refused("5 levels, 6 are needed", pairs=pairs[:5])
    swapped = [*pairs[:3], replace(pairs[3], second=pairs[6].second), *pairs[4:]]
    refused(r"pair at exposure 0\.3: the frames differ by .* exposure or light changed", pairs=swapped)
    moved, _ = frames(EIGHT_BITS, rng, exposures=(0.3,), level=np.roll(flat((128, 160)), 40, axis=1))
    refused("has a pattern: something moved", pairs=[*pairs[:3], replace(pairs[3], second=moved[0].second), *pairs[4:]])
    bright, _ = frames(EIGHT_BITS, rng, exposures=np.linspace(0.8, 3.0, 12))
    refused("pairs are above dark and below 70% of saturation .* shorter exposures", pairs=bright)
    refused("expected whole levels from 0 to 127", bit_depth=7)
    refused(
        "expected whole levels",
        pairs=[replace(pairs[0], first=pairs[0].first / 2.0, second=pairs[0].second), *pairs[1:]],
    )
    refused("the same for all frames", pairs=[replace(pairs[0], first=pairs[0].first[:-1]), *pairs[1:]])
    _, black = frames(replace(EIGHT_BITS, read_noise_levels=0.1), rng)
    refused("raise the camera's black level", darks=black)
    smooth = [
        replace(p, first=np.full_like(p.first, p.first.mean()), second=np.full_like(p.first, p.first.mean()))
        for p in pairs
    ]
    refused("noise does not grow with the level", pairs=smooth)


@pytest.mark.parametrize(("bit_depth", "gain"), [(8, 0.1), (12, 0.5)])
def test_emva1288_finds_the_same_in_its_own_camera(bit_depth, gain, monkeypatch):
    """The package emva1288 (LGPL) with the camera that it simulates: conversion gain and dark noise within 2 %."""
    camera_module = pytest.importorskip("emva1288.camera.camera")
    results_module = pytest.importorskip("emva1288.process.results")
    monkeypatch.setattr(np, "asfarray", lambda a: np.asarray(a, np.float64), raising=False)  # it is of NumPy 1
    camera = camera_module.Camera(
        bit_depth=bit_depth, width=320, height=240, K=gain, K_min=gain, blackoffset=5, dark_signal_0=60.0,
        sigma2_dark_0=100.0, u_esat=1e9, seed=1,
    )  # fmt: skip
    full = np.asarray(camera.get_radiance_for())

    def pair(share):
        return FramePair(first=camera.grab(full * share), second=camera.grab(full * share), exposure=share)

    dark, pairs = pair(0.0), [pair(share) for share in np.arange(1, 26) / 22.0]

    def moments(one):
        a, b = one.first.astype(float), one.second.astype(float)
        return (a.mean() + b.mean()) / 2.0, np.mean((a - b) ** 2) / 2.0 - (a.mean() - b.mean()) ** 2 / 2.0

    (black, dark_variance), lit = moments(dark), np.array([moments(one) for one in pairs])
    ones = np.ones(len(pairs))
    temporal = {
        "u_p": 100.0 * np.arange(1, 26), "u_y": lit[:, 0], "s2_y": lit[:, 1], "texp": ones, "u_ydark": black * ones,
        "s2_ydark": dark_variance * ones,
    }  # fmt: skip
    theirs = results_module.Results1288({"temporal": temporal, "spatial": {}})
    ours = photon_transfer(pairs, [dark], bit_depth=bit_depth)
    assert 1.0 / ours.electrons_per_level.value == pytest.approx(theirs.K, rel=0.02)
    assert ours.read_noise_levels.value == pytest.approx(theirs.sigma_d * theirs.K, rel=0.02)
