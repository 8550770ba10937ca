"""The solver of every registration: it never makes a fit worse, runs away, or returns what is not a number.

Warnings are errors in tests: none of these problems may cause one in NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lightopt.core.least_squares import Limits, linear_problem, solve

TRUTH = np.array([0.4, -0.7, 0.2])
FREE = Limits(
    nominal=np.zeros(3),
    reach=np.full(3, 5.0),
    step=np.full(3, 1.0),
    prior=np.full(3, np.inf),
    resolution=np.full(3, 0.5),
)


@dataclass
class Recorded:
    """A problem given by functions, and where it was evaluated."""

    levels: object
    derivatives: object
    measured: np.ndarray
    weight: np.ndarray = field(default_factory=lambda: np.zeros(0))
    correlated: np.ndarray = field(default_factory=lambda: np.zeros(0, np.bool_))
    places: list = field(default_factory=list)

    def __post_init__(self):
        self.weight = np.ones(len(self.measured))
        self.correlated = np.zeros(len(self.measured), np.bool_)

    def residuals(self, x):
        self.places.append(x.copy())
        return self.measured - self.levels(x)

    def slopes(self, x):
        return self.derivatives(x)


def curved(rng, rows=400, outliers=0.0):
    """Levels that bend with the parameters, noise of 1, and a share of wild rows."""
    a = rng.normal(size=(rows, 3)) * 30.0
    bend = rng.normal(size=rows) * 5.0
    levels = lambda x: a @ x + bend * np.sin(x[0] + 2.0 * x[1])  # noqa: E731

    def derivatives(x):
        return a + (bend * np.cos(x[0] + 2.0 * x[1]))[:, None] * np.array([1.0, 2.0, 0.0])

    measured = levels(TRUTH) + rng.normal(size=rows)
    wild = rng.random(rows) < outliers
    measured[wild] += rng.normal(size=int(wild.sum())) * 1e3
    return Recorded(levels, derivatives, measured)


def sound(found, limits, problem=None):
    assert np.isfinite(found.x).all()
    assert np.isfinite(found.errors).all()
    assert np.all(found.errors > 0.0)
    assert np.isfinite(found.covariance).all()
    assert np.isfinite([found.cost_before, found.cost_after, found.spread]).all()
    assert found.cost_after <= found.cost_before
    assert np.all(np.abs(found.x - limits.nominal) <= limits.reach)
    for x in problem.places if problem is not None else ():
        assert np.all(np.abs(x - limits.nominal) <= limits.reach)


@pytest.mark.parametrize("loss", ["tukey", "huber"])
@pytest.mark.parametrize("outliers", [0.0, 0.2])
def test_parameters_are_found_among_outliers(loss, outliers):
    problem = curved(np.random.default_rng(1), outliers=outliers)
    found = solve(problem, np.zeros(3), FREE, loss=loss)
    sound(found, FREE, problem)
    assert found.converged
    assert len(found.undetermined) == 0
    assert found.x == pytest.approx(TRUTH, abs=0.01)
    assert found.cost_after < found.cost_before


def test_errors_are_those_of_the_scatter():
    z = []
    for seed in range(60):
        found = solve(curved(np.random.default_rng(seed)), np.zeros(3), FREE)
        z.append((found.x - TRUTH) / found.errors)
    assert np.all((np.std(z, axis=0) > 0.8) & (np.std(z, axis=0) < 1.25))


def test_what_nothing_determines_stays_nominal():
    """The sum of the first two parameters alone has an effect."""
    rng = np.random.default_rng(2)
    a = rng.normal(size=(300, 3)) * 20.0
    a[:, 1] = a[:, 0]
    nominal = np.array([0.3, 0.3, 0.0])
    limits = Limits(nominal=nominal, reach=FREE.reach, step=FREE.step, prior=FREE.prior, resolution=FREE.resolution)
    problem = linear_problem(a, a @ np.array([0.9, 0.1, -0.2]) + rng.normal(size=300))
    found = solve(problem, np.array([1.0, -1.0, 0.0]), limits)
    sound(found, limits)
    assert found.converged
    assert len(found.undetermined) == 1
    assert np.abs(found.undetermined[0]) == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0], abs=1e-2)
    assert found.x == pytest.approx([0.5, 0.5, -0.2], abs=0.02)
    assert found.errors[0] == pytest.approx(5.0)  # the greatest that is possible
    assert found.errors[2] < 0.01


@pytest.mark.parametrize("away", [0.0, 4.0])
def test_a_direction_is_let_go_once_the_misfit_of_the_start_is_gone(away):
    """Far from the optimum the residuals scatter so much that they seem to tell nothing about the third parameter."""
    rng = np.random.default_rng(5)
    truth = np.array([0.4, -0.7, 2.0])
    a = rng.normal(size=(400, 3)) * np.array([30.0, 30.0, 0.4])
    problem = linear_problem(a, a @ truth + rng.normal(size=400))
    found = solve(problem, np.array([away, -away, 0.0]), FREE)
    sound(found, FREE)
    assert found.converged
    assert len(found.undetermined) == 0
    assert found.errors[2] == pytest.approx(1.0 / (0.4 * np.sqrt(400)), rel=0.3)
    assert np.all(np.abs(found.x - truth) < 4.0 * found.errors)


def test_what_is_barely_determined_has_the_error_that_it_has():
    """Whether it is held at nominal or not: never one of nothing."""
    rng = np.random.default_rng(6)
    for reported in (0.5, 0.9, 1.1, 1.5, 1.9, 2.1):
        size = np.sqrt(reported / (400 * 0.5**2))
        a = rng.normal(size=(400, 3)) * np.array([30.0, 30.0, size])
        found = solve(linear_problem(a, rng.normal(size=400)), np.array([3.0, -3.0, 0.0]), FREE)
        sound(found, FREE)
        assert found.errors[2] == pytest.approx(0.5 / np.sqrt(reported), rel=0.4)


def test_what_scatters_too_much_in_the_end_stays_nominal():
    """Ten rows alone show the third parameter, and they scatter three times as much as all others."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        a = np.concatenate([rng.normal(size=(400, 3)) * [30.0, 30.0, 0.0], np.zeros((10, 3))])
        a[400:, 2] = 1.4
        noise = rng.normal(size=410)
        noise[400:] = 3.0 * rng.permutation(np.tile([-1.0, 1.0], 5))
        found = solve(linear_problem(a, a @ np.array([0.4, -0.7, 0.9]) + noise), np.zeros(3), FREE, loss="huber")
        sound(found, FREE)
        assert found.converged
        assert len(found.undetermined) == 1
        assert found.x[2] == pytest.approx(0.0, abs=1e-6)
        assert found.x[:2] == pytest.approx([0.4, -0.7], abs=0.02)
        assert 0.5 < found.errors[2] < 2.0


def test_what_is_said_to_be_undetermined_stays_nominal():
    """However steep the residuals are: here along (1, 0, 2)."""
    rng = np.random.default_rng(7)
    a = rng.normal(size=(300, 3)) * 20.0
    limits = replace(FREE, undetermined=np.array([[1.0, 0.0, 2.0]]))
    found = solve(linear_problem(a, a @ TRUTH + rng.normal(size=300)), TRUTH, limits)
    sound(found, limits)
    assert found.converged
    assert np.abs(found.undetermined[0]) == pytest.approx(np.array([1.0, 0.0, 2.0]) / np.sqrt(5.0), abs=1e-6)
    assert found.x[0] + 2.0 * found.x[2] == pytest.approx(0.0, abs=1e-6)
    assert found.errors == pytest.approx([2.5, found.errors[1], 5.0], rel=1e-3)
    assert found.errors[1] < 0.1


def test_an_optimum_out_of_reach_is_the_limit():
    limits = Limits(
        nominal=np.zeros(3), reach=np.full(3, 0.5), step=FREE.step, prior=FREE.prior, resolution=FREE.resolution
    )
    problem = curved(np.random.default_rng(3))
    found = solve(problem, np.zeros(3), limits, loss="huber")
    sound(found, limits, problem)
    assert found.x[1] == -0.5
    assert list(found.at_limit) == [False, True, False]


def test_steps_are_no_longer_than_allowed():
    limits = Limits(
        nominal=np.zeros(3), reach=FREE.reach, step=np.full(3, 0.05), prior=FREE.prior, resolution=FREE.resolution
    )
    problem = curved(np.random.default_rng(4))
    found = solve(problem, np.zeros(3), limits)
    assert found.x == pytest.approx(TRUTH, abs=0.01)
    for number, x in enumerate(problem.places[1:], 1):
        assert min(np.max(np.abs(x - before)) for before in problem.places[:number]) < 0.0501


def test_a_problem_without_a_row_says_nothing():
    for problem in (
        linear_problem(np.zeros((0, 3)), np.zeros(0)),
        linear_problem(np.full((50, 3), np.nan), np.full(50, np.nan)),
    ):
        found = solve(problem, np.array([1.0, 2.0, 3.0]), FREE)
        sound(found, FREE)
        assert not found.converged
        assert len(found.undetermined) == 3
        assert found.errors == pytest.approx(FREE.reach)


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    rows=st.integers(0, 60),
    scale=st.sampled_from([0.0, 1e-200, 1e-9, 1.0, 1e9, 1e200]),
    rank=st.integers(0, 3),
    wild=st.sampled_from([0.0, 0.3, 1.0]),
    what=st.sampled_from([np.nan, np.inf, -np.inf, 1e300]),
    everywhere=st.booleans(),
    loss=st.sampled_from(["tukey", "huber"]),
)
def test_no_problem_makes_it_fail(seed, rows, scale, rank, wild, what, everywhere, loss):
    """Singular, huge, tiny, without rows; not a number at the start, elsewhere, or in the slopes."""
    rng = np.random.default_rng(seed)
    a = scale * rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, 3)) if rank else np.zeros((rows, 3))
    measured = rng.normal(size=rows) * rng.choice([1.0, 1e6])
    spoilt = rng.random(rows) < wild

    def levels(x):
        found = a @ np.clip(x, -1e3, 1e3) + np.tanh(x[0])
        found[spoilt & (everywhere or abs(x[0]) > 0.1)] = what
        return found

    def derivatives(x):
        found = a.copy()
        found[:, 0] += 1.0 / np.cosh(x[0]) ** 2
        found[spoilt & (rng.random(rows) < 0.5)] = what
        return found

    problem = Recorded(levels, derivatives, measured)
    start = rng.normal(size=3) * rng.choice([1.0, 1e12])
    found = solve(problem, start, FREE, loss=loss)
    sound(found, FREE, problem)
    assert found.iterations <= 60
