"""A measured rig: poses of camera and panels, focal length and principal point, axes of the stage."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from lightopt.config import load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture, rotation_from_vector, rotation_x, rotation_z, vector_of_rotation
from lightopt.design._candidates import panels_of, place_grid, place_of
from lightopt.design._files import _rig_text
from lightopt.lights import panel_corners
from lightopt.scene import Stage, build_camera, build_lights, build_stage, pixel_directions, place_camera, project
from lightopt.scene._image_area import image_area

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "configs" / "rigs" / "four-panel.yaml").read_text(encoding="utf-8")
CAMERA = """
  distance_mm: 550              # origin to pinhole
  elevation_deg: 90             # straight above
  azimuth_deg: 270              # with elevation 90 this is the plan view: X right, Y up (the default)
  roll_deg: 0                   # about the viewing axis (the default)
"""
LIGHT = "{name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45,  elevation_range_deg: [30, 60]}"

angle = st.floats(-math.pi, math.pi)


def rig(tmp_path, *changes):
    text = TEXT
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path = tmp_path / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return load_rig(path)


def vector(values):
    return "[" + ", ".join(f"{v:.12f}" for v in values) + "]"


def camera_pose(camera):
    turn = Rotation.from_matrix(np.stack([camera.right, -camera.up, camera.forward], axis=1)).as_rotvec(degrees=True)
    return f"\n  pose: {{position_mm: {vector(camera.position)}, rotation_vector_deg: {vector(turn)}}}\n"


@given(st.tuples(angle, angle, angle))
def test_rotation_vectors(values):
    vector = np.array(values)
    ours, theirs = rotation_from_vector(vector), Rotation.from_rotvec(vector)
    np.testing.assert_allclose(ours, theirs.as_matrix(), atol=1e-12)
    back = vector_of_rotation(ours)
    assert np.linalg.norm(back) <= math.pi + 1e-12
    np.testing.assert_allclose(rotation_from_vector(back), ours, atol=1e-9)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.6, -0.8, 0), (0.48, 0.6, 0.64)])
def test_half_turns_have_a_vector(axis):
    turned = Rotation.from_rotvec(math.pi * np.array(axis, dtype=float)).as_matrix()
    np.testing.assert_allclose(rotation_from_vector(vector_of_rotation(turned)), turned, atol=1e-9)


def test_a_pose_is_the_same_camera(tmp_path):
    ideal = place_camera(
        distance=550,
        elevation=1.2,
        azimuth=0.7,
        roll=0.3,
        width=1600,
        height=1200,
        pixel_size=4.4e-3,
        image_distance=55.0,
    )
    posed = build_camera(
        rig(tmp_path, (CAMERA, camera_pose(ideal)), ("image_distance_mm: 55 ", "focal_px: [12500, 12500] "))
    )
    points = np.random.default_rng(1).uniform(-20, 20, (50, 3))
    for ours, theirs in zip(project(posed, points), project(ideal, points), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


@pytest.mark.parametrize("distortion", ["{k1: 0}", "{k1: -0.4, k2: 3, p1: 0.002, p2: -0.001}"])
def test_principal_point_and_aspect(tmp_path, distortion):
    lens = "distortion: {k1: 0, k2: 0, p1: 0, p2: 0, k3: 0}"
    focal = "focal_px: [6000, 6060]\n  principal_point_px: [903, 540]\n"
    camera = build_camera(rig(tmp_path, ("image_distance_mm: 55 ", focal + "  #"), (lens, "distortion: " + distortion)))
    points = np.random.default_rng(1).uniform(-40, 40, (50, 3))
    columns, rows, _ = project(camera, points)
    # a plain reference: OpenCV's model, the first pixel's centre at 0.5
    seen = (points - camera.position) @ np.stack([camera.right, -camera.up, camera.forward], axis=1)
    x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
    d, r2 = camera.distortion, x * x + y * y
    radial = 1 + d.k1 * r2 + d.k2 * r2**2
    u = x * radial + 2 * d.p1 * x * y + d.p2 * (r2 + 2 * x * x)
    v = y * radial + d.p1 * (r2 + 2 * y * y) + 2 * d.p2 * x * y
    np.testing.assert_allclose(columns, 6000 * u + 903, atol=1e-9)
    np.testing.assert_allclose(rows, 6060 * v + 540, atol=1e-9)
    rays = pixel_directions(camera, columns, rows)
    towards = points - camera.position
    np.testing.assert_allclose(
        rays / np.linalg.norm(rays, axis=1, keepdims=True),
        towards / np.linalg.norm(towards, axis=1, keepdims=True),
        atol=1e-10,
    )


@pytest.mark.parametrize("k1", [0.0, -0.3])
def test_area_in_an_image_off_centre(tmp_path, k1):
    focal = "focal_px: [6000, 6300]\n  principal_point_px: [1300, 200]\n"
    camera = build_camera(rig(tmp_path, ("image_distance_mm: 55 ", focal + "  #"), ("{k1: 0,", f"{{k1: {k1},")))
    square = np.array([[-30.0, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]])
    # by the share of rays that meet it
    columns, rows = (a.ravel() for a in np.meshgrid(np.arange(1600) + 0.5, np.arange(1200) + 0.5))
    rays = pixel_directions(camera, columns, rows)
    at = camera.position + rays * (-camera.position[2] / rays[:, 2])[:, None]
    inside = np.count_nonzero((abs(at[:, 0]) <= 30) & (abs(at[:, 1]) <= 30))
    assert 0.1 < inside / len(rays) < 0.9
    assert image_area(camera, square) == pytest.approx(inside, rel=2e-3)


def test_stage_with_measured_axes(tmp_path):
    key = "tilt_axis: {point_mm: [0, 0.35, -0.2], direction: [1, 0, 0.002], scale: 1.01}\n  rotary_axis: {scale: 0.99}"
    stage = build_stage(rig(tmp_path, ("pivot_mm: [0, 0, 0] ", key + " #")))
    rotation, translation = stage.transform(Posture(30, 70))
    p, u = np.array([0, 0.35, -0.2]), np.array([1, 0, 0.002]) / math.hypot(1, 0.002)
    x = np.array([3.0, -4, 5])
    turned = Rotation.from_rotvec([0, 0, math.radians(0.99 * 70)]).apply(x)
    expected = p + Rotation.from_rotvec(math.radians(1.01 * 30) * u).apply(turned - p)
    np.testing.assert_allclose(rotation @ x + translation, expected, atol=1e-12)


def test_an_ideal_stage_keeps_its_bits():
    stage, posture = Stage(pivot=np.array([1.0, 2.0, 3.0])), Posture(-17.3, 211.7)
    rotation, translation = stage.transform(posture)
    assert (rotation == rotation_x(math.radians(-17.3)) @ rotation_z(math.radians(211.7))).all()
    assert (translation == stage.pivot - rotation @ stage.pivot).all()


def test_a_panel_moves_about_its_measured_pose(tmp_path):
    ideal = build_lights(load_rig(ROOT / "configs" / "rigs" / "four-panel.yaml"))[0]
    # 3 mm and 2° off
    off = Rotation.from_rotvec([0.02, 0.02, 0.02])
    turn = off * Rotation.from_matrix(np.stack([ideal.across, ideal.along, ideal.outward], axis=1))
    centre = ideal.centre + np.array([1.0, 2.0, -2.0])
    pose = f"{{centre_mm: {vector(centre)}, rotation_vector_deg: {vector(turn.as_rotvec(degrees=True))}}}"
    posed = rig(tmp_path, (LIGHT, f"{{name: light1, pose: {pose}, elevation_range_deg: [30, 65]}}"))
    here = build_lights(posed)[0]
    np.testing.assert_allclose(here.centre, centre, atol=1e-9)
    np.testing.assert_allclose(here.across, turn.apply([1, 0, 0]), atol=1e-9)
    light = posed.lights[0]
    assert light.elevation_deg == pytest.approx(math.degrees(here.elevation))
    there = panels_of(posed, 0, [(light.elevation_deg - 20, light.azimuth_deg)], None)[0]
    # carried about the horizontal axis through the origin that is across its azimuth
    phi = math.radians(light.azimuth_deg)
    carry = Rotation.from_rotvec(math.radians(20) * np.array([-math.sin(phi), math.cos(phi), 0]))
    np.testing.assert_allclose(panel_corners(there), carry.apply(panel_corners(here)), atol=1e-6)
    assert there.distance == pytest.approx(here.distance)


def test_a_panel_of_a_measured_pose_moves_along_its_direction(tmp_path):
    pose = "{centre_mm: [0, 180, 240], rotation_vector_deg: [30, 0, 0]}"
    posed = rig(tmp_path, (LIGHT, f"{{name: light1, pose: {pose}, distance_range_mm: [300, 400]}}"))
    light = posed.lights[0]
    here, there = panels_of(posed, 0, [(light.elevation_deg, light.azimuth_deg, d) for d in (300.0, 400.0)], None)
    assert (here.centre == build_lights(posed)[0].centre).all()
    np.testing.assert_allclose(there.centre, [0, 240, 320], atol=1e-9)
    assert (there.across == here.across).all()
    assert there.distance == pytest.approx(400.0)


def test_a_measured_place_stands_for_one_that_is_hardly_another(tmp_path):
    pose = "{centre_mm: [0, 164.9, 285.8], rotation_vector_deg: [30, 0, 0]}"  # 60.015°
    posed = rig(tmp_path, (LIGHT, f"{{name: light1, pose: {pose}, elevation_range_deg: [30, 60.02]}}"))
    here = place_of(posed.lights[0])
    assert 60.0 < here[0] < 60.02
    found = place_grid(posed, 0, step_deg=5.0).distinct
    assert [elevation for elevation, _ in found] == [30.0, 35.0, 40.0, 45.0, 50.0, 55.0, here[0]]
    assert found[-1] == here


def test_a_panel_that_moves_is_no_longer_as_measured(tmp_path):
    pose = "{centre_mm: [0, 180, 240], rotation_vector_deg: [30, 0, 0]}"
    names = [f"{light} {value}" for light in ("light1", "light2") for value in ("centre x [mm]", "gain")]
    measured = "".join(f'\n    "{name}": [0.9, 1.1]' for name in names)
    posed = rig(
        tmp_path,
        (LIGHT, f"{{name: light1, pose: {pose}, distance_range_mm: [300, 400]}}"),
        ("\nstage:", f"\ncalibration:\n  covariance: rig.npz\n  intervals:{measured}\nstage:"),
    )
    (tmp_path / "rig.npz").touch()
    places = [place_of(light) for light in posed.lights]
    for distance, left in ((300.0, names), (400.0, names[1:])):
        places[0] = (*places[0][:2], distance)
        (tmp_path / "moved.yaml").write_text(_rig_text(posed, places, tmp_path), encoding="utf-8")
        assert list(load_rig(tmp_path / "moved.yaml").calibration.intervals) == left
    # a light without a measured pose, and nothing left
    alone = "\n".join(line for line in posed.source.text.splitlines() if "gain" not in line and "light1 c" not in line)
    (tmp_path / "alone.yaml").write_text(alone, encoding="utf-8")
    alone = load_rig(tmp_path / "alone.yaml")
    assert list(alone.calibration.intervals) == ["light2 centre x [mm]"]
    places = [place_of(light) for light in alone.lights]
    places[1] = (places[1][0] - 5.0, *places[1][1:])
    (tmp_path / "moved.yaml").write_text(_rig_text(alone, places, tmp_path), encoding="utf-8")
    assert load_rig(tmp_path / "moved.yaml").calibration is None


def test_reference_distance(tmp_path):
    far = rig(
        tmp_path,
        (LIGHT, LIGHT.replace("330", "660")),
        ("falloff: none ", "falloff: inverse_square\n  reference_distance_mm: 330 "),
    )
    from lightopt.lights import attenuated, panel_numbers

    panel = panel_numbers(build_lights(far)[0])
    assert attenuated.py_func(1.0, panel, 660.0**2, 1.0) == pytest.approx(0.25)
    assert (
        attenuated.py_func(1.0, panel_numbers(replace(build_lights(far)[0], reference_distance=None)), 660.0**2, 1.0)
        == 1.0
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "roll_deg: 0 ",
            "pose: {position_mm: [0, 0, 550], rotation_vector_deg: [180, 0, 0]} ",
            ["distance_mm", "given together with pose"],
        ),
        (
            CAMERA,
            "\n  pose: {position_mm: [0, 0, -5], rotation_vector_deg: [180, 0, 0]}\n",
            ["camera.pose.position_mm", "not above the table"],
        ),
        (
            CAMERA,
            "\n  pose: {position_mm: [0, 5], rotation_vector_deg: [180, 0, 0]}\n",
            ["camera.pose.position_mm", "[x, y, z]"],
        ),
        ("image_distance_mm: 55 ", "focal_px: [12500, 12500]\n  image_distance_mm: 55 ", ["focal_px", "only one"]),
        (
            LIGHT,
            LIGHT.replace(
                "distance_mm: 330,", "distance_mm: 330, pose: {centre_mm: [0, 0, 330], rotation_vector_deg: [0, 0, 0]},"
            ),
            ["lights[0].distance_mm", "pose"],
        ),
        ("pivot_mm: [0, 0, 0] ", "tilt_axis: {direction: [0, 1, 0]} ", ["stage.tilt_axis.direction", "degrees of X"]),
        ("pivot_mm: [0, 0, 0] ", "rotary_axis: {scale: 0} ", ["stage.rotary_axis.scale"]),
    ],
)
def test_bad_measured_rigs(tmp_path, old, new, words):
    with pytest.raises(InputError) as error:
        rig(tmp_path, (old, new))
    for word in words:
        assert any(word in message for message in error.value.messages), error.value.messages
