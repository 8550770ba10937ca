"""The stages of a registration: how many there are, and when they have converged; each stage's solution is given."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from lightopt import build_scene
from lightopt.core.least_squares import Solution
from lightopt.estimate.registration import (
    Placement,
    PoseFrame,
    _refinement as refinement,
    _registration as registration,
)
from lightopt.estimate.registration._registration import refine_placement

NOWHERE = Placement(x=0.0, y=0.0, turn=0.0)


@pytest.fixture(scope="module")
def scene(shared_bench):
    return build_scene(shared_bench.rig, shared_bench.part)


@pytest.fixture
def staged(scene, monkeypatch):
    """Register by stages that find the part at given shifts in x [px], with given errors by inner pixels alone [px].

    Returns the registration, and of each stage whether it used the outline and where it began [px].
    """

    def run(shifts, errors=(0.01,) * 9):
        frame = PoseFrame.of(scene)
        taken = []

        def solve(problem, x, limits, **options):
            number = len(taken)
            taken.append((problem.outline, round(float(x[0]) / frame.pixel, 3)))
            found = x.copy()
            found[0] = shifts[number] * frame.pixel
            error = np.ones(len(x))
            error[:3] = (0.01 if problem.outline else errors[number]) * frame.pixel_steps
            return Solution(
                x=found, covariance=np.diag(error**2), errors=error, undetermined=np.zeros((0, len(x))),
                at_limit=np.zeros(len(x), np.bool_), converged=True, iterations=1, rows=9, spread=1.0,
                cost_before=1.0, cost_after=1.0,
            )  # fmt: skip

        monkeypatch.setattr(refinement, "choose_pixels", lambda *_, outline, **__: (outline, []))
        monkeypatch.setattr(refinement, "RefinementProblem", lambda *a, **_: SimpleNamespace(outline=a[2]))
        monkeypatch.setattr(registration, "solve", solve)
        return refine_placement(scene, (), NOWHERE, caster=None), taken

    return run


def test_a_part_that_keeps_its_place_needs_two_stages(staged):
    found, taken = staged([1.0, 1.1])
    assert taken == [(False, 0.0), (False, 1.0)]
    assert (found.converged, found.outline, found.warnings) == (True, False, ())


def test_a_part_that_still_moves_in_the_last_stage_has_not_converged(staged):
    found, taken = staged([1.0, 2.0, 3.0, 4.0])
    assert len(taken) == 4
    assert not found.converged
    (said,) = found.warnings
    assert "did not converge: its last stage moved the part by 1.0 px" in said


@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_an_outline_that_is_used_is_used_in_stages_that_settle(staged, number):
    """Whenever the inner pixels cease to be enough: the stages begin again where the search began."""
    moving = [float(one + 1) for one in range(number + 1)]
    found, taken = staged([*moving, 0.9, 1.0], errors=(*(0.01,) * number, 1.0))
    assert [outline for outline, _ in taken] == [*(False,) * (number + 1), True, True]
    assert taken[number + 1][1] == 0.0
    assert (found.converged, found.outline) == (True, True)
    assert found.pose_errors[0] == pytest.approx(0.01 * 0.44, rel=0.1)


def test_an_outline_that_never_settles_has_not_converged(staged):
    found, taken = staged([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], errors=(0.01, 0.01, 0.01, 1.0))
    assert len(taken) == 6
    assert (found.converged, found.outline) == (False, True)
