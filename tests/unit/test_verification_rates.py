"""Rates of verification over seeds; ``python -m benchmarks.verifying`` has those of the sample rig at full size."""

from __future__ import annotations

import math

import numpy as np
import pytest
from verified import images_of, observed, parameters_of, rig_with, small_scene

from lightopt.estimate.verification._verify import verify_observations

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def scene(shared_bench):
    return small_scene(shared_bench, points=4)


def bodies(result):
    return {(f.kind.partition("_")[0], f.light) for f in result.findings if f.exceeds}


def test_unchanged_sets_raise_no_alarm(scene):
    images = images_of(scene, np.zeros(parameters_of(scene).size))
    results = [verify_observations(scene, observed(scene, images, seed=seed)) for seed in range(100)]
    assert sum(result.within_tolerances for result in results) >= 95


def test_faults_of_random_direction_are_named(scene):
    rng = np.random.default_rng(7)
    right = total = 0
    for seed in range(20):
        angle, sign = rng.uniform(0.0, 2.0 * math.pi), rng.choice([-1.0, 1.0])
        aside = np.array([math.cos(angle), math.sin(angle), 0.0])
        light = ("light1", "light3")[seed % 2]
        for name, values in {
            f"gain {light}": [math.log1p(0.05 * sign)],
            "exposure": [math.log1p(0.03 * sign)],
            "part_shift": 0.1 * aside,
            f"panel_shift {light}": 3.0 * aside,
        }.items():
            images = images_of(scene, rig_with(scene, **{name: values}))
            kind, _, of = name.partition(" ")
            expected = {(kind.partition("_")[0], of)}
            right += bodies(verify_observations(scene, observed(scene, images, seed=seed))) == expected
            total += 1
    assert right >= 0.95 * total
