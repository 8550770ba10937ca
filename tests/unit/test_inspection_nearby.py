"""Parts of a batch that lie nearly alike: predictions moved a little are those that would be rendered."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lightopt import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Placement, place_part
from lightopt.images import read_image_set
from lightopt.inspection import PredictionCache, predict
from lightopt.inspection.prediction._nearby_placement import (
    difference_steps,
    placement_derivatives,
    shift_prediction,
    shifted_scene,
)
from lightopt.inspection.prediction._registered_set import nominal_scene
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set, render_posture

TILTED = Posture(-10.0, 170.0)
FLAT = Posture(0.0, 0.0)
PLACE = Placement(x=0.4, y=-0.3, turn=math.radians(0.5))
LIGHTS = ("light1", "light3")


def further(off):
    return replace(PLACE, x=PLACE.x + off[0], y=PLACE.y + off[1], turn=PLACE.turn + off[2])


@pytest.fixture(scope="module")
def nominal(shared_bench):
    from lightopt import build_scene

    return build_scene(shared_bench.rig, shared_bench.part, defects=False)


@pytest.fixture(scope="module")
def known(nominal):
    """The part at its place, its prediction in the flat posture, and how that changes."""
    scene = place_part(nominal, PLACE)
    caster = cast_rays_at(scene)
    prediction = predict(scene, FLAT, caster, lights=LIGHTS)
    return scene, prediction, placement_derivatives(scene, PLACE, FLAT, prediction, caster)


def test_moving_camera_and_lights_is_moving_the_part(nominal):
    scene, off = place_part(nominal, PLACE), np.array([0.3, -0.2, 0.01])
    moved = shifted_scene(scene, PLACE, TILTED, off)
    ours = render_posture(moved, TILTED, caster=cast_rays_at(scene))
    placed = place_part(nominal, further(off))
    theirs = render_posture(placed, TILTED, caster=cast_rays_at(placed))
    for one, other in zip(ours.lights, theirs.lights, strict=True):
        assert one.level.max() > 100
        differs = np.abs(one.level - other.level) > 0.02
        assert differs.mean() < 2e-3  # rays at edges


@pytest.mark.parametrize("off", [(1, 0, 0), (0, -1, 0), (0, 0, 1), (0.4, -0.3, 0.5)])
def test_a_prediction_moved_is_the_one_rendered_there(nominal, known, off):
    scene, prediction, slopes = known
    mm = np.array(off) * difference_steps(scene)
    ours = shift_prediction(prediction, slopes, mm)
    placed = place_part(nominal, further(mm))
    theirs = predict(placed, FLAT, cast_rays_at(placed), lights=LIGHTS)
    clean = prediction.clean & theirs.clean
    for one, other, before in zip(ours.images.lights, theirs.images.lights, prediction.images.lights, strict=True):
        seen = clean & (other.level < 250)  # beyond, the camera sees no difference
        error, change = (np.abs(level[seen] - other.level[seen]).astype(float) for level in (one.level, before.level))
        assert np.mean(error) < 0.25 * np.mean(change)
        assert np.percentile(error, 99) < 1.0


def images_of(bench, folder, shift, *, seed):
    """Rig, part and images of the part a little off PLACE, in mm and degrees as files have it."""
    text = bench.part.read_text(encoding="utf-8")
    x, y, turn = shift
    nominal = "translate_mm: [0, 0, 0]"
    assert nominal in text
    path = bench.part.with_name(f"moved-{folder.name}.yaml")
    path.write_text(text.replace(nominal, f"translate_mm: [{x}, {y}, 0], rotate_deg: [0, 0, {turn}]"), encoding="utf-8")
    rig = load_rig(bench.rig)
    options = RenderOptions(noise=seed, patch_budget=500, postures=(FLAT,), supersample=3)
    render_image_set(rig, load_part(path), folder, options=options)
    return rig, load_part(bench.part), read_image_set(folder)


@pytest.fixture
def first(shared_bench, tmp_path):
    """Predictions of a part that was inspected."""
    rig, part, images = images_of(shared_bench, tmp_path / "first", (0.4, -0.3, 0.5), seed=1)
    predictions = PredictionCache()
    nominal, observations = nominal_scene(rig, part, images, scenes=predictions.nominal_scenes)
    scene, _ = predictions.use_placement(place_part(nominal, PLACE), PLACE)
    predictions.prediction(scene, FLAT, LIGHTS)
    predictions.measure_misfit(scene, observations)
    return predictions


def test_a_part_nearly_in_the_same_place_is_found_without_a_search(first, shared_bench, tmp_path):
    rig, part, images = images_of(shared_bench, tmp_path / "second", (0.46, -0.34, 0.55), seed=2)
    nominal, observations = nominal_scene(rig, part, images, scenes=first.nominal_scenes)
    assert nominal is next(iter(first.nominal_scenes.values()))  # the mesh is not read again
    near = first.nearby_placement(nominal, observations)
    assert near is not None
    scene, place, off = near
    x, y, turn = off * difference_steps(scene)
    assert (place.x - PLACE.x, place.y - PLACE.y, place.turn - PLACE.turn) == pytest.approx((x, y, turn))
    assert 0.0 < max(place.errors[:2]) < 0.006
    assert (x, y) == pytest.approx((0.06, -0.04), abs=0.006)
    assert math.degrees(turn) == pytest.approx(0.05, abs=0.02)


@pytest.mark.parametrize("shift", [(1.4, -0.3, 0.5), (0.4, -0.9, 0.5), (0.4, -0.3, 3.5)])
def test_a_part_further_off_is_searched_for_anew(first, shared_bench, tmp_path, shift):
    rig, part, images = images_of(shared_bench, tmp_path / "other", shift, seed=2)
    nominal, observations = nominal_scene(rig, part, images, scenes=first.nominal_scenes)
    assert first.nearby_placement(nominal, observations) is None


def test_what_the_first_part_did_not_determine_stays(first, shared_bench, tmp_path):
    rig, part, images = images_of(shared_bench, tmp_path / "second", (0.46, -0.34, 0.5), seed=2)
    nominal, observations = nominal_scene(rig, part, images, scenes=first.nominal_scenes)
    first.placement = replace(PLACE, observable=(True, True, False))
    near = first.nearby_placement(nominal, observations)
    assert near is not None
    assert near[1].turn == PLACE.turn
    assert near[1].x == pytest.approx(0.46, abs=0.01)


def test_slopes_too_large_to_keep_are_not_rendered(first, shared_bench, tmp_path, monkeypatch):
    rig, part, images = images_of(shared_bench, tmp_path / "second", (0.46, -0.34, 0.55), seed=2)
    nominal, observations = nominal_scene(rig, part, images, scenes=first.nominal_scenes)
    monkeypatch.setattr("lightopt.inspection.prediction._prediction_cache.MOST_BYTES", 1000)
    assert first.nearby_placement(nominal, observations) is None
    assert not first.derivatives


def test_nothing_is_near_before_a_first_part_was(nominal):
    assert PredictionCache().nearby_placement(nominal, []) is None
