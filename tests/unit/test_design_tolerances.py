"""How far a score falls: corners, draws and widest tolerances against trying everything one by one."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.design import Tolerances
from lightopt.design._tolerances import FEW_RUNGS, analyse_tolerances, joint_tolerances

NAMES = ("left", "right", "top")


def smooth(pose, lights):
    """A score that falls differently along every angle, with a coupling between lights and part."""
    value = 1e6 - 900.0 * abs(pose[0] - 0.2) - 400.0 * pose[1] ** 2
    for i, (elevation, azimuth) in enumerate(lights):
        value -= (300.0 + 200.0 * i) * abs(elevation + 0.3 * pose[0]) ** 1.5 + 50.0 * i * abs(azimuth)
        value -= 120.0 * max(0.0, elevation) * max(0.0, lights[0][1])
    return math.floor(value)


def assess(pose, lights):
    return np.array([smooth(pose, some) for some in product(*lights)], np.int64)


def test_worst_corner_is_that_of_trying_all():
    tolerances = Tolerances(light_deg=2.0, pose_deg=1.0, draws=20)
    trust = analyse_tolerances(assess, NAMES, tolerances)
    offsets = list(product((-2.0, 2.0), repeat=2))
    tried = {
        (pose, lights): smooth(pose, lights)
        for pose in product((-1.0, 1.0), repeat=2)
        for lights in product(offsets, repeat=3)
    }
    assert len(tried) == 4 * 4**3
    assert trust.worst == min(tried.values())
    assert tried[trust.worst_pose, trust.worst_lights] == trust.worst
    assert trust.score == smooth((0.0, 0.0), [(0.0, 0.0)] * 3)


def test_draws_are_seeded_and_within_the_tolerance():
    seen = []

    def watched(pose, lights):
        if all(len(some) == 1 for some in lights):
            seen.append((pose, tuple(some[0] for some in lights)))
        return assess(pose, lights)

    tolerances = Tolerances(light_deg=2.0, pose_deg=0.5, draws=40, seed=3)
    trust = analyse_tolerances(watched, NAMES, tolerances)
    draws = seen[1:41]  # after the exact one
    scores = sorted(smooth(pose, lights) for pose, lights in draws)
    assert trust.quantile == scores[1]  # 5 % of 40 are two
    assert trust.least_drawn == scores[0]
    poses = np.array([pose for pose, _ in draws])
    lights = np.array([lights for _, lights in draws])
    assert 0.4 < np.abs(poses).max() <= 0.5
    assert 1.9 < np.abs(lights).max() <= 2.0
    assert trust == analyse_tolerances(assess, NAMES, tolerances)
    other = analyse_tolerances(assess, NAMES, Tolerances(light_deg=2.0, pose_deg=0.5, draws=40, seed=4))
    assert other.least_drawn != trust.least_drawn


def test_widest_tolerances_are_those_of_a_fine_scan():
    trust = analyse_tolerances(assess, NAMES, Tolerances(draws=1, tolerance_target=0.995))
    least = 0.995 * trust.score
    exact = [(0.0, 0.0)] * 3
    for widest in trust.widest:
        for degrees in np.arange(0.01, 16.005, 0.01):
            either = [
                (s * degrees, 0.0) if widest.angle in ("elevation", "tilt") else (0.0, s * degrees) for s in (-1.0, 1.0)
            ]
            if widest.what == "part":
                scores = [smooth(pose, exact) for pose in either]
            elif widest.angle == "both angles at once":
                offsets = list(product((-degrees, degrees), repeat=2))
                scores = [smooth((0.0, 0.0), lights) for lights in product(offsets, repeat=3)]
            else:
                i = NAMES.index(widest.what)
                scores = [smooth((0.0, 0.0), [*exact[:i], o, *exact[i + 1 :]]) for o in either]
            if min(scores) < least:
                break
        else:
            assert widest.open_ended
            continue
        assert not widest.open_ended
        assert widest.degrees < degrees <= widest.degrees + 0.05 + 0.01
        assert widest.degrees == round(widest.degrees * 20) / 20
    assert {w.what for w in trust.widest} == {*NAMES, "all lights", "part"}
    assert any(w.open_ended for w in trust.widest)  # azimuth of the first light costs nothing


@pytest.mark.parametrize("bodies", [1, 3])
def test_joint_tolerances_are_those_of_a_fine_scan(bodies):
    exact = [(0.0, 0.0)] * bodies

    def scores(pose, lights):
        # the part's posture is best as it is
        return np.array([smooth((pose[0] + 0.2, pose[1]), some) for some in product(*lights)], np.int64)

    def of_lights(off):
        return scores((0.0, 0.0), [list(product((-off, off), repeat=2))] * bodies).min()

    def of_part(off):
        return min(scores(pose, [[one] for one in exact])[0] for pose in product((-off, off), repeat=2))

    found = joint_tolerances(scores, bodies, 0.995)
    for one, least in ((found.lights, of_lights), (found.part, of_part)):
        kept = 0.995 * least(0.0)
        assert not one.open_ended
        assert one.angle == "both angles at once"
        assert least(one.degrees) >= kept
        assert least(one.degrees + max(0.05, 0.05 * (one.degrees + 0.1)) + 1e-9) < kept
    assert joint_tolerances(scores, bodies, 1e-9).part.open_ended


def test_joint_tolerances_try_few_offsets():
    tried = []

    def step(pose, lights):
        tried.append(lights[0][0])
        return np.array([0 if max(map(abs, (*pose, *lights[0][0]))) > 1.3 else 100])

    found = joint_tolerances(step, 1, 0.95)
    assert (found.lights.degrees, found.lights.open_ended) == (found.part.degrees, False)
    assert 1.3 - 0.1 <= found.lights.degrees <= 1.3
    assert found.lights.degrees >= FEW_RUNGS[0]
    assert len(tried) <= 2 * 16 + 1


def test_too_many_lights_have_no_joint_tolerance():
    found = joint_tolerances(lambda _, lights: np.ones(math.prod(map(len, lights)), np.int64), 11, 0.95)
    assert found.lights is None
    assert found.part.open_ended


def test_nothing_off_is_nothing_lost():
    trust = analyse_tolerances(assess, NAMES, Tolerances(draws=3))
    assert trust.score == trust.worst == trust.quantile == trust.least_drawn


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"light_deg": -1.0}, "option 'light_deg': expected degrees from 0 to 16, found -1"),
        ({"pose_deg": 17.0}, "option 'pose_deg': expected degrees from 0 to 16, found 17"),
        ({"light_deg": math.nan}, "option 'light_deg': expected degrees from 0 to 16, found nan"),
        ({"tolerance_target": 1.0}, "option 'tolerance_target': expected a share"),
    ],
)
def test_bad_tolerances_are_refused(arguments, expected):
    with pytest.raises(InputError, match=expected):
        Tolerances(**arguments)


def test_more_lights_than_all_corners_can_be_tried_of_are_refused():
    requested = []

    def watched(pose, lights):
        requested.append(lights)
        return np.zeros(1, np.int64)

    with pytest.raises(InputError, match=r"at most 10 lights \(1,048,576 corners\), found 12"):
        analyse_tolerances(watched, [f"light{i}" for i in range(12)], Tolerances(light_deg=1.0))
    assert not requested
