"""Images laid over a prediction: what is saturated is a lower bound, with ambient light subtracted too."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lightopt import build_scene, load_part, load_rig
from lightopt.align import Observation
from lightopt.inspection import InspectOptions, deviations, posture_view, predict
from lightopt.inspection._inspect import _words
from lightopt.rendering import cast_rays_at
from lightopt.transforms import Posture

FLAT = Posture(0.0, 0.0)


@pytest.fixture(scope="module")
def good(shared_bench):
    """A scene, and its part under one light without noise."""
    scene = build_scene(shared_bench.rig, shared_bench.part, postures=(FLAT,), lights=("light1",))
    return scene, predict(scene, FLAT, cast_rays_at(scene), lights=("light1",))


def taken(good, ambient, *, told=True):
    """Deviations of an image over so many levels of ambient light, subtracted afterwards, and which are saturated."""
    scene, prediction = good
    sensor = scene.sensor
    scale = sensor.max_level / scene.reflectance.full_scale
    signal = prediction.images.lights[0].level * scale + sensor.black_level
    delivered = np.minimum(np.floor(signal + ambient + 0.5), sensor.max_level)
    saturated = delivered >= sensor.saturated_from
    image = Observation(
        light="light1",
        posture=FLAT,
        exposure=1.0,
        levels=(delivered - ambient).astype(np.float32),
        saturated=saturated,
        half_width=0.5,
        source=Path("made-by-test.png"),
        subtracted=np.full(saturated.shape, ambient, np.float32) if told else 0.0,
    )
    return deviations(posture_view(scene, [image], prediction, where="test")), saturated & prediction.clean


@pytest.mark.parametrize("ambient", [0.0, 20.0])
def test_a_good_part_is_not_darker_in_a_highlight_or_around_it(good, ambient):
    found, full = taken(good, ambient)
    assert full.sum() > 20
    assert np.abs(found.z).max() < 1.5  # quantisation only


def test_a_lower_bound_is_never_darker_even_where_what_was_subtracted_is_not_known(good):
    found, full = taken(good, 20.0, told=False)
    assert found.z[0][full].min() >= 0.0


@pytest.mark.parametrize(
    ("noise", "told"),
    [
        ("read_noise_levels: 0.8, electrons_per_level: 60", False),
        ("read_noise_levels: 0.8", False),
        ("electrons_per_level: 60", False),
        ("read_noise_levels: 0", True),
    ],
)
def test_a_sensor_without_noise_is_warned_of(bench, noise, told):
    bench.edit("rig.yaml", "read_noise_levels: 0.8, electrons_per_level: 60", noise)
    words = _words(load_rig(bench.rig), load_part(bench.part), [], InspectOptions())
    assert any("read_noise_levels" in word for word in words) == told
