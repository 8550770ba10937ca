"""Where things are: camera, pixels, lens, lights and stage, each against numbers worked out by hand."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import reference as ref
from hypothesis import example, given, strategies as st
from worlds import PARTS, box, levels, plane, scene_from_files, scene_from_mesh

from lightopt import render
from lightopt.geometry import TriangleMesh
from lightopt.scene import pixel_directions, place_camera, project
from lightopt.scene._camera import Distortion

CAMERA = ref.Camera(width=80, height=60, pixel_um=80)  # 0.8 mm of the table per pixel
LIGHT = ref.Light(k=1)


def geometry(scene):
    return next(iter(render(scene, threads=1))).geometry


def where_seen(hit):
    """Centroid (column, row) of the hit pixels, in pixel coordinates."""
    rows, columns = np.nonzero(hit)
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])


def flake(x, y, z=0.0, half=1.6):
    """A small square that faces up, centred at (x, y, z)."""
    mesh = plane(half)
    return TriangleMesh(mesh.vertices + np.array([x, y, z]), mesh.faces, None)


def test_plan_view_has_x_to_the_right_and_y_up():
    right = where_seen(geometry(scene_from_mesh(CAMERA, [LIGHT], flake(16, 0))).hit)
    up = where_seen(geometry(scene_from_mesh(CAMERA, [LIGHT], flake(0, 16))).hit)
    # 16 mm are 20 pixels; row 0 is at the top
    np.testing.assert_allclose(right, [40 + 20, 30], atol=0.01)
    np.testing.assert_allclose(up, [40, 30 - 20], atol=0.01)


def test_pixel_centres_are_at_one_half():
    """The plane's points under the pixels: pixel (0, 0) is the top left one, the principal point the image's centre."""
    seen = geometry(scene_from_mesh(CAMERA, [LIGHT], plane(200))).points
    rows, columns = np.mgrid[0:60, 0:80]
    expected = np.stack([(columns + 0.5 - 40) * 0.8, -(rows + 0.5 - 30) * 0.8, np.zeros((60, 80))], axis=2)
    np.testing.assert_allclose(seen, expected, atol=1e-4)


@pytest.mark.parametrize(("width", "height"), [(7, 4), (8, 5)])
def test_principal_point_is_the_centre_of_odd_and_even_images(width, height):
    camera = ref.Camera(width=width, height=height, pixel_um=100)
    seen = geometry(scene_from_mesh(camera, [LIGHT], plane(50))).points
    np.testing.assert_allclose(seen.mean(axis=(0, 1)), [0, 0, 0], atol=1e-5)


@pytest.mark.parametrize("roll", [90.0, -30.0, 200.0])
def test_roll_turns_the_image_clockwise(roll):
    """With roll the camera's right turns from +X towards +Y, so that the scene turns the other way in the image."""
    camera = ref.Camera(width=80, height=80, pixel_um=80, roll=roll)
    seen = where_seen(geometry(scene_from_mesh(camera, [LIGHT], flake(16, 0))).hit)
    r = math.radians(roll)
    np.testing.assert_allclose(seen, [40 + 20 * math.cos(r), 40 + 20 * math.sin(r)], atol=0.35)


def test_elevation_past_the_zenith_leans_to_the_other_side():
    """The paper's camera: elevation 105 at azimuth 270 stands at +Y, on the far side of the zenith."""
    camera = place_camera(
        distance=550,
        elevation=math.radians(105),
        azimuth=math.radians(270),
        roll=0,
        width=8,
        height=6,
        pixel_size=0.044,
        image_distance=55,
    )
    s, c = math.sin(math.radians(15)), math.cos(math.radians(15))
    np.testing.assert_allclose(camera.position, [0, 550 * s, 550 * c], atol=1e-9)
    np.testing.assert_allclose(camera.right, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(camera.up, [0, c, -s], atol=1e-12)


def test_elevation_is_continuous_through_the_zenith():
    # seen from 0.01° before and after 90° the same point moves by 2·0.01° of 550 mm at most, and nothing flips
    seen = [
        geometry(scene_from_mesh(ref.Camera(80, 60, pixel_um=80, elevation=e), [LIGHT], plane(200))).points.astype(
            float
        )
        for e in (89.99, 90.0, 90.01)
    ]
    for one, two in itertools.pairwise(seen):
        assert 0 < np.abs(one - two).max() < 0.01
    # 100° at azimuth 270 is where 80° at azimuth 90 is, but with the image the right way up: turned by a half turn
    past = geometry(scene_from_mesh(ref.Camera(80, 60, pixel_um=80, elevation=100), [LIGHT], plane(200))).points
    across = geometry(
        scene_from_mesh(ref.Camera(80, 60, pixel_um=80, elevation=80, azimuth=90), [LIGHT], plane(200))
    ).points
    np.testing.assert_allclose(past, across[::-1, ::-1], atol=1e-4)


def test_light_past_the_zenith_is_the_one_on_the_other_side():
    mesh = box([-5, -5, 0], [5, 5, 8])
    past = levels(scene_from_mesh(CAMERA, [ref.Light(elevation=120, azimuth=45)], mesh))
    across = levels(scene_from_mesh(CAMERA, [ref.Light(elevation=60, azimuth=225)], mesh))
    assert past.max() > 0
    np.testing.assert_allclose(past, across, rtol=1e-6)


def test_the_panel_lies_along_azimuth_and_elevation():
    """A panel 100 mm along the azimuth alone, straight above at azimuth 270: two points ±25 mm along X."""
    light = ref.Light(distance=300, elevation=90, azimuth=270, size=(100, 1e-6), k=2)
    matte = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.05}
    tilted = plane(30, tilt=80, azimuth=90)  # its normal leans towards +X
    image = levels(scene_from_mesh(CAMERA, [light], tilted, reflectance=matte))
    n = np.array([math.sin(math.radians(80)), 0, math.cos(math.radians(80))])
    points = geometry(scene_from_mesh(CAMERA, [light], tilted)).points.astype(float)
    expected = 0
    for x in (-25, 25):
        to_light = np.array([x, 0, 300]) - points
        expected = expected + 50 * np.maximum(0, to_light @ n) / np.linalg.norm(to_light, axis=2)
    lit = image > 0
    assert np.count_nonzero(lit) > 100
    np.testing.assert_allclose(image[lit], expected[lit], rtol=1e-5)


# hand-computed: p' = pivot + Rx(θ)·Rz(φ)·(p − pivot)
@pytest.mark.parametrize(
    ("posture", "pivot", "point", "expected"),
    [
        ((0, 90), (0, 0, 0), (10, 0, 0), (0, 10, 0)),
        ((90, 0), (0, 0, 0), (0, 0, 10), (0, -10, 0)),
        ((90, 90), (0, 0, 0), (10, 0, 0), (0, 0, 10)),  # rotation first: (10,0,0) → (0,10,0) → (0,0,10)
        ((30, 0), (0, 0, 0), (0, 10, 0), (0, 8.660254, 5)),
        ((0, 180), (5, 0, 0), (15, 0, 0), (-5, 0, 0)),
        ((90, 0), (0, 0, 20), (0, 10, 20), (0, 0, 30)),
        ((45, 270), (1, 2, 3), (4, 2, 3), (1, 2 - 3 * 0.70710678, 3 - 3 * 0.70710678)),
    ],
)
def test_posture_kinematics(posture, pivot, point, expected):
    """A small box about the point is where the hand-computed point is (P channel of the geometry)."""
    point = np.asarray(point, dtype=float)
    mesh = box(point - 0.5, point + 0.5)
    camera = ref.Camera(width=200, height=200, pixel_um=25)
    g = geometry(scene_from_mesh(camera, [LIGHT], mesh, pivot=pivot, postures=[posture]))
    assert np.count_nonzero(g.hit) > 9
    seen = g.points[g.hit]
    # the camera sees a box from above: its middle in X and Y, its top in Z
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    half = np.abs(ref.posed(np.eye(3), *posture) - ref.posed(np.zeros(3), *posture)).sum(axis=0) / 2
    np.testing.assert_allclose(middle[:2], expected[:2], atol=0.15)
    assert seen[:, 2].max() == pytest.approx(expected[2] + half[2], abs=0.3)


def test_postures_turn_the_part_and_not_the_camera(tmp_path):
    """Every seen point, turned back by hand, lies on the part at posture (0, 0), and its normal with it."""
    posture, pivot = (25, 130), (3.0, -2.0, 5.0)
    scene = scene_from_files(
        tmp_path, CAMERA, [LIGHT], PARTS / "cover-knob.stl", postures=[posture], pivot=pivot, normals="facet"
    )
    g = geometry(scene)
    back = np.linalg.inv(ref.posed(np.eye(3), *posture).T)
    seen, normals = g.points[g.hit].astype(float), g.normals[g.hit].astype(float)
    points = (seen - pivot) @ back.T + pivot
    normals = normals @ back.T
    corners = scene.mesh.vertices[scene.mesh.faces]
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facets /= np.linalg.norm(facets, axis=1, keepdims=True)
    for p, n in zip(points[::40], normals[::40], strict=True):
        on_plane = np.abs(np.einsum("ij,ij->i", p - corners[:, 0], facets)) < 1e-3
        same_normal = facets @ n > 1 - 1e-6
        assert (on_plane & same_normal).any()


@example(k=(-0.03125, 0.125, 0.0, 0.0, 8e-226), angles=(20.0, 0.0, 0.0))
@given(
    k=st.tuples(*[st.floats(-0.2, 0.2)] * 2, *[st.floats(-0.01, 0.01)] * 2, st.floats(-0.2, 0.2)),
    angles=st.tuples(st.floats(20, 160), st.floats(0, 360), st.floats(-180, 180)),
)
def test_lens_forward_undoes_the_lens_back(k, angles):
    """Pixel to ray to point to pixel, through OpenCV's model, its inverse, and any placing of the camera."""
    elevation, azimuth, roll = np.deg2rad(angles)
    camera = place_camera(
        distance=500,
        elevation=elevation,
        azimuth=azimuth,
        roll=roll,
        width=64,
        height=48,
        pixel_size=0.25,
        image_distance=20,
        distortion=Distortion(k1=k[0], k2=k[1], p1=k[2], p2=k[3], k3=k[4]),
    )
    columns, rows = (x.ravel() for x in np.meshgrid(np.linspace(0, 64, 9), np.linspace(0, 48, 7)))
    rays = pixel_directions(camera, columns, rows)
    again = project(camera, camera.position + 321.0 * rays)
    np.testing.assert_allclose(again[0], columns, atol=1e-8)
    np.testing.assert_allclose(again[1], rows, atol=1e-8)


@pytest.mark.parametrize("coefficient", range(5))
def test_each_distortion_coefficient_moves_the_picture_as_opencv_does(coefficient):
    """The table's points under the pixels, put through OpenCV's formula written out here, are the pixels' centres."""
    k = [0.0] * 5
    k[coefficient] = (0.3, 1.5, 0.02, 0.02, 5.0)[coefficient]
    camera = ref.Camera(80, 60, distance=100, pixel_um=100, image_distance=10, distortion=tuple(k))
    seen = geometry(scene_from_mesh(camera, [LIGHT], plane(100))).points.astype(float)
    a, b = seen[..., 0] / 100, -seen[..., 1] / 100  # y down
    r2 = a * a + b * b
    radial = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
    u = a * radial + 2 * k[2] * a * b + k[3] * (r2 + 2 * a * a)
    v = b * radial + k[2] * (r2 + 2 * b * b) + 2 * k[3] * a * b
    assert np.hypot(u - a, v - b).max() * 100 > 0.5, "the coefficient must be seen to matter"
    rows, columns = np.mgrid[0:60, 0:80]
    np.testing.assert_allclose(40 + 100 * u, columns + 0.5, atol=1e-4)
    np.testing.assert_allclose(30 + 100 * v, rows + 0.5, atol=1e-4)
