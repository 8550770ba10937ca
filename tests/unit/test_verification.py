"""Verification of a rig: each fault is named with its size, unchanged sets raise no alarm, bad input is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from verified import images_of, observed, parameters_of, rig_with, small_scene

from lightopt.config import load_rig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import rotation_from_vector
from lightopt.estimate.verification import VerifyLimits, append_history, plan_limits
from lightopt.estimate.verification._parameters import Work, calibrated_deviations, moved_light
from lightopt.estimate.verification._verify import verify_observations
from lightopt.optics import clipped_mean
from lightopt.scene import build_lights, project, view_from_part


@pytest.fixture(scope="module")
def scene(shared_bench):
    return small_scene(shared_bench)


@pytest.fixture(scope="module")
def images(scene):
    return images_of(scene, np.zeros(parameters_of(scene).size))


def verified(scene, images, *, seed=0, black=0.0, **options):
    return verify_observations(scene, observed(scene, images, seed=seed, black=black), **options)


def alarms(result):
    return {(f.kind, f.light) for f in result.findings if f.exceeds}


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))])
def test_an_unchanged_set_raises_no_alarm(scene, images, seed):
    result = verified(scene, images, seed=seed)
    assert result.within_tolerances
    assert result.answer == "the rig is within its tolerances"
    for light in result.lights:
        assert light.overlap > 0.95
        assert light.offset_px < 0.5
        assert light.residual < 1.3


FAULTS = {
    "gain light1": [math.log(0.95)],
    "exposure": [math.log(1.03)],
    "black": [2.0],
    "part_shift": [0.07, -0.07, 0.0],
    "camera_shift": [0.0, 0.3, 0.0],
    "panel_shift light3": [3.0, 0.0, 0.0],
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_with_its_size(scene, shared_bench, name):
    kind, _, light = name.partition(" ")
    if kind == "panel_shift":
        scene = small_scene(shared_bench, points=4)  # one point shows less of where a panel is
    theta = rig_with(scene, **{name: FAULTS[name]})
    found = images_of(scene, theta)
    black = 2.0 if kind == "black" else 0.0
    result = verified(scene, found, black=black)
    # a camera that turns moves the image as one that shifts does, and this camera is coarse
    bodies = {(k.partition("_")[0], of) for k, of in alarms(result)}
    assert bodies == {(kind.partition("_")[0], light)}
    first = result.findings[0]
    if kind in ("gain", "exposure"):
        assert first.parts[""] == pytest.approx(math.expm1(FAULTS[name][0]), abs=0.005)
    elif kind == "black":
        assert first.parts[""] == pytest.approx(2.0, abs=0.05)
    elif first.kind == kind:
        # across the line of sight
        assert list(first.parts.values())[:2] == pytest.approx(FAULTS[name][:2], abs=0.1 * first.limit + 0.02)
    assert not result.within_tolerances
    assert first.cause in result.answer


def test_two_faults_at_once(scene):
    theta = rig_with(scene, **{"gain light3": [math.log(1.05)], "part_shift": [0.1, 0.0, 0.0]})
    assert alarms(verified(scene, images_of(scene, theta))) == {("gain", "light3"), ("part_shift", "")}


def test_a_camera_that_has_turned_far(scene):
    """Twelve blocks off, where no step from the rig file points to it."""
    turn = 12.0 * scene.camera.pixel_size / scene.camera.image_distance
    result = verified(scene, images_of(scene, rig_with(scene, camera_turn=[0.0, turn, 0.0])))
    assert {kind.partition("_")[0] for kind, _ in alarms(result)} == {"camera"}
    assert result.findings[0].kind == "camera_turn"
    assert result.findings[0].size == pytest.approx(math.degrees(turn), rel=0.05)


def test_exchanged_lights(scene, images):
    other = {"light1": "light3", "light3": "light1"}
    swapped = {(posture, light): images[posture, other[light]] for posture, light in images}
    result = verified(scene, swapped)
    assert alarms(result) == {("swap", "images of light1 show light3, images of light3 show light1")}


def test_focus(scene):
    result = verified(scene, images_of(scene, np.zeros(parameters_of(scene).size), blur=2.0))
    assert alarms(result) == {("focus", "")}
    assert result.findings[0].size == pytest.approx(2.0, abs=0.5)


def dusty(scene, images, where):
    """Images with a dark spot of 5 px, fixed in the image or on the part."""
    top = scene.mesh.vertices
    point = top[np.argmin(np.hypot(top[:, 0] - 6.0, top[:, 1] - 3.0) - top[:, 2])]
    found = {}
    for (posture, light), level in images.items():
        own = posture if where == "part" else scene.postures[0]
        x, y, _ = project(view_from_part(scene, own).camera, point[None])
        rows, columns = np.mgrid[0 : level.shape[0], 0 : level.shape[1]] + 0.5
        off = (np.square(columns - x) + np.square(rows - y)) / 2.0**2
        found[posture, light] = (level * (1.0 - 0.5 * np.exp(-0.5 * off))).astype(np.float32)
    return found


def test_dust_on_the_lens_is_a_fault_of_the_rig(scene, images):
    result = verified(scene, dusty(scene, images, "lens"))
    assert alarms(result) == {("dust_lens", "")}


def test_a_mark_on_the_part_is_reported_and_raises_no_alarm(scene, images):
    result = verified(scene, dusty(scene, images, "part"))
    assert [f.kind for f in result.findings] == ["dust_part"]
    assert result.within_tolerances


def test_one_posture_cannot_tell_dust(scene, images):
    one = replace(scene, postures=scene.postures[:1])
    result = verified(one, dusty(scene, images, "lens"))
    assert "dust or a defect on the part, or dust on lens or sensor" in [f.cause for f in result.findings]
    assert any("another posture" in f.remedy for f in result.findings)


def test_gain_and_range_of_a_panel_cannot_be_told(scene):
    near = replace(
        scene, lights=tuple(replace(light, inverse_square=True, reference_distance=330.0) for light in scene.lights)
    )
    result = verified(near, images_of(near, rig_with(near, **{"panel_shift light1": [0.0, 0.0, 8.0]})))
    first = result.findings[0]
    assert {(first.kind, first.light), *first.alternatives} == {("gain", "light1"), ("panel_shift", "light1")}
    assert "mirror ball" in first.remedy


def test_what_cannot_be_seen_is_said(scene, images):
    # points shine alike in all directions: a panel turned about its centre shows in nothing
    assert "panel of light1 turned" in verified(scene, images).unseen


def known_to(scene, tmp_path, bench, names, sd):
    """Deviations of a rig whose values of these names have an independent standard deviation."""
    np.savez(tmp_path / "rig.npz", names=np.array(names), covariance=sd**2 * np.eye(len(names)))
    (tmp_path / "rig.yaml").write_text(f"{bench.rig.read_text()}\ncalibration: {{covariance: rig.npz}}\n")
    return calibrated_deviations(load_rig(tmp_path / "rig.yaml"), scene, parameters_of(scene))


@pytest.mark.parametrize(
    ("names", "fault", "moved", "far"),
    [
        ([f"camera.position_{axis}" for axis in "xyz"], "camera_shift", 0.3, 4.0),
        pytest.param(
            *([f"light1 centre {axis} [mm]" for axis in "xyz"], "panel_shift light1", 0.3, 6.0), marks=pytest.mark.slow
        ),
    ],
)
def test_what_a_calibration_leaves_open_raises_no_alarm(scene, tmp_path, shared_bench, names, fault, moved, far):
    deviations = known_to(scene, tmp_path, shared_bench, names, 0.4)
    limits = VerifyLimits(camera_mm=0.1, camera_deg=0.01, panel_mm=0.1)
    near = images_of(scene, rig_with(scene, **{fault: [moved, 0.0, 0.0]}))
    if fault == "camera_shift":
        assert alarms(verified(scene, near, limits=limits))
    result = verified(scene, near, limits=limits, deviations=deviations)
    assert result.within_tolerances
    assert max(light.explained for light in result.lights) < 1.3
    # ten standard deviations are no error of the calibration
    gone = images_of(scene, rig_with(scene, **{fault: [far, 0.0, 0.0]}))
    result = verified(scene, gone, limits=limits, deviations=deviations)
    assert {kind.partition("_")[0] for kind, _ in alarms(result)} == {fault.partition("_")[0]}
    json.dumps(result.as_dict())  # of a camera that has turned, too
    assert result.findings[0].error > 0.05 * result.findings[0].size  # the rig file does not have it exactly
    # a known good set was taken with the same rig
    good = observed(scene, images_of(scene, np.zeros(parameters_of(scene).size)), seed=5)
    if fault == "camera_shift":
        assert alarms(verified(scene, near, limits=limits, deviations=deviations, baseline=good))


def test_deviations_of_a_camera_are_those_of_its_image(scene, tmp_path, shared_bench):
    p, point = parameters_of(scene), np.array([[5.0, 3.0, 4.0]])
    focal = scene.camera.image_distance / scene.camera.pixel_size
    found = known_to(scene, tmp_path, shared_bench, ["camera.focal_px"], 0.01 * focal)
    longer = replace(scene, camera=replace(scene.camera, image_distance=1.01 * scene.camera.image_distance))
    here = project(p.view(scene, scene.postures[0], found[:, 0]).camera, point)[:2]
    there = project(view_from_part(longer, scene.postures[0]).camera, point)[:2]
    start = project(view_from_part(scene, scene.postures[0]).camera, point)[:2]
    move, expected = np.ravel(here) - np.ravel(start), np.ravel(there) - np.ravel(start)
    assert np.linalg.norm(expected) > 0.05
    assert np.abs(move - np.copysign(1.0, move @ expected) * expected).max() < 0.05 * np.linalg.norm(expected)


def test_a_covariance_that_cannot_be_read_is_refused(scene, tmp_path, shared_bench):
    known_to(scene, tmp_path, shared_bench, ["camera.focal_px"], 1.0)
    (tmp_path / "rig.npz").write_bytes(b"none")
    with pytest.raises(InputError, match=r"rig.npz is no covariance .*; copy it to the rig file, or remove"):
        calibrated_deviations(load_rig(tmp_path / "rig.yaml"), scene, parameters_of(scene))


def test_lights_of_other_kinds_move_as_a_whole():
    ring = build_lights(load_rig(Path(__file__).parents[2] / "configs" / "rigs" / "ring-quadrants.yaml"))[0]
    shift, turn = np.array([1.0, -2.0, 3.0]), np.array([0.02, -0.01])
    axes = np.stack([ring.across, ring.along, ring.outward], axis=1)
    moved = moved_light(ring, shift, turn)
    rotation = rotation_from_vector(axes[:, :2] @ turn)
    expected = ring.centre + axes @ shift + (ring.targets - ring.centre) @ rotation.T
    assert np.allclose(moved.targets, expected, atol=1e-9)
    assert np.allclose(moved.outward, rotation @ ring.outward)


def test_a_turned_panel_has_images_of_its_own(scene):
    work = Work(scene, parameters_of(scene), RunContext())
    turned = rig_with(scene, **{"panel_turn light1": [0.2, 0.1]})
    assert work.predict(turned) is not work.predict(np.zeros(parameters_of(scene).size))


def test_against_a_known_good_set(scene):
    # the rig is not as its file: that is no news where a known good set is given
    off = {"panel_shift light1": [2.0, -3.0, 0.0], "gain light3": [0.06]}
    good = observed(scene, images_of(scene, rig_with(scene, **off)), seed=5)
    same = observed(scene, images_of(scene, rig_with(scene, **off)), seed=6)
    assert alarms(verify_observations(scene, same, baseline=good)) == set()
    later = rig_with(scene, **off, **{"gain light1": [math.log(0.95)]})
    result = verify_observations(scene, observed(scene, images_of(scene, later), seed=7), baseline=good)
    assert alarms(result) == {("gain", "light1")}
    assert result.findings[0].parts[""] == pytest.approx(-0.05, abs=0.005)


def test_frames_without_light_show_the_black_level(scene, images):
    dark = np.full(next(iter(images.values())).shape, 2.0, np.float32)
    some = [replace(o, levels=o.levels - dark, subtracted=dark) for o in observed(scene, images, seed=1, black=2.0)]
    result = verify_observations(scene, some)
    assert alarms(result) == {("black", "")}
    assert result.findings[0].amount == "+2.00 levels in frames without light"


def test_limits_decide(scene):
    found = images_of(scene, rig_with(scene, **{"gain light1": [math.log(0.95)]}))
    assert verified(scene, found, limits=VerifyLimits(gain=0.06)).within_tolerances


def test_images_of_something_else_are_refused(scene, images):
    noise = np.random.default_rng(1)
    other = {key: noise.uniform(0.0, 200.0, level.shape).astype(np.float32) for key, level in images.items()}
    with pytest.raises(InputError, match="do not look like this part on this rig"):
        verified(scene, other, register=False)


def test_images_that_show_nothing_are_refused(scene, images):
    for factor, words in ((0.0, "are black"), (1e4, "saturated")):
        with pytest.raises(InputError, match=words):
            verified(
                scene, {key: level * np.float32(factor) + np.float32(factor > 1.0) for key, level in images.items()}
            )


def test_mean_of_clipped_levels():
    rng = np.random.default_rng(3)
    for level in (0.0, 0.4, 1.7, 6.0):
        drawn = np.maximum(np.floor(level + 0.8 * rng.standard_normal(200_000) + 0.5), 0.0)
        mean, _ = clipped_mean(np.array([level]), 0.8)
        assert mean[0] == pytest.approx(drawn.mean(), abs=0.01)
    (low, high), (slope, _) = clipped_mean(np.array([0.5, 0.501]), 0.8)
    assert (high - low) / 0.001 == pytest.approx(slope, rel=1e-2)


@pytest.mark.parametrize("name", vars(VerifyLimits()))
@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_bad_limits(name, value):
    with pytest.raises(InputError, match=f"limit {name}: expected a number above 0"):
        VerifyLimits(**{name: value})


def test_runs_over_time(scene, images, tmp_path):
    first = verified(scene, images)
    dim = images_of(scene, rig_with(scene, **{"gain light1": [math.log(0.95)]}))
    second = verified(scene, dim)
    for hour, result in enumerate((first, second)):
        rows = append_history(tmp_path, result, name="set", when=datetime(2026, 1, 2, hour, tzinfo=timezone.utc))
    assert [row["time"] for row in rows] == ["2026-01-02T00:00:00+00:00", "2026-01-02T01:00:00+00:00"]
    assert not rows[0].get("gain light1")
    assert float(rows[1]["gain light1"]) == pytest.approx(-0.05, abs=0.005)
    assert float(rows[1]["gain light1/limit"]) == pytest.approx(0.05 / 0.03, rel=0.1)
    assert float(rows[0]["light3 overlap"]) > 0.95
    table = tmp_path / "history.csv"
    assert table.read_text(encoding="utf-8").count("\n") == 3
    for text in ("a,b\n1,2\n", "time,set,gain\nnow,set,much\n"):
        table.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=r"history\.csv: no table of lightopt verify"):
            append_history(tmp_path, first, name="set", when=datetime(2026, 1, 3, tzinfo=timezone.utc))


def test_limits_of_a_plan(tmp_path):
    rig = load_rig(Path(__file__).parents[2] / "configs" / "rigs" / "four-panel.yaml")
    path = tmp_path / "result.json"

    def plan(*rows):
        widest = [{"what": what, "angle": angle, "degrees": degrees} for what, angle, degrees in rows]
        path.write_text(json.dumps({"tolerances": [{"widest": widest}]}), encoding="utf-8")

    plan(("light1", "elevation", 2.0), ("light2", "azimuth", 1.5), ("all lights", "both", 0.5), ("part", "tilt", 0.7))
    limits = VerifyLimits(**plan_limits(path, rig))
    assert limits.panel_mm == pytest.approx(330.0 * math.tan(math.radians(1.5)))
    assert limits.part_deg == 0.7
    plan(("light2", "azimuth", 0.0))
    with pytest.raises(InputError, match="tolerance of 0° for light2"):
        plan_limits(path, rig)
    for text in ("", "[]", '{"tolerances": []}', '{"tolerances": [{"widest": [{}]}]}'):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match="no tolerance analysis"):
            plan_limits(path, rig)
    with pytest.raises(InputError, match=r"none\.json: cannot be read"):
        plan_limits(tmp_path / "none.json", rig)
