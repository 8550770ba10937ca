"""The pinhole, its lens, the framing of a part, and the part's view of its surroundings."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from lightopt.core.transforms import Posture
from lightopt.geometry import TriangleMesh, points_inside, transformed
from lightopt.lights import panel_grid, place_light
from lightopt.optics import Reflectance, Sensor
from lightopt.scene import (
    Scene,
    Stage,
    frame_part,
    pixel_directions,
    pixel_footprint,
    place_camera,
    project,
    screen_window,
    view_from_part,
)
from lightopt.scene._camera import Distortion

LENS = Distortion(k1=-0.2, k2=0.05, p1=0.001, p2=-0.002, k3=0.01)


def camera_at(**changes):
    settings_ = {
        "distance": 550.0,
        "elevation": math.radians(90.0),
        "azimuth": math.radians(270.0),
        "roll": 0.0,
        "width": 160,
        "height": 120,
        "pixel_size": 0.044,
        "image_distance": 55.0,
    }
    return place_camera(**{**settings_, **changes})


def box(sides=(30.0, 20.0, 10.0), at=(0.0, 0.0, 5.0)) -> TriangleMesh:
    mesh = trimesh.creation.box(sides, trimesh.transformations.translation_matrix(at))
    return TriangleMesh(np.asarray(mesh.vertices), np.asarray(mesh.faces))


@given(
    elevation=st.floats(1.0, 179.0),
    azimuth=st.floats(-360.0, 360.0),
    roll=st.floats(-180.0, 180.0),
    column=st.floats(0.0, 160.0),
    row=st.floats(0.0, 120.0),
    distance=st.floats(10.0, 2000.0),
    lens=st.sampled_from([Distortion(), LENS]),
)
def test_a_point_on_a_pixels_ray_projects_to_the_pixel(elevation, azimuth, roll, column, row, distance, lens):
    camera = camera_at(
        elevation=math.radians(elevation),
        azimuth=math.radians(azimuth),
        roll=math.radians(roll),
        image_distance=9.0,  # a wide angle, where the lens matters
        distortion=lens,
    )
    ray = pixel_directions(camera, np.array([column]), np.array([row]))
    columns, rows, depth = project(camera, camera.position + distance * ray)
    assert columns[0] == pytest.approx(column, abs=1e-7)
    assert rows[0] == pytest.approx(row, abs=1e-7)
    assert depth[0] == pytest.approx(distance, rel=1e-12)  # the rays have unit depth
    frame = np.stack([camera.right, camera.up, -camera.forward])
    assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


def test_the_lens_bends_outwards_as_opencv_has_it():
    """x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²), y down, at one point by hand."""
    camera = camera_at(image_distance=9.0, distortion=LENS)
    x, y = 0.3, 0.2  # right and down, in image distances
    point = camera.position + camera.forward + x * camera.right - y * camera.up
    r2 = 0.13
    radial = 1 - 0.2 * r2 + 0.05 * r2**2 + 0.01 * r2**3
    u = x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x)
    v = y * radial + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y
    columns, rows, _ = project(camera, point[None, :])
    assert columns[0] == pytest.approx(80 + u * 9.0 / 0.044, rel=1e-12)
    assert rows[0] == pytest.approx(60 + v * 9.0 / 0.044, rel=1e-12)


BARREL = Distortion(k1=-0.4)
"""Turns back at r² = 1 / 1.2, where r is 0.913 and its image 0.609."""


def at_radius(camera, radius: float, angle: float = 0.3) -> np.ndarray:
    """A point seen at this radius, in image distances."""
    x, y = radius * math.cos(angle), radius * math.sin(angle)
    return (camera.position + 300 * (camera.forward + x * camera.right - y * camera.up))[None, :]


@pytest.mark.parametrize("lens", [BARREL, Distortion(k1=0.1, k2=-0.5), Distortion(k1=-0.4, p1=0.002, p2=-0.001)])
def test_points_beyond_the_fold_of_the_lens_model_stay_out_of_the_image(lens):
    camera = camera_at(image_distance=9.0, distortion=lens)  # the corners are at a radius of 0.49
    seen = False
    for radius in np.arange(0.01, 3.0, 0.01):
        columns, rows, _ = project(camera, at_radius(camera, radius))
        if 0 <= columns[0] <= 160 and 0 <= rows[0] <= 120:
            seen = True
            back = pixel_directions(camera, columns, rows)[0]
            assert np.allclose(back, (at_radius(camera, radius)[0] - camera.position) / 300, atol=1e-9), radius
        assert np.isfinite([columns[0], rows[0]]).all()
    assert seen


def test_a_part_beyond_the_fold_is_outside_the_view():
    camera = camera_at(image_distance=9.0, distortion=BARREL)
    # at a radius of 1.58 = √2.5 the model comes back to the image's centre
    assert frame_part(camera, box(sides=(2, 2, 2), at=(550 * math.sqrt(2.5), 0.0, 0.0))).outside


def test_a_lens_that_folds_inside_the_frame_has_pixels_that_look_nowhere():
    camera = camera_at(image_distance=5.0, distortion=BARREL)  # the corners are at 0.88, beyond 0.609
    rays = pixel_directions(camera, np.array([80.0, 0.0]), np.array([60.0, 0.0]))
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1]).all()


def test_points_behind_the_camera_have_no_image():
    for lens in (Distortion(), BARREL):
        behind = np.array([[0.0, 0.0, 600.0], [9.0, 0.0, 551.0]])
        columns, rows, depth = project(camera_at(distortion=lens), behind)
        assert np.isnan(columns).all()
        assert np.isnan(rows).all()
        assert (depth <= 0).all()


def test_footprint_is_by_similar_triangles():
    assert pixel_footprint(camera_at(), 550.0) == pytest.approx(0.44)
    assert pixel_footprint(camera_at(), 275.0) == pytest.approx(0.22)


# --- framing


def test_framing_of_a_box_in_view():
    framing = frame_part(camera_at(), box())
    # the top, 540 mm from the camera, is seen larger than the bottom
    scale = 55.0 / 0.044 / 540.0
    assert framing.margins["left"] == pytest.approx(80 - 15 * scale)
    assert framing.margins["bottom"] == pytest.approx(60 - 10 * scale)
    assert (framing.nearest, framing.farthest) == pytest.approx((540.0, 550.0))
    assert framing.footprint == pytest.approx((0.432, 0.44))
    assert framing.inside
    assert not framing.outside
    assert framing.size == pytest.approx((30 * scale, 20 * scale))


@pytest.mark.parametrize(
    ("shift", "side"), [((-25, 0), "left"), ((25, 0), "right"), ((0, 25), "top"), ((0, -25), "bottom")]
)
def test_framing_says_by_how_much_and_where(shift, side):
    framing = frame_part(camera_at(), box(at=(*shift, 5.0)))
    assert not framing.inside
    assert not framing.outside
    assert {name for name, margin in framing.margins.items() if margin < 0} == {side}
    scale = 55.0 / 0.044 / 540.0
    reach = (40.0 * scale - 80) if side in ("left", "right") else (35.0 * scale - 60)
    assert framing.margins[side] == pytest.approx(-reach)


def test_framing_of_a_box_out_of_view_or_around_the_camera():
    assert frame_part(camera_at(), box(at=(60, 0, 5.0))).outside
    assert frame_part(camera_at(), box(at=(0, 0, 700.0))).outside
    around = frame_part(camera_at(), box(sides=(2000, 2000, 2000)))
    assert not around.inside
    assert not around.outside


@given(
    elevation=st.floats(20.0, 160.0),
    azimuth=st.floats(0.0, 360.0),
    roll=st.floats(-180.0, 180.0),
    x=st.floats(-40, 40),
    y=st.floats(-40, 40),
)
def test_the_screen_window_holds_all_of_the_part(elevation, azimuth, roll, x, y):
    camera = camera_at(elevation=math.radians(elevation), azimuth=math.radians(azimuth), roll=math.radians(roll))
    mesh = box(at=(x, y, 5.0))
    left, top, right, bottom = screen_window(camera, mesh)
    assert 0 <= left <= right
    assert 0 <= top <= bottom
    if left < right and top < bottom:  # not empty, as it is for a part beside the image
        assert right <= 160
        assert bottom <= 120
    columns, rows, _ = project(camera, mesh.vertices)
    inside = (columns >= 0) & (columns < 160) & (rows >= 0) & (rows < 120)
    assert (columns[inside] >= left).all()
    assert (columns[inside] <= right).all()
    assert (rows[inside] >= top).all()
    assert (rows[inside] <= bottom).all()


def test_a_distorting_lens_has_the_whole_image_for_a_window():
    assert screen_window(camera_at(distortion=LENS), box()) == (0, 0, 160, 120)


@pytest.mark.parametrize(
    ("point", "inside"),
    [((0, 0, 5), True), ((14.9, 9.9, 9.9), True), ((0, 0, 10.1), False), ((15.1, 0, 5), False), ((0, 0, 550), False)],
)
def test_inside_a_box(point, inside):
    assert points_inside(np.array([point], float), box()).tolist() == [inside]


def test_between_two_boxes_is_not_inside():
    parts = [box(at=(x, 0.0, 5.0)) for x in (-30.0, 30.0)]
    both = TriangleMesh(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate([parts[0].faces, parts[1].faces + len(parts[0].vertices)]),
    )
    assert points_inside(np.array([[0.0, 0.0, 5.0], [30.0, 0.0, 5.0]]), both).tolist() == [False, True]


# --- lights


@given(elevation=st.floats(5.0, 175.0), azimuth=st.floats(-360, 360), k=st.integers(1, 6))
def test_panel_points_stand_at_cell_centres(elevation, azimuth, k):
    light = place_light(
        name="l",
        distance=330.0,
        elevation=math.radians(elevation),
        azimuth=math.radians(azimuth),
        size=(60.0, 40.0),
        points=k * k,
    )
    points = panel_grid(light, k * k)
    assert points.shape == (k * k, 3)
    assert np.allclose(points.mean(axis=0), light.centre)
    offsets = points - light.centre
    assert np.allclose(offsets @ light.outward, 0.0, atol=1e-9)
    u, v = offsets @ light.across / 60.0, offsets @ light.along / 40.0
    expected = (np.arange(k) + 0.5) / k - 0.5
    assert np.allclose(np.unique(np.round(u, 9)), expected, atol=1e-8)
    assert np.allclose(np.unique(np.round(v, 9)), expected, atol=1e-8)
    assert np.allclose(np.cross(light.across, light.along), light.outward, atol=1e-12)  # e_φ × e_θ = d


@pytest.mark.parametrize(
    ("points", "normalisation", "gain", "total"),
    [
        (4, "mean", 1.0, 1.0),
        (4, "sum", 1.0, 4.0),
        (9, "mean", 0.5, 0.5),
        (9, "sum", 0.5, 4.5),
        ("auto", "mean", 2.0, 2.0),
    ],
)
def test_total_weight(points, normalisation, gain, total):
    light = place_light(
        name="l",
        distance=330.0,
        elevation=1.0,
        azimuth=0.0,
        size=(60.0, 60.0),
        points=points,
        normalisation=normalisation,
        gain=gain,
    )
    assert light.total_weight == total


# --- the part's view


@given(elevation=st.floats(-45, 45), rotation=st.floats(-360, 360), pivot=st.tuples(*[st.floats(-20, 20)] * 3))
def test_the_part_sees_the_camera_as_the_camera_sees_the_part(elevation, rotation, pivot):
    posture = Posture(elevation, rotation)
    light = place_light(name="l", distance=330.0, elevation=1.0, azimuth=0.5, size=(60.0, 60.0), points=1)
    scene = Scene(
        camera=camera_at(),
        lights=(light,),
        mesh=box(),
        reflectance=Reflectance(R_d=1.0, R_s=1.0, sigma=0.1),
        sensor=Sensor(bit_depth=8),
        stage=Stage(pivot=np.array(pivot)),
        postures=(posture,),
    )
    view = view_from_part(scene, posture)
    moved = transformed(scene.mesh, view.rotation, view.translation)
    # the posture as written down: p' = pivot + R (p − pivot)
    expected = (scene.mesh.vertices - scene.pivot) @ posture.matrix.T + scene.pivot
    assert np.allclose(moved.vertices, expected, atol=1e-9)
    in_world, in_part = project(scene.camera, expected), project(view.camera, scene.mesh.vertices)
    assert np.allclose(in_world, in_part, atol=1e-8)
    assert np.allclose(view.rotation @ view.lights[0].centre + view.translation, light.centre, atol=1e-9)
