"""Profiles, frames and marks of defects: slopes are those of the heights, sizes and depths what they say."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from lightopt.config._defects import DefectConfig
from lightopt.defects import (
    BUILT_IN_CATALOGUE,
    SHAPE_KINDS,
    DefectKind,
    DefectShape,
    PlacedDefect,
    depth_of_slope,
    mark_surface,
    radial_place,
    slope_of_depth,
    tangent_direction,
)
from lightopt.defects._shape import BLEND, BLISTER_TOP, height_gradient

X, Y, Z = np.eye(3)


def shape(kind="dent", size=(2.0, 2.0), slope=10.0, **factors):
    return DefectShape(kind=kind, length=size[0], width=size[1], slope=math.radians(slope), **factors)


def placed(some, *, position=(0, 0, 0), normal=Z, along=X):
    return PlacedDefect(name="one", shape=some, position=np.array(position, float), normal=normal, along=along)


def height(shape, x, y):
    """Height above the undisturbed surface [mm], negative for dents, pits and scratches; shape (k,)."""
    rho = np.minimum(radial_place(shape, x, y), 1.0)
    if shape.kind not in SHAPE_KINDS:
        return np.zeros_like(rho)
    if shape.kind in ("dent", "bump", "blister"):
        top = BLISTER_TOP if shape.kind == "blister" else 0.0
        share = 0.5 + 0.5 * np.cos(math.pi * np.maximum(rho - top, 0.0) / (1.0 - top))
    else:
        # integral of the trapezoid from ρ to the rim, over that from the centre
        fallen = np.minimum(rho, 1.0 - BLEND) - 0.5 * BLEND
        fallen = np.where(rho < BLEND, 0.5 * rho**2 / BLEND, fallen)
        fallen = fallen + np.where(rho > 1.0 - BLEND, 0.5 * (BLEND - (1.0 - rho) ** 2 / BLEND), 0.0)
        share = 1.0 - fallen / (1.0 - BLEND)
    sign = 1.0 if shape.kind in ("bump", "blister") else -1.0
    return sign * depth_of_slope(shape.kind, shape.width, shape.slope) * share


def grid(half=2.0, n=401):
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-half, half, n)] * 2))
    return x, y


@pytest.mark.parametrize("kind", SHAPE_KINDS)
@pytest.mark.parametrize("size", [(3.0, 1.0), (2.0, 1.9)])
def test_slopes_are_the_derivatives_of_the_height(kind, size):
    some, step = shape(kind, size), 1e-5
    x, y = np.random.default_rng(1).uniform(-1.6, 1.6, (2, 5000))
    along, across = height_gradient(some, x, y)
    dx = (height(some, x + step, y) - height(some, x - step, y)) / (2 * step)
    dy = (height(some, x, y + step) - height(some, x, y - step)) / (2 * step)
    # where the slope itself has a kink, central differences are off by half the step times the jump of its derivative
    np.testing.assert_allclose(along, dx, atol=2e-5)
    np.testing.assert_allclose(across, dy, atol=2e-5)


@pytest.mark.parametrize("kind", SHAPE_KINDS)
def test_the_steepest_slope_and_the_depth_are_those_stated(kind):
    some = shape(kind, (4.0, 1.5), 25.0)
    x, y = grid(2.2, 1201)
    steepest = np.hypot(*height_gradient(some, x, y)).max()
    assert math.degrees(math.atan(steepest)) == pytest.approx(25.0, abs=0.01)
    heights = height(some, x, y)
    sign = 1 if kind in ("bump", "blister") else -1
    assert sign * heights[np.argmax(np.abs(heights))] == pytest.approx(some.depth, rel=1e-6)
    assert slope_of_depth(kind, 1.5, depth_of_slope(kind, 1.5, 0.3)) == pytest.approx(0.3)


@pytest.mark.parametrize("kind", get_args(DefectKind))
def test_the_outline_has_the_area_stated_and_nothing_is_beyond_it(kind):
    some = shape(kind, (3.0, 1.2))
    x, y = grid()
    inside = radial_place(some, x, y) < 1
    assert inside.sum() * (4.0 / 400) ** 2 == pytest.approx(some.area, rel=2e-3)
    assert not height(some, x, y)[~inside].any()
    assert not np.any(np.hypot(*height_gradient(some, x, y))[~inside])
    assert np.abs(x[inside]).max() == pytest.approx(1.5, abs=0.02)
    assert np.abs(y[inside]).max() == pytest.approx(0.6, abs=0.02)


def test_a_blister_is_flat_on_top_and_a_scratch_the_same_all_along():
    top = np.linspace(-0.55, 0.55, 23)
    zero = np.zeros_like(top)
    assert np.ptp(height(shape("blister"), top, zero)) == 0
    assert not np.any(height_gradient(shape("blister"), top, zero))
    along = height_gradient(shape("scratch", (4.0, 0.2)), top * 3, np.full_like(top, 0.05))
    np.testing.assert_allclose(along, [zero, zero + math.tan(math.radians(10))], atol=1e-12)


def test_stains_and_hazes_leave_normals_to_the_last_bit():
    points = np.zeros((1, 3))
    normal = np.array([[0.1, 0.2, 0.97]]) / np.linalg.norm([0.1, 0.2, 0.97])
    stain = placed(shape("stain", slope=0, R_d_factor=0.5), normal=normal[0])
    haze = placed(shape("haze", slope=0, sigma_factor=3.0), normal=normal[0])
    marks = mark_surface((stain, haze), points, normal)
    assert np.array_equal(marks.normals, normal)
    assert (marks.R_d_factor[0], marks.sigma_factor[0], marks.label[0]) == (0.5, 3.0, 1)


@pytest.mark.parametrize("kind", ["dent", "bump", "scratch"])
def test_normals_on_a_sphere_are_those_of_the_displaced_surface(kind):
    """Normals of p + h·N by differences along two curves of the surface; off by the share the tangent plane is off."""
    radius, some = 20.0, shape(kind, (2.0, 0.9), 6.0)
    defect = placed(some, position=(0, 0, radius))

    def surface(a, b):
        n = np.stack([np.sin(a), np.sin(b) * np.cos(a), np.cos(a) * np.cos(b)], axis=1)
        offset = radius * n - defect.position
        return n, radius * n + height(some, offset @ defect.along, offset @ defect.across)[:, None] * n

    a, b = np.random.default_rng(0).uniform(-0.03, 0.03, (2, 4000))
    step = 1e-6
    du = surface(a + step, b)[1] - surface(a - step, b)[1]
    dv = surface(a, b + step)[1] - surface(a, b - step)[1]
    expected = np.cross(du, dv)
    expected *= np.sign(np.einsum("ij,ij->i", expected, surface(a, b)[0]))[:, None]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    n, _ = surface(a, b)
    marks = mark_surface((defect,), radius * n, n)
    assert len(marks.index) > 500
    off = np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", marks.normals, expected[marks.index]), -1, 1)))
    tilt = np.degrees(np.arccos(np.einsum("ij,ij->i", marks.normals, n[marks.index])))
    assert tilt.max() == pytest.approx(6.0, abs=0.05)
    assert off.max() < 0.01


def test_tilts_of_overlapping_defects_add_up_and_the_later_one_names_the_place():
    x, y = grid(1.0, 41)
    points = np.stack([x, y, 0 * x], axis=1)
    normals = np.broadcast_to(Z, points.shape)
    dent, bump = placed(shape("dent")), placed(shape("bump"))
    marks = mark_surface((dent, bump), points, normals)
    np.testing.assert_allclose(marks.normals, normals[marks.index], atol=1e-15)
    assert set(marks.label) == {1}


def test_only_the_side_that_it_lies_on_is_marked():
    """A thin wall's back, a step in the depth, and a wall that stands up have other surfaces than the defect's."""
    x, y = grid(0.5, 11)
    flat = np.stack([x, y, 0 * x], axis=1)
    defect = (placed(shape()),)
    up = np.broadcast_to(Z, flat.shape)
    assert len(mark_surface(defect, flat, up).index) == len(flat)
    assert mark_surface(defect, flat - 0.1 * Z, -up) is None
    below = mark_surface(defect, flat - 0.5 * Z, up)
    assert below is None
    upright = np.broadcast_to(X, flat.shape)
    assert mark_surface(defect, flat, upright) is None
    assert mark_surface(defect, flat + 10 * X, up) is None
    assert mark_surface((), flat, up) is None
    assert mark_surface(defect, flat[:0], up[:0]) is None


@pytest.mark.parametrize(
    ("normal", "angle", "expected"),
    [(Z, 0, X), (Z, 90, Y), (-Z, 90, -Y), (X, 0, Y), (X, 90, Z), (Y, 0, X), (Y, 90, -Z)],
)
def test_directions_count_from_x_or_from_y_counterclockwise_from_outside(normal, angle, expected):
    along = tangent_direction(normal, math.radians(angle), x_axis=X, y_axis=Y)
    np.testing.assert_allclose(along, expected, atol=1e-12)


def test_the_built_in_catalogue_has_every_kind_and_is_what_files_may_say():
    assert [entry.shape.kind for entry in BUILT_IN_CATALOGUE] == list(get_args(DefectKind))
    for entry in BUILT_IN_CATALOGUE:
        s = entry.shape
        data = {"name": entry.name, "kind": s.kind, "size_mm": [s.length, s.width], "at_mm": [0, 0, 0]}
        if s.kind in SHAPE_KINDS:
            data["slope_deg"] = math.degrees(s.slope)
        if s.kind == "stain":
            data["R_d_factor"] = s.R_d_factor
        if s.kind == "haze":
            data["sigma_factor"] = s.sigma_factor
        read = DefectConfig.model_validate(data).shape
        assert replace(read, slope=0.0) == replace(s, slope=0.0)
        assert read.slope == pytest.approx(s.slope, rel=1e-12)
