"""A calibrated rig is adjusted to the images of a part within what its calibration leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from verified import images_of, observed, parameters_of, rig_with, small_scene

from lightopt.config import load_part, load_rig
from lightopt.core.run_context import RunContext
from lightopt.estimate.registration import Placement
from lightopt.estimate.verification import adjust_rig
from lightopt.images import read_image_set
from lightopt.inspection import InspectOptions, inspect_set
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set, render_posture

CENTRE_MM, CAMERA_MM = 0.5, 0.4  # standard deviations of the calibration
OFF = {"panel_shift light1": [0.5, -0.3, 0.0], "panel_shift light3": [-0.4, 0.6, 0.0], "camera_shift": [0.2, -0.3, 0.0]}


@pytest.fixture(scope="module")
def scene(shared_bench):
    return small_scene(shared_bench, points=4)


@pytest.fixture(scope="module")
def rig(shared_bench, tmp_path_factory):
    """The rig file with a calibration that knows panels and camera to half a millimetre."""
    folder = tmp_path_factory.mktemp("calibrated")
    lights = [f"{light.name} centre {axis} [mm]" for light in load_rig(shared_bench.rig).lights for axis in "xyz"]
    names = [f"camera.position_{axis}" for axis in "xyz"] + lights
    covariance = np.diag(np.square([CAMERA_MM] * 3 + [CENTRE_MM] * len(lights)))
    np.savez(folder / "rig.npz", names=np.array(names), covariance=covariance)
    (folder / "rig.yaml").write_text(f"{shared_bench.rig.read_text()}\ncalibration: {{covariance: rig.npz}}\n")
    return load_rig(folder / "rig.yaml")


def misfit(scene, adjustment, truth):
    """Root of the sum of squared differences in the noise of a pixel, between a rig and the images of the true one."""
    world = scene if adjustment is None else adjustment.apply(scene)
    caster, total = cast_rays_at(world), 0.0
    for posture in scene.postures:
        for image in render_posture(world, posture, caster=caster).lights:
            known = truth[posture, image.light]
            used = (known < 250.0) & (known > 0.0) & (image.level > 0.0)
            noise = scene.sensor.noise_variance(known[used].astype(np.float64))
            total += float(np.sum(np.square(image.level[used] - known[used]) / np.maximum(noise, 1.0)))
    return total**0.5


def adjusted(rig, scene, images, *, register=True, black=0.0):
    return adjust_rig(rig, scene, observed(scene, images, seed=1, black=black), register=register)


def test_what_the_calibration_leaves_open_is_found(scene, rig):
    truth = images_of(scene, rig_with(scene, **OFF))
    found = adjusted(rig, scene, truth)
    assert misfit(scene, found, truth) < 0.1 * misfit(scene, None, truth)
    assert found.greatest_z < 4.0
    assert found.warnings == ()
    assert found.as_dict()["R_s_factor"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("fault", "black"),
    [({}, 0.0), ({"exposure": [np.log(1.03)]}, 0.0), ({"gain light1": [np.log(0.97)]}, 0.0), ({}, 1.0)],
    ids=["as filed", "exposure", "lamp", "black level"],
)
def test_what_inspection_finds_itself_does_not_move_the_rig(scene, rig, fault, black):
    still = images_of(scene, np.zeros(parameters_of(scene).size))
    found = adjusted(rig, scene, images_of(scene, rig_with(scene, **fault)), black=black)
    assert found.greatest_z < 2.0
    assert found.warnings == ()
    off = images_of(scene, rig_with(scene, **OFF))
    assert misfit(scene, found, still) < 0.15 * misfit(scene, None, off)


def test_the_part_may_lie_far_from_its_place(scene, rig):
    truth = images_of(scene, rig_with(scene, **OFF, part_shift=[2.5, 1.0, 0.0]))
    found = adjusted(rig, scene, truth)
    moved = found.as_dict()["camera"]["shift_mm"]
    assert np.abs(np.array(moved[:2]) - OFF["camera_shift"][:2]).max() < 0.25
    assert found.warnings == ()


def test_a_part_that_is_not_searched_for_is_where_its_file_has_it(scene, rig):
    truth = images_of(scene, rig_with(scene, **OFF))
    found = adjusted(rig, scene, truth, register=False)
    assert misfit(scene, found, truth) < 0.1 * misfit(scene, None, truth)
    assert found.as_dict()["camera"]["shift_mm"][:2] == pytest.approx(OFF["camera_shift"][:2], abs=0.02)


def test_images_that_tell_nothing_leave_the_rig_as_it_is(scene, rig):
    run = RunContext()
    dark = {key: np.zeros_like(level) for key, level in images_of(scene, np.zeros(parameters_of(scene).size)).items()}
    found = adjust_rig(rig, scene, observed(scene, dark, seed=1), register=True, run=run)
    assert found is None
    (warning,) = run.warnings
    assert warning.startswith("the calibrated rig is not adjusted to the images: ")


def test_a_calibration_of_the_sensor_adjusts_nothing(scene, shared_bench, tmp_path):
    np.savez(tmp_path / "rig.npz", names=np.array(["camera.sensor.black_level"]), covariance=np.eye(1))
    (tmp_path / "rig.yaml").write_text(f"{shared_bench.rig.read_text()}\ncalibration: {{covariance: rig.npz}}\n")
    images = images_of(scene, np.zeros(parameters_of(scene).size))
    assert adjusted(load_rig(tmp_path / "rig.yaml"), scene, images) is None


def test_inspection_adjusts_a_calibrated_rig(rig, shared_bench, tmp_path):
    part = load_part(shared_bench.part)
    render_image_set(rig, part, tmp_path / "images", options=RenderOptions(noise=1, patch_budget=500))
    images = read_image_set(tmp_path / "images")
    result = inspect_set(rig, part, images, options=InspectOptions(fusion=None))
    assert result.adjustment is not None
    assert result.as_dict()["rig_adjustment"]["greatest_z"] < 3.0
    alone = inspect_set(rig, part, images, options=InspectOptions(fusion=None, reference="self"))
    assert alone.adjustment is None
    assert "rig_adjustment" not in alone.as_dict()


def test_a_refused_set_leaves_no_rig_behind(scene, rig):
    cache, still = PredictionCache(), images_of(scene, np.zeros(parameters_of(scene).size))
    seen = cache.adjusted(rig, scene, observed(scene, still, seed=1), register=True, run=RunContext())
    cache.use_placement(seen, Placement())
    cache.restore_adjustment(None)
    assert cache.adjustment is None
    assert cache.use_placement(scene, Placement())[0] is scene  # not the one with the rig of the refused set


def test_defects_do_not_move_the_rig(scene, rig):
    truth = images_of(scene, rig_with(scene, **OFF))
    marked = {key: level.copy() for key, level in truth.items()}
    height, width = next(iter(marked.values())).shape
    for level in marked.values():
        level[height // 2 - 4 : height // 2 + 4, width // 2 - 20 : width // 2 + 20] *= 0.6
    found = adjusted(rig, scene, marked)
    assert misfit(scene, found, truth) < 0.15 * misfit(scene, None, truth)


def test_a_rig_that_has_changed_since_is_told(scene, rig):
    far = {"panel_shift light1": [6.0, 0.0, 0.0]}
    found = adjusted(rig, scene, images_of(scene, rig_with(scene, **far)))
    assert found.greatest_z > 5.0
    (warning,) = found.warnings
    assert "from its calibration: it has changed since; find out what by lightopt verify" in warning


@pytest.mark.parametrize(("px", "told"), [(0.1, False), (3.0, True)])
def test_corners_that_are_off_together_are_no_change(scene, shared_bench, tmp_path, px, told):
    """Thousands of corners know their mean to a hundredth of what a detector puts them off."""
    names = [f"camera.rotation_{axis}" for axis in "xyz"]
    np.savez(tmp_path / "rig.npz", names=np.array(names), covariance=np.diag([1e-10] * 3))
    (tmp_path / "rig.yaml").write_text(f"{shared_bench.rig.read_text()}\ncalibration: {{covariance: rig.npz}}\n")
    turn = px * scene.camera.pixel_size / scene.camera.image_distance
    images = images_of(scene, rig_with(scene, camera_turn=[0.0, turn, 0.0]))
    found = adjusted(load_rig(tmp_path / "rig.yaml"), scene, images, register=False)
    assert bool(found.warnings) is told


def test_lights_that_the_images_lack_stay(scene, rig):
    one = replace(scene, lights=scene.lights[:1])
    found = adjusted(rig, one, images_of(one, np.zeros(parameters_of(one).size)))
    first, *others = found.apply(scene).lights
    assert tuple(others) == scene.lights[1:]
    assert not np.array_equal(first.centre, scene.lights[0].centre)
