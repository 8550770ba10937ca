"""Point lights against the lobe: the numbers of the estimate, its limits, and the advice."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lightopt.lights import PanelLight, panel_grid, place_light
from lightopt.optics import Reflectance, SpecularModel
from lightopt.scene import coarse_points, point_spacing


def of_width(sigma):
    return Reflectance(R_d=45.0, R_s=1e4, sigma=sigma)


def panel(points, *, size=(60.0, 60.0), distance=330.0, normalisation="mean") -> PanelLight:
    return place_light(
        name="light1",
        distance=distance,
        elevation=math.radians(60),
        azimuth=0.3,
        size=size,
        points=points,
        normalisation=normalisation,
    )


def saturated_area(light: PanelLight, points: int, lobe: float, threshold: float) -> float:
    """Brute force on a picture of the panel's plane: level of every pixel from every point."""
    half = 0.5 * max(light.size) + 6.0 * lobe
    x = np.linspace(-half, half, 241)
    across, along = np.meshgrid(x, x)
    level = np.zeros_like(across)
    for p in panel_grid(light, points):
        s, t = (p - light.centre) @ light.across, (p - light.centre) @ light.along
        level += np.exp(-((across - s) ** 2 + (along - t) ** 2) / (2 * lobe**2)) / points
    return float(np.count_nonzero(level >= threshold)) * (x[1] - x[0]) ** 2


@pytest.mark.parametrize(
    ("sigma", "points", "share"),
    # measured on rendered spheres against the converged panel
    [(0.0475, 4, 0.94), (0.01, 4, 0.68), (0.0025, 4, 0.10), (0.0025, 144, 0.94)],
)
def test_saturated_area_of_a_sphere_is_estimated(sigma, points, share):
    assert point_spacing(panel(points), sigma).area_error + 1 == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize(("sigma", "points", "size"), [(0.03, 4, (60, 60)), (0.02, 9, (60, 40)), (0.05, 1, (30, 60))])
def test_estimate_against_brute_force(sigma, points, size):
    light = panel(points, size=size)
    found = point_spacing(light, sigma)
    many = 40 * 40
    peak = 0.0
    for p in panel_grid(light, many):
        peak += math.exp(-float(np.sum((p - light.centre) ** 2)) / (2 * found.lobe**2)) / many
    grid, whole = (saturated_area(light, m, found.lobe, 0.02 * peak) for m in (points, many))
    assert found.area_error == pytest.approx(grid / whole - 1, abs=0.01)


@given(sigma=st.floats(0.002, 0.2), side=st.floats(5, 200), aspect=st.floats(0.1, 1), distance=st.floats(100, 1000))
def test_the_number_that_is_called_enough_is_enough(sigma, side, aspect, distance):
    light = panel(1, size=(side, aspect * side), distance=distance)
    enough = point_spacing(light, sigma).enough
    assert math.isqrt(enough) ** 2 == enough
    assert abs(point_spacing(replace(light, points=enough), sigma).area_error) < 0.02


def test_known_numbers():
    found = point_spacing(panel(4), 0.0025)
    assert (found.points, found.spacing, found.enough) == (4, 30.0, 5329)
    assert found.lobe == pytest.approx(1.65)
    assert found.separate


@pytest.mark.parametrize(("points", "sigma"), [("auto", 0.003), (4, 0.0475), (16, 0.0475), (144, 0.01), (1, 0.2)])
def test_enough_points_are_not_warned_of(points, sigma):
    assert coarse_points(panel(points), of_width(sigma)) is None


def test_without_a_lobe_no_points_are_too_few():
    assert coarse_points(panel(4), replace(of_width(0.01), R_d=80.0, R_s=0.0)) is None


def test_auto_has_no_spacing():
    assert point_spacing(panel("auto"), 0.003) is None


def test_warning_says_what_is_wrong_and_what_to_do():
    text = coarse_points(panel(4), of_width(0.01))
    for part in (
        "light1",
        "4 points",
        "30 mm",
        "σ = 0.01",
        "6.6 mm",
        "separate spots",
        "levels and areas are not the panel's",
        "points: auto",
        "361",
    ):
        assert part in text


def test_the_width_is_named_as_in_the_part_file():
    text = coarse_points(panel(4), replace(of_width(0.01), model=SpecularModel(name="ggx")))
    assert "α = 0.02" in text


def test_one_point_is_one_spot():
    text = coarse_points(panel(1), of_width(0.01))
    assert "1 point stands for 60 mm" in text
    assert "separate" not in text


def test_advice_is_possible():
    # a rig file may not ask for so many points, nor for auto with sum
    text = coarse_points(panel(4, normalisation="sum"), of_width(1e-4))
    assert "separate spots" in text
    assert "points: auto with normalisation: mean" in text
    assert "or points:" not in text
