"""Whole defects of the catalogue: the statistic is the plain one, its rate holds on noise, defects get their names."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import reference
from scipy import ndimage

from lightopt import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.defects import BUILT_IN_CATALOGUE, SIZES, defect_hypotheses, expected_change, rest_of_images
from lightopt.images import read_exr, read_image_set
from lightopt.inspection import InspectOptions, calibrate, inspect_set, predict
from lightopt.inspection.detection import _catalogue_score
from lightopt.inspection.detection._catalogue_score import (
    _Candidates,
    _Entry,
    _scan,
    explain_deviations,
    reduced_deviations,
)
from lightopt.inspection.detection._defects import join_explained
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import threshold
from lightopt.inspection.prediction._posture_view import posture_view
from lightopt.inspection.prediction._prediction_cache import PredictionCache
from lightopt.inspection.prediction._registered_set import nominal_scene
from lightopt.inspection.prediction._template_bank import CODES, LEAST_EXPECTED, template_bank
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set
from lightopt.scene import build_catalogue

FIRST = Posture(elevation_deg=0.0, rotation_deg=0.0)
# pixels see 0.44 mm
CATALOGUE = """\
defect_catalogue:
  - {name: scratch, kind: scratch, size_mm: [25, 1], slope_deg: 4}
  - {name: dent, kind: dent, size_mm: 9, slope_deg: 2}
  - {name: pit, kind: pit, size_mm: 1.3, slope_deg: 20}
  - {name: stain, kind: stain, size_mm: [7, 4], R_d_factor: 0.7}
  - {name: haze, kind: haze, size_mm: 8.4, sigma_factor: 1.5}
"""
AT = "at_pixel: {posture: {elevation_deg: 0, rotation_deg: 0}, pixel: "
DEFECTS = f"""\
defects:
  - {{name: scratch-1, kind: scratch, {AT}[60, 84]}}, size_mm: [14, 1], slope_deg: 4, direction_deg: 10}}
  - {{name: dent-1, kind: dent, {AT}[96, 44]}}, size_mm: 9, slope_deg: 2}}
  - {{name: pit-1, kind: pit, {AT}[55, 55]}}, size_mm: 1.3, slope_deg: 20}}
  - {{name: stain-1, kind: stain, {AT}[100, 80]}}, size_mm: [7, 4], R_d_factor: 0.7}}
"""
LIGHTS = "".join(
    f"  - {{name: light{i}, distance_mm: 330, elevation_deg: 60, azimuth_deg: {45 + 90 * i}}}\n" for i in range(4)
)
OPTIONS = InspectOptions(detector="catalogue", fusion=None, register=False)


def rendered(part, folder, seed, rig):
    render_image_set(rig, part, folder, options=RenderOptions(noise=seed, postures=(FIRST,), patch_budget=200))
    return read_image_set(folder)


@pytest.fixture(scope="module")
def case(shared_bench, tmp_path_factory):
    """Rig, good part, image sets of a good part and of one with defects; view and bank of the good one."""
    folder = tmp_path_factory.mktemp("catalogue")
    head = shared_bench.rig.read_text(encoding="utf-8").split("lights:\n")[0]
    path = shared_bench.rig.with_name("catalogue-rig.yaml")
    path.write_text(head + "lights:\n" + LIGHTS, encoding="utf-8")
    rig = load_rig(path)
    text = shared_bench.part.read_text(encoding="utf-8") + CATALOGUE
    parts = []
    for name, more in (("good", ""), ("bad", DEFECTS)):
        path = shared_bench.part.with_name(f"catalogue-{name}.yaml")
        path.write_text(text + more, encoding="utf-8")
        parts.append(load_part(path))
    good = rendered(parts[0], folder / "good", 5, rig)
    bad = rendered(parts[1], folder / "bad", 6, rig)
    scene, observations = nominal_scene(rig, parts[0], good)
    caster = cast_rays_at(scene)
    prediction = predict(scene, FIRST, caster, lights=[o.light for o in observations])
    view = posture_view(scene, observations, prediction, where="good")
    bank = template_bank(scene, view, build_catalogue(parts[0]), caster)
    return rig, parts, good, bad, scene, view, bank, caster


@pytest.fixture(scope="module")
def found(case):
    rig, (good, _), _, bad, *_ = case
    return inspect_set(rig, good, bad, options=OPTIONS)


def noise(view, seed):
    usable = np.broadcast_to(view.clean, view.level.shape) & (view.predicted > 0.0)
    z = np.where(usable, np.random.default_rng(seed).normal(size=usable.shape), 0.0).astype(np.float32)
    return Deviations(z, np.ones_like(z), usable, usable.copy())


def pieces_of(t, row, column, size, pose):
    group = (t.foreshortening[row, column] * len(SIZES) + size) * t.poses + pose
    some = slice(t.pieces.first[group], t.pieces.first[group + 1])
    reach = t.border * (t.change.shape[1] + 1)
    down, right = np.divmod(t.pieces.pixel[some] + reach, t.change.shape[1])
    return list(zip(down - t.border, right - t.border, t.pieces.variant[some], t.pieces.weight[some], strict=True))


@pytest.mark.parametrize("number", range(5))
def test_sums_of_kernels_are_those_of_the_plain_filter(case, number):
    t = case[6][number]
    z = reduced_deviations(t, noise(case[5], 3).z)
    rng = np.random.default_rng(number)
    rows, columns = np.nonzero(t.foreshortening >= 0)
    chosen = rng.integers(0, len(rows), 40)
    some = _Candidates(
        entry=np.zeros(40, np.int32),
        size=rng.integers(0, len(SIZES), 40).astype(np.int32),
        pose=rng.integers(0, t.poses, 40).astype(np.int32),
        row=rows[chosen].astype(np.int32),
        column=columns[chosen].astype(np.int32),
        z=np.zeros(40),
        score=np.zeros(40),
    )
    entry = _Entry(t, z, 0.0)
    sums, energies, shares = entry.measure(some)
    entry.rate(some)
    change = t.unit * t.change.astype(np.float64)
    for j in range(40):
        place = int(some.row[j]), int(some.column[j])
        pieces = pieces_of(t, *place, int(some.size[j]), int(some.pose[j]))
        u, e, of_whole, squares = reference.matched_filter(change, z, pieces, *place, most=t.unit * CODES)
        np.testing.assert_allclose(sums[j], u, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(energies[j], e, rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose(shares[j], np.stack([of_whole, squares], axis=1), rtol=1e-4, atol=1e-3)
        assert some.z[j] == pytest.approx(u.sum() / math.sqrt(e.sum()) if e.sum() else 0.0, abs=1e-3)
    # what scans use is the same for the middle size
    for i, k in np.argwhere(t.inverse[0] > 0)[::97]:
        place = t.border + i * t.step, t.border + k * t.step
        _, e, *_ = reference.matched_filter(change, z, pieces_of(t, *place, 1, 0), *place)
        assert t.inverse[0, i, k] == pytest.approx(t.unit / math.sqrt(e.sum()), rel=1e-3)


def test_deviations_are_summed_over_larger_pixels(case):
    view, bank = case[5:7]
    t = max(bank, key=lambda one: one.ratio)
    assert t.ratio > 1
    assert max(one.step for one in bank) > 1
    made = noise(view, 4)
    inner = slice(t.border, -t.border), slice(t.border, -t.border)
    top, left = (corner + t.border * t.ratio for corner in t.corner)
    for light in range(4):
        whole = made.z[light, top:, left:], made.usable[light, top:, left:]
        expected, count = reference.summed_blocks(*whole, t.ratio)
        mine = reduced_deviations(t, made.z)[(*inner, light)]
        height, width = mine.shape
        np.testing.assert_allclose(mine, expected[:height, :width], rtol=1e-4, atol=1e-4)
        np.testing.assert_array_equal(t.count[(*inner, light)], count[:height, :width])


@pytest.mark.parametrize("number", range(5))
def test_a_scan_finds_the_pose_of_the_greatest_plain_statistic(case, number, monkeypatch):
    monkeypatch.setattr(_catalogue_score, "LEAST_MIDDLE", 0.0)
    monkeypatch.setattr(_catalogue_score, "LEAST_SCORE", -9.0)
    t = case[6][number]
    z = reduced_deviations(t, noise(case[5], 8).z)
    found = _scan(0, _Entry(t, z, 0.0), 1)
    change = t.unit * t.change.astype(np.float64)
    middle = found.take(found.size == 1)
    for j in range(0, len(middle.row), max(1, len(middle.row) // 12)):
        place = int(middle.row[j]), int(middle.column[j])
        all_poses = []
        for pose in range(t.poses):
            u, e, *_ = reference.matched_filter(change, z, pieces_of(t, *place, 1, pose), *place)
            tested = math.sqrt(e.sum()) >= LEAST_EXPECTED
            all_poses.append(u.sum() / math.sqrt(e.sum()) if tested else 0.0)
        pose = int(np.abs(all_poses).argmax())
        assert middle.z[j] == pytest.approx(all_poses[pose], abs=2e-3)
        assert abs(all_poses[int(middle.pose[j])]) == pytest.approx(abs(all_poses[pose]), abs=2e-3)


@pytest.mark.slow
def test_noise_alone_stays_below_the_stated_rate(case):
    view, bank = case[5:7]
    high = threshold(0.5, int(view.clean.sum()), 1)
    draws = 60
    alarms = [
        sum(one.score >= high for one in explain_deviations(noise(view, seed), bank, share=1.0, min_images=1))
        for seed in range(draws)
    ]
    # the bound is Bonferroni's: neighbouring places and turns are much alike
    assert 0.05 * draws < sum(alarms) < 0.5 * draws


def test_dust_on_one_light_is_no_defect_unless_one_image_may_decide(case):
    view, bank = case[5:7]
    made = noise(view, 11)
    made.z[1, 60:63, 70:73] = 40.0
    high = threshold(0.05, int(view.clean.sum()), 1)

    def near(min_images):
        strong = (o for o in explain_deviations(made, bank, share=0.5, min_images=min_images) if o.score >= high)
        return [o for o in strong if abs(o.rows.mean() - 61) < 20 and abs(o.columns.mean() - 71) < 20]

    assert near(1)
    assert not near(2)


def test_the_rest_of_the_images_is_what_supports_least():
    sums = np.array([[30.0, 4.0, 1.0], [-30.0, -4.0, 3.0]], np.float32)
    energies = np.array([[9.0, 4.0, 1.0], [9.0, 4.0, 1.0]], np.float32)
    assert rest_of_images(sums, energies, 1) == pytest.approx([35 / math.sqrt(14), 31 / math.sqrt(14)])
    assert rest_of_images(sums, energies, 2) == pytest.approx([5 / math.sqrt(5), 1 / math.sqrt(5)])
    assert rest_of_images(sums, energies, 3) == pytest.approx([1.0, -3.0])
    assert rest_of_images(sums[:1], np.zeros((1, 3), np.float32), 2) == pytest.approx([0.0])


def test_expected_changes_are_clipped_as_the_camera_and_the_statistic_clip_them():
    good, varied = np.array([100.0, 250.0, 100.0, 0.5, 0.5]), np.array([104.0, 400.0, 0.0, 2.0, 9.0])
    change = expected_change(good, varied, deviation=np.full(5, 2.0), limit=np.full(5, 254.0))
    assert change.tolist() == [2.0, 2.0, -8.0, 0.0, 4.25]


@pytest.mark.parametrize(("defect", "least"), [("scratch", 0.75), ("dent", 0.9), ("pit", 0.75), ("stain", 0.95)])
def test_what_a_hypothesis_expects_is_what_the_renderer_makes_of_the_defect(case, defect, least):
    """Share of a rendered defect's √E that the best hypothesis around its middle has, without noise."""
    _, _, good, bad, _, view, bank, _ = case
    number = next(i for i, t in enumerate(bank) if t.hypotheses.entry.name == defect)
    t = bank[number]
    levels = [
        np.stack([read_exr(one.folder / e.exr)["Y"] for name in view.lights for e in one.images if e.light == name])
        for one in (good, bad)
    ]
    rendered = expected_change(*levels, deviation=t.deviation, limit=view.limit)
    truth = bad.load_geometry(bad.geometry[0])["defect"] == number
    near = np.asarray(ndimage.binary_dilation(truth, iterations=2))
    c = reduced_deviations(t, np.where(near & view.clean, rendered, 0.0).astype(np.float32))
    y, x = ((a.mean() + 0.5 - corner) / t.ratio for a, corner in zip(np.nonzero(truth), t.corner, strict=True))
    change = t.unit * t.change.astype(np.float64)
    best = 0.0, 0.0
    for row, column in itertools.product(*(range(int(a) - 1, int(a) + 2) for a in (y, x))):
        for pose in range(t.poses):
            u, e, *_ = reference.matched_filter(change, c, pieces_of(t, row, column, 1, pose), row, column)
            best = max(best, (u.sum() / math.sqrt(e.sum()), u.sum() / e.sum()))
    whole = math.sqrt(float(np.square(c, dtype=np.float64).sum()))
    # of a long scratch a segment is tested
    length = t.hypotheses.entry.shape.length if defect != "scratch" else 14.0
    part = math.sqrt(min(1.0, t.hypotheses.shapes[1].length / length))
    assert best[0] > least * part * whole
    assert best[1] == pytest.approx(1.0, abs=0.25)


def test_defects_are_named_with_their_size_and_slope(found):
    named = {one.best.named.entry: one.best.named for one in found.defects if one.best.named is not None}
    assert set(named) == {"scratch", "dent", "pit", "stain"}
    assert len(found.defects) == 4
    dent, stain = named["dent"], named["stain"]
    assert dent.kind == "dent"
    assert dent.length[0] == pytest.approx(9.0, rel=0.25)
    assert dent.length[1] < 9.0 < dent.length[2]
    assert dent.slope is not None
    assert math.degrees(dent.slope[0]) == pytest.approx(2.0, rel=0.25)
    assert stain.factor is not None
    assert stain.factor[0] == pytest.approx(0.7, abs=0.06)
    for one in named.values():
        assert sum(one.evidence.values()) == pytest.approx(one.z, rel=1e-3)
        assert "light0" in one.as_dict()["evidence"]


def test_a_long_scratch_is_one_defect_with_its_length_and_direction(found):
    (scratch,) = [d.best.named for d in found.defects if d.best.named and d.best.named.entry == "scratch"]
    assert scratch.length[0] == pytest.approx(14.0, rel=0.25)
    assert scratch.direction is not None
    off = (math.degrees(scratch.direction) - 10.0 + 90.0) % 180.0 - 90.0
    assert abs(off) <= 12.0


@pytest.mark.usefixtures("real_template_banks")
def test_a_good_part_has_no_defects_and_threads_change_no_byte(case):
    rig, (good, _), images, bad, *_ = case
    assert not inspect_set(rig, good, images, options=OPTIONS).defects
    one, four = (inspect_set(rig, good, bad, options=OPTIONS, run=RunContext(threads=n)) for n in (1, 4))
    assert one.postures[0].score.tobytes() == four.postures[0].score.tobytes()
    assert one.postures[0].labels.tobytes() == four.postures[0].labels.tobytes()
    assert [d.as_dict() for d in one.defects] == [d.as_dict() for d in four.defects]


def test_a_part_without_a_catalogue_is_tested_for_the_built_in_one(shared_bench):
    catalogue = build_catalogue(load_part(shared_bench.part))
    assert [entry.name for entry in catalogue] == [entry.name for entry in BUILT_IN_CATALOGUE]
    for entry in catalogue:
        own = defect_hypotheses(entry)
        assert len(own.shapes) == len(SIZES)
        # smaller than a pixel, and many pixels wide
        for scale in (1.0, 40.0):
            mixture = own.seen_by_pixels(1, 0, scale * np.eye(2))
            area = np.sum(mixture.weight) / scale**2
            assert 0.2 * own.shapes[1].area < area < 1.1 * own.shapes[1].area


def test_a_speck_narrower_than_larger_pixels_is_no_error(case):
    _, (good, _), _, _, scene, view, _, caster = case
    clean = np.zeros_like(view.clean)
    row, column = np.argwhere(view.clean)[0]
    clean[row, column] = True
    speck = replace(view, prediction=replace(view.prediction, clean=clean))
    wide = [entry for entry in build_catalogue(good) if entry.shape.width > 1.0]
    bank = template_bank(
        scene, speck, [replace(e, shape=replace(e.shape, length=20.0, width=20.0)) for e in wide], caster
    )
    assert all(entry.tests == 0 for entry in bank if entry.ratio > 1)
    explain_deviations(noise(speck, 0), bank, share=0.5, min_images=2)


def test_images_full_of_defects_are_refused(case, monkeypatch):
    _, _, _, _, _, view, bank, _ = case
    monkeypatch.setattr(_catalogue_score, "MOST_DEFECTS", 3)
    found = noise(view, 0)
    loud = replace(found, z=np.where(found.usable, 6.0 * found.z, 0.0).astype(np.float32))
    with pytest.raises(InputError, match="more than 3 places look like a defect"):
        explain_deviations(loud, bank, share=0.5, min_images=1)


def test_templates_are_kept_for_the_same_exposures_and_up_to_a_size(case, monkeypatch):
    _, (good, _), _, _, scene, view, _, _ = case
    module = "lightopt.inspection.prediction._prediction_cache"
    # what entries have in common counts once, and what those of a wavy part have of their own counts as well
    common = dict.fromkeys(("deviation", "change", "count", "foreshortening", "inverse"), np.zeros(8))
    made = [SimpleNamespace(**common | {"change": np.zeros(1)}, attenuation=np.zeros(4)) for _ in range(2)]
    monkeypatch.setattr(f"{module}.template_bank", lambda *_, **__: tuple(made))
    catalogue = build_catalogue(good)

    def banks(*exposures):
        cache = PredictionCache()
        monkeypatch.setattr(cache, "_caster", lambda _: None)
        shots = [dict.fromkeys(view.lights, ((exposure, 1),)) for exposure in exposures]
        return [cache.template_bank(scene, view, shot, catalogue) for shot in shots]

    first, again, other = banks(1.0, 1.0, 1.0 / 16.0)
    assert first is again
    assert first is not other
    monkeypatch.setattr(f"{module}.MOST_BYTES", 143)
    first, again = banks(1.0, 1.0)
    assert first is not again


def test_where_nothing_can_be_judged_there_is_nothing_to_test(case):
    _, (good, _), _, _, scene, view, _, caster = case
    dark = replace(view, prediction=replace(view.prediction, clean=np.zeros_like(view.clean)))
    assert template_bank(scene, dark, build_catalogue(good), caster) == ()
    assert explain_deviations(noise(dark, 0), (), share=0.5, min_images=2) == ()


def test_regions_of_other_deviations_stay_where_no_defect_explains_them(case, found):
    made = noise(case[5], 11)
    made.z[:, 60:63, 70:73] = 12.0
    explained = explain_deviations(made, case[6], share=0.5, min_images=2)[:1]
    labels = np.zeros(made.z.shape[1:], np.int32)
    labels[61, 71], labels[20, 90] = 1, 2
    joined, count, owners = join_explained(labels, 2, explained)
    assert count == 2
    assert list(owners) == [1]
    assert joined[20, 90] == 2
    assert (joined[explained[0].rows, explained[0].columns] == 1).all()
    assert join_explained(labels, 2, ()) == (labels, 2, {})


@pytest.mark.slow
def test_good_parts_set_the_threshold(case, tmp_path):
    rig, (good, _), _, bad, *_ = case
    sets = [rendered(good, tmp_path / f"good-{seed}", 20 + seed, rig) for seed in range(5)]
    options = replace(OPTIONS, false_alarms=0.5)
    learned = calibrate(rig, good, sets, options=options)
    assert len(learned.postures[0].peaks) == 5
    found = inspect_set(rig, good, bad, options=options, calibration=learned)
    assert {"dent", "stain"} <= {one.best.named.entry for one in found.defects if one.best.named is not None}
