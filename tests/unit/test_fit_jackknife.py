"""Scatter between groups of images: that of a mean in closed form, and what groups cannot tell."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import stdtrit

from lightopt.estimate.reflectance._fit_samples import UNDETERMINED, leave_groups_out, upper_covariance
from lightopt.estimate.reflectance._likelihood import Evaluation
from lightopt.estimate.reflectance._vector import FIRST_GAIN, R_D

POSTURE = "one"


class Means:
    """Least squares of levels by R_d plus an offset of each light but the first, which stands for its gain."""

    sigma_range = -6.0, 0.0

    def __init__(self, level, light, block):
        self.level, self.light, self.block = level, light, block
        self.size = FIRST_GAIN + int(light.max()) + 1 + 2
        numbers = np.arange(len(level))
        self.samples = SimpleNamespace(
            facts=SimpleNamespace(light=light),
            image=numbers,
            images=[SimpleNamespace(posture=POSTURE)] * len(level),
            sample=numbers,
            block=block,
        )

    def without(self, left_out):
        kept = Means(self.level[~left_out], self.light[~left_out], self.block[~left_out])
        kept.size = self.size
        return kept

    def evaluate(self, x):
        residual = self.level - x[R_D] - x[FIRST_GAIN + self.light]
        gradient, curvature = np.zeros(self.size), np.zeros((self.size, self.size))
        gradient[R_D] = residual.sum()
        curvature[R_D, R_D] = len(residual)
        np.add.at(gradient, FIRST_GAIN + self.light, residual)
        for light in self.light:
            place = FIRST_GAIN + light
            curvature[place, place] += 1.0
            curvature[R_D, place] += 1.0
            curvature[place, R_D] += 1.0
        return Evaluation(-0.5 * float(residual @ residual), gradient, curvature)


def start(criterion, r_d):
    x = np.zeros(criterion.size)
    x[R_D] = r_d
    x[2] = -3.0
    return x


@pytest.mark.parametrize("lights", [4, 7, 24])
def test_the_scatter_of_a_mean_is_that_of_the_means_of_the_lights(lights):
    """What all pixels of a light have in common makes the error, however many they are."""
    rng = np.random.default_rng(lights)
    light = np.repeat(np.arange(lights), 50)
    means = 40.0 + rng.normal(size=lights) * 3.0
    level = means[light] + rng.normal(size=len(light)) * 0.1
    criterion = Means(level, light, np.tile(np.arange(50), lights))
    found = leave_groups_out(criterion, start(criterion, level.mean()), [R_D])
    of_lights = np.array([level[light == number].mean() for number in range(lights)])
    assert found.of == f"{lights} lights"
    assert found.covariance[0, 0] == pytest.approx(np.var(of_lights, ddof=1) / lights, rel=0.01)
    assert found.quantile == pytest.approx(float(stdtrit(lights - 1, 0.975)))
    assert [refit.converged for refit in found.refits] == [True] * lights


def test_many_lights_share_groups_and_it_is_said():
    light = np.repeat(np.arange(60), 5)
    criterion = Means(np.random.default_rng(1).normal(size=300) + 40.0, light, np.zeros(300, np.intp))
    assert leave_groups_out(criterion, start(criterion, 40.0), [R_D]).of == "20 groups of lights"


def test_gains_have_the_scatter_between_pieces_of_the_images():
    """Between lights they have none: a light that is left out leaves its gain as it was."""
    rng = np.random.default_rng(2)
    light, block = np.repeat(np.arange(5), 200), np.tile(np.repeat(np.arange(20), 10), 5)
    piece = rng.normal(size=(5, 20)) * 2.0
    level = 40.0 + 3.0 * (light == 1) + piece[light, block] + rng.normal(size=1000) * 0.01
    criterion = Means(level, light, block)
    x = start(criterion, level[light == 0].mean())
    for number in range(1, 5):
        x[FIRST_GAIN + number] = level[light == number].mean() - x[R_D]
    free = [R_D, *(FIRST_GAIN + number for number in range(1, 5))]
    found = leave_groups_out(criterion, x, free)
    spread = np.sqrt(np.diag(found.covariance))
    assert spread[0] == pytest.approx(np.sqrt(np.var(piece[0], ddof=1) / 20), rel=0.1)
    for number in range(1, 5):
        expected = np.sqrt(np.var(piece[number] - piece[0], ddof=1) / 20)
        assert spread[number] == pytest.approx(expected, rel=0.1)


def test_one_group_tells_nothing():
    criterion = Means(np.arange(9.0), np.zeros(9, np.intp), np.zeros(9, np.intp))
    found = leave_groups_out(criterion, start(criterion, 4.0), [R_D])
    assert found.of == "1 pieces of the images"
    assert np.sqrt(found.covariance[0, 0]) == UNDETERMINED
    assert np.isfinite(found.quantile)


def test_a_covariance_at_least_as_large_keeps_no_correlation_that_only_one_has():
    """Lights move two parameters along a ridge, pieces one of them by itself."""
    ridge = np.array([[1.0, -0.5], [-0.5, 0.25]]) * 1e-4
    alone = np.diag([9e-4, 0.0])
    both = upper_covariance(ridge, alone)
    for one in (ridge, alone):
        assert np.linalg.eigvalsh(both - one).min() > -1e-15
    assert both[0, 1] / np.sqrt(both[0, 0] * both[1, 1]) > -0.5
    assert np.sqrt(np.diag(both)) == pytest.approx([3e-2, 5e-3], rel=0.1)
    # nothing is added where the other is smaller in every direction
    assert upper_covariance(ridge + 1e-6 * np.eye(2), ridge) == pytest.approx(ridge + 1e-6 * np.eye(2), rel=1e-9)
