"""Lights in the camera's view hide the part; bright field, dark field and mirrored holes; lights that touch."""

from __future__ import annotations

import math

import numpy as np
import pytest
from ball_on_table import world

from lightopt import build_scene, render
from lightopt.lights import rectangles_meet, surface_mesh
from lightopt.preflight import check_rig, check_scene
from lightopt.scene import build_lights, lights_meet, place_camera
from lightopt.scene._image_area import obstructions

SPOT = "{name: spot, kind: spot, half_angle_deg: 3, distance_mm: 300, elevation_deg: 40, azimuth_deg: 0}"


def shares(result, light: str) -> tuple[float, float, float]:
    (found,) = [f.values for f in result.findings if f.topic == "bright field" and f.values["light"] == light]
    return found["bright field"], found["dark field"], found["unlit"]


def test_a_light_in_the_view_hides_the_part_and_nothing_else(tmp_path):
    bar = "{name: bar, kind: bar, size_mm: [10, 10], distance_mm: 275, elevation_deg: 90}"
    (free,) = render(build_scene(*world(tmp_path, SPOT)))
    scene = build_scene(*world(tmp_path, SPOT, bar))
    (hidden,) = render(scene)
    lost = free.geometry.hit & ~hidden.geometry.hit
    rows, columns = np.nonzero(lost)
    assert np.ptp(rows) == np.ptp(columns)
    assert np.ptp(rows) + 1 == pytest.approx(10 / (0.088 * 275 / 55), abs=1)
    assert not hidden.lights[0].level[lost].any()
    same = ~lost
    np.testing.assert_array_equal(hidden.lights[0].level[same], free.lights[0].level[same])
    # a light that is not lit stands there all the same
    (only,) = render(build_scene(*world(tmp_path, SPOT, bar), lights=("spot",)))
    np.testing.assert_array_equal(only.lights[0].level, hidden.lights[0].level)


@pytest.mark.parametrize(
    "light",
    [
        SPOT,
        "{name: a, kind: coaxial, size_mm: [80, 80], distance_mm: 250}",
        "{name: a, kind: dome, radius_mm: 100, camera_hole_mm: 90}",
    ],
)
def test_lights_that_the_camera_looks_past(light, tmp_path):
    rig, part = world(tmp_path, light)
    assert build_scene(rig, part).camera.obstructions is None
    texts = [f.text for f in check_scene(rig, part).findings if f.topic == "light in view"]
    assert texts == ["no light stands in the camera's view, nor moves into it"]


def test_a_light_behind_the_part_hides_nothing(tmp_path):
    ring = "{name: low, kind: low_angle_ring, radius_mm: 30, height_mm: 5, distance_mm: 4}"
    rig, part = world(tmp_path, ring)
    scene = build_scene(rig, part)
    assert scene.camera.obstructions is not None
    (images,) = render(scene)
    footprint = 0.088 * 530 / 55  # at the ball's centre
    assert images.geometry.hit.sum() == pytest.approx(math.pi * (20 / footprint) ** 2, rel=0.02)


def test_a_dome_is_bright_field_where_a_ball_mirrors_it(tmp_path):
    rig, part = world(tmp_path, "{name: dome, kind: dome, radius_mm: 500, camera_hole_mm: 100, segments: 4, leak: 0.1}")
    result = check_scene(rig, part)
    bright, dark, unlit = shares(result, "dome")
    # the normal at ρ = 20·sin β from the axis mirrors the camera to 2β, down to the rim, half of 0.06 rad below
    # the ball; the lobe is 2σ = 0.02, and the camera is 530 mm away, half of 0.03 rad
    assert bright == pytest.approx(math.sin(math.pi / 4 + 0.03 + 0.02 + 0.015) ** 2, abs=0.02)
    assert unlit == pytest.approx(0.0, abs=0.01)
    assert bright + dark + unlit == pytest.approx(1.0)
    (hole,) = [f for f in result.findings if f.topic == "camera hole"]
    # a hole of radius 50 mm in 500 mm is 5.7° wide: normals to 2.9°, a share of sin²
    assert hole.values["share"] == pytest.approx(math.sin(0.5 * math.asin(0.1)) ** 2, abs=0.002)
    assert hole.level == "ok"


def test_a_plate_has_bright_field_from_above_only(tmp_path):
    flat = "{name: plate, kind: flat_dome, size_mm: [300, 300], camera_hole_mm: 60, distance_mm: 150}"
    low = "{name: low, kind: low_angle_ring, radius_mm: 90, height_mm: 15, distance_mm: 20}"
    result = check_scene(*world(tmp_path, flat, low, plate=True))
    bright, dark, _ = shares(result, "plate")
    assert (bright, dark) != (0.0, 0.0)
    assert shares(result, "low") == (0.0, 1.0, 0.0)
    (hole,) = [f for f in result.findings if f.topic == "camera hole"]
    assert hole.level == "note"
    assert hole.values["share"] + bright > 0.99  # what does not mirror the hole mirrors the plate


def built(tmp_path, *lights):
    rig, _ = world(tmp_path, *lights)
    return rig, build_lights(rig)


def test_lights_that_touch(tmp_path):
    dome = "{name: dome, kind: dome, radius_mm: 100, camera_hole_mm: 40, segments: 4}"
    bar = "{{name: bar, kind: bar, size_mm: [60, 10], distance_mm: {distance}, elevation_deg: 30, azimuth_deg: 0}}"
    for distance, meets in ((80, False), (97, True), (150, False)):
        rig, lights = built(tmp_path, dome, bar.format(distance=distance))
        assert any(lights_meet(light, lights[-1]) for light in lights[:-1]) == meets
        found = [f for f in check_rig(rig).findings if f.topic == "lights collide"]
        assert bool(found) == meets
        assert len(found) <= 1
    # quadrants of a dome share their edges, which is no collision
    assert not [f for f in check_rig(built(tmp_path, dome)[0]).findings if f.topic == "lights collide"]


def test_flat_lights_touch_as_rectangles_do(tmp_path):
    bar = "{{name: b{k}, kind: bar, size_mm: [200, 10], distance_mm: 90, azimuth_deg: {azimuth}, elevation_deg: 30}}"
    bars = [bar.format(k=k, azimuth=90 * k) for k in (0, 1)]
    _, (a, b) = built(tmp_path, *bars)
    assert lights_meet(a, b)
    assert lights_meet(a, b) == rectangles_meet(a, b)


@pytest.mark.parametrize(
    "light",
    [
        "{name: a, kind: dome, radius_mm: 100, camera_hole_mm: 40}",
        "{name: a, kind: flat_dome, size_mm: [100, 80], distance_mm: 100, camera_hole_mm: 40}",
        "{name: a, kind: tunnel, radius_mm: 50, length_mm: 80, distance_mm: 10}",
        "{name: a, kind: ring, inner_radius_mm: 20, outer_radius_mm: 30, distance_mm: 100, ring_tilt_deg: 20}",
        "{name: a, kind: bar, size_mm: [100, 20], distance_mm: 100, elevation_deg: 40}",
        "{name: a, kind: low_angle_ring, radius_mm: 90, height_mm: 15, distance_mm: 20}",
    ],
)
def test_triangles_face_where_the_light_shines(light, tmp_path):
    _, (light,) = built(tmp_path, light)
    vertices, faces = surface_mesh(light)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = (normals * -corners.mean(axis=1)).sum(axis=1)
    assert (towards[np.linalg.norm(normals, axis=1) > 1e-9] > 0.0).all()


def test_obstructions_move_with_the_camera(tmp_path):
    _, lights = built(tmp_path, "{name: bar, kind: bar, size_mm: [10, 10], distance_mm: 275, elevation_deg: 90}")
    camera = place_camera(
        distance=550, elevation=1.5707, azimuth=0.0, roll=0.0, width=80, height=60, pixel_size=0.088, image_distance=55
    )
    found = obstructions(camera, lights)
    assert found is not None
    assert found[..., 2] == pytest.approx(np.full(found.shape[:2], 275.0))


def test_a_camera_inside_a_dome_does_not_look_through_its_hole(tmp_path):
    dome = "{name: dome, kind: dome, radius_mm: 600, camera_hole_mm: 100}"
    (hole,) = [f for f in check_scene(*world(tmp_path, dome)).findings if f.topic == "camera hole"]
    assert hole.level == "warning"
    assert hole.text.startswith("the camera stands inside dome, 550 mm from the centre of its sphere of 600 mm")


def test_a_light_of_several_channels_reaches_below_the_table_once(tmp_path):
    low = "{name: low, kind: low_angle_ring, radius_mm: 30, height_mm: 15, distance_mm: 4, segments: 4}"
    (below,) = [f for f in check_rig(world(tmp_path, SPOT, low)[0]).findings if f.topic == "light below table"]
    assert below.text == "a corner of low is 3.5 mm below the table top; raise it, or take a smaller light"


def test_a_range_in_which_any_channel_reaches_below_the_table(tmp_path):
    """As far as the undivided ring, whichever segment is lowest there."""
    texts = []
    for segments in (1, 2, 3, 4):
        ring = "{name: r, kind: ring, inner_radius_mm: 40, outer_radius_mm: 60, distance_mm: 100, elevation_deg: 90, "
        ring += f"elevation_range_deg: [20, 90], segments: {segments}}}"
        (below,) = [f for f in check_rig(world(tmp_path, SPOT, ring)[0]).findings if f.topic == "light below table"]
        texts.append(below.text.partition(" (")[0])
    assert texts[0].startswith("within its range r reaches ")
    assert set(texts) == {texts[0]}
