"""Scores of noise follow their law; regions grow by hysteresis; detections of one place are one defect."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import special, stats

from lightopt.config import InspectionConfig
from lightopt.core.transforms import Posture
from lightopt.defects import SCALES_PX
from lightopt.estimate.registration import Placement
from lightopt.inspection import InspectionResult, SurfaceCoverage, judge
from lightopt.inspection.detection._defects import Detection, merge_detections
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._matched_filter import templates
from lightopt.inspection.detection._regions import box_sums, core_pixels, find_regions, split_regions
from lightopt.inspection.detection._residual_score import (
    STRONGEST_Z,
    noise_gain,
    rank_probability,
    score_deviations,
    smoothed_deviations,
    threshold,
)


def noise(lights, rows=200, columns=240, *, seed=0, holes=False):
    rng = np.random.default_rng(seed)
    usable = np.ones((lights, rows, columns), bool)
    if holes:
        usable[0, 50:120, 60:160] = False
        usable[1, rng.random((rows, columns)) < 0.2] = False
    z = np.where(usable, rng.normal(size=usable.shape), 0).astype(np.float32)
    return Deviations(z, np.ones_like(z), usable, usable.copy())


@pytest.mark.parametrize("scale", SCALES_PX)
def test_sums_of_noise_have_a_deviation_of_one_also_next_to_what_is_not_usable(scale):
    sums, counts = smoothed_deviations(noise(2, holes=True), scale)
    for values, there in zip(sums, counts, strict=True):
        assert np.std(values[there]) == pytest.approx(1.0, rel=0.03)
    ones, flags = np.ones((1, 60, 60), np.float32), np.ones((1, 60, 60), bool)
    even = Deviations(ones, ones, flags, flags)
    assert smoothed_deviations(even, scale)[0][0, 30, 30] == pytest.approx(noise_gain(scale), rel=0.02)


@pytest.mark.parametrize(("count", "rank"), [(4, 2), (4, 1), (3, 2), (2, 2), (1, 1), (1, 2), (6, 3)])
def test_the_law_of_the_kth_largest_is_that_of_draws(count, rank):
    draws = np.abs(np.random.default_rng(count).normal(size=(count, 200_000)))
    kth = np.sort(draws, axis=0)[-min(rank, count)]
    p = rank_probability(kth, np.full(kth.shape, count), rank)
    assert stats.kstest(p, "uniform").statistic < 0.004


@pytest.mark.slow
def test_noise_alone_is_hardly_ever_above_the_threshold():
    maxima = [float(score_deviations(noise(4, seed=i, holes=True), min_images=2).max()) for i in range(40)]
    high = threshold(0.5, 200 * 240, len(SCALES_PX))
    # at most one image in two, and Bonferroni's bound is not idle
    assert 2 <= sum(m >= high for m in maxima) <= 24
    assert sum(m >= threshold(0.01, 200 * 240, len(SCALES_PX)) for m in maxima) <= 2


@pytest.mark.parametrize("min_images", [1, 2, 3, 4])
def test_a_strong_defect_has_a_score_however_many_images_must_show_it(min_images):
    found = noise(4)
    found.z[:, 100:106, 100:106] += 30
    score = score_deviations(found, min_images=min_images)
    assert np.isfinite(score).all()
    # C(4, k)·tᵏ, t the two tails of the normal law, of the least of the strongest k
    held = replace(found, z=np.clip(found.z, -STRONGEST_Z, STRONGEST_Z))
    sums = [
        np.sort(np.abs(smoothed_deviations(one, s)[0][:, 103, 103]))[-min_images]
        for s, one in zip(SCALES_PX, (found, held, held), strict=True)
    ]
    expected = -(np.log(math.comb(4, min_images)) + min_images * (np.log(2) + special.log_ndtr(-max(sums)))) / np.log(
        10
    )
    assert score[103, 103] == pytest.approx(expected, rel=1e-3)


def test_a_glint_on_a_dark_field_counts_beside_the_images_that_are_lit():
    high = threshold(0.05, 200 * 240, len(SCALES_PX))

    def score(lit_images, shows_in):
        found = noise(4)
        found.lit[lit_images:] = False
        found.z[lit_images:] = 0  # as in the dead zone of dark pixels
        found.z[shows_in, 100:106, 100:106] += 6
        return score_deviations(found, min_images=2)[103, 103]

    # none is lit: one glint is enough; one is: the glint or what the lit image shows; two: any two
    assert score(0, [3]) > high
    assert score(1, [3]) > high
    assert score(1, [0]) > high
    assert score(2, [3]) < high
    assert score(2, [1]) < high
    assert score(2, [1, 3]) > high


def test_a_defect_in_one_image_alone_does_not_count_unless_one_is_enough():
    found = noise(4)
    found.z[2, 100:106, 100:106] += 6
    once, twice = (score_deviations(found, min_images=k)[103, 103] for k in (1, 2))
    high = threshold(0.05, 200 * 240, len(SCALES_PX))
    assert once > high > twice
    found.z[0, 100:106, 100:106] -= 6
    assert score_deviations(found, min_images=2)[103, 103] > high


def test_a_strong_spot_makes_no_alarm_beyond_its_outline():
    found = noise(4, seed=3)
    found.z[0, 100, 120:122] = -400.0
    y, x = np.mgrid[:200, :240]
    apart = np.hypot(y - 100, x - 120.5)
    # as beside a highlight: between the spot and what can be judged nothing can
    found.usable[0][(apart > 2.0) & (apart < 6.0)] = False
    found.z[~found.usable] = 0.0
    score = score_deviations(found, min_images=1)
    high = threshold(0.05, score.size, len(SCALES_PX))
    assert score[100, 120] > 100.0
    assert score[apart > 6.0].max() < high
    # what is faint and wide is found by the wide sums as before
    found = noise(4, seed=3)
    found.z[0][apart < 8.0] += 1.2
    assert score_deviations(found, min_images=1)[100, 120] > high


def test_no_image_no_score():
    found = noise(3)
    found.usable[:, 20:60, 20:60] = False
    assert (score_deviations(found, min_images=2)[20:60, 20:60] == 0).all()


def test_regions_reach_down_to_half_the_threshold_and_bridge_gaps():
    score = np.zeros((40, 60), np.float32)
    score[10:14, 10:14] = 8
    score[10:14, 14:18] = 5
    score[10:14, 20:22] = 5  # two pixels off: the same
    score[30:33, 30:33] = 6  # never certain
    score[10:12, 40:42] = 9  # another
    labels, count = find_regions(score, 8.0)
    assert count == 2
    assert (labels[10:14, 10:18] == labels[10, 10]).all()
    assert (labels[10:14, 20:22] == labels[10, 10]).all()
    assert (labels[30:33, 30:33] == 0).all()
    assert labels[10, 40] not in (0, labels[10, 10])
    assert (labels[:, 18:20] == 0).all()


def detection(position, *, length=1.0, rotation=0.0, normal=(0.0, 0.0, 1.0), score=10.0, contrast=-0.2):
    """A region `length` mm long in x and 1 mm wide in y."""
    x, y = np.meshgrid(np.arange(-length / 2, length / 2 + 0.05, 0.1), np.arange(-0.5, 0.55, 0.1))
    points = np.array(position) + np.stack([x.ravel(), y.ravel(), 0.0 * x.ravel()], axis=1)
    return Detection(
        posture=Posture(elevation_deg=0.0, rotation_deg=rotation),
        pixels=len(points),
        centre_px=(5.0, 5.0),
        box_px=(3, 3, 6, 6),
        position=position,
        normal=normal,
        size=(max(length, 1.0), min(length, 1.0)),
        area=length,
        score=score,
        contrast={"light1": contrast},
        kind="unknown",
        points=points,
    )


def test_the_same_place_in_several_postures_is_one_defect():
    first = detection((1.0, 2.0, 3.0))
    again = detection((1.3, 2.1, 3.0), rotation=90.0, score=20.0)
    other_side = detection((1.0, 2.0, 2.6), rotation=180.0, normal=(0.0, 0.0, -1.0))
    beside = detection((9.0, 2.0, 3.0), score=5.0)
    defects = merge_detections([first, again, other_side, beside])
    assert [len(d.detections) for d in defects] == [2, 1, 1]
    assert defects[0].best is again
    assert [d.number for d in defects] == [1, 2, 3]


@pytest.mark.parametrize("score", [5.0, 15.0])
def test_two_regions_of_a_posture_stay_two_whatever_another_posture_shows_of_both(score):
    first = detection((1.0, 2.0, 3.0))
    beside = detection((2.6, 2.0, 3.0), score=score)
    between = detection((1.7, 2.0, 3.0), rotation=90.0, score=20.0)
    assert len(merge_detections([first, beside])) == 2
    assert sorted(len(d.detections) for d in merge_detections([first, beside, between])) == [1, 2]


def test_long_defects_side_by_side_are_as_many_as_there_are():
    ours = [detection((0.0, y, 3.0), length=8.0) for y in (0.0, 5.0)]
    theirs = [detection((0.3, y, 3.0), length=8.0, rotation=90.0, score=12.0) for y in (0.2, 5.2)]
    pairs = merge_detections([*ours, *theirs])
    assert [{s.posture.rotation_deg for s in d.detections} for d in pairs] == [{0.0, 90.0}] * 2
    for defect in pairs:
        assert abs(defect.detections[0].position[1] - defect.detections[1].position[1]) < 1.0
    assert len(merge_detections([ours[0], theirs[1]])) == 2  # 4.2 mm between them
    assert len(merge_detections([detection((-5.0, 0.0, 3.0), length=8.0), theirs[0]])) == 1  # ends overlap


def test_a_defect_is_as_large_and_as_strong_as_any_posture_shows_it():
    surest = detection((1.0, 2.0, 3.0), score=20.0, contrast=0.05)
    longest = detection((1.2, 2.0, 3.0), length=3.0, rotation=90.0, contrast=-0.1)
    strongest = detection((1.1, 2.0, 3.0), length=0.8, rotation=180.0, score=5.0, contrast=-0.4)
    (defect,) = merge_detections([surest, longest, strongest])
    assert defect.best is surest
    assert (defect.size, defect.area, defect.greatest_contrast) == ((3.0, 1.0), 3.0, 0.4)
    reported = defect.as_dict()
    assert (reported["size_mm"], reported["area_mm2"], reported["greatest_contrast"]) == ([3.0, 1.0], 3.0, 0.4)
    surface = SurfaceCoverage(area=9.0, seen=5.0, inspected=4.0, saturated=0.0, shadow=0.0, edge=1.0, sensitivity={})
    result = InspectionResult(
        defects=(defect,), postures=(), placement=None, warnings=(), nominal=None, surface=surface
    )
    assert judge(result, InspectionConfig()).inspected == 0.8
    assert judge(result, InspectionConfig(least_size_mm=2.5, least_contrast=0.3)).counting == (1,)
    assert judge(result, InspectionConfig(least_size_mm=3.5)).counting == ()
    assert judge(result, InspectionConfig(least_contrast=0.5)).counting == ()


def test_templates_answer_to_no_even_image_and_are_of_one_size():
    for template in templates():
        assert abs(template.sum()) < 1e-9
        assert np.sum(template**2) == pytest.approx(1.0)
        assert template.shape[0] % 2 == 1


def test_places_go_back_to_the_file_through_posture_placement_and_anchor(shared_bench):
    from lightopt import build_scene
    from lightopt.estimate.registration import place_part
    from lightopt.inspection.prediction._registered_set import world_to_mesh_file
    from lightopt.scene import view_from_part

    bench = shared_bench.part.with_name("turned.yaml")
    text = shared_bench.part.read_text(encoding="utf-8")
    bench.write_text(text.replace("[0, 0, 0]", "[3, -2, 1], rotate_deg: [4, -7, 30]"), encoding="utf-8")
    scene = build_scene(shared_bench.rig, bench)
    posture, placement = Posture(-10.0, 170.0), Placement(x=0.7, y=-0.4, turn=0.02)
    view = view_from_part(scene, posture)
    placed = place_part(scene, placement).mesh
    world = placed.vertices[::50] @ view.rotation.T + view.translation
    own = np.array([scene.placement.to_file(v) for v in scene.mesh.vertices[::50]])
    assert np.allclose(world_to_mesh_file(world, scene, placement, posture), own, atol=1e-4)
    assert placed.normals is not None
    assert scene.mesh.normals is not None
    turned = placed.normals[::50] @ view.rotation.T
    expected = scene.mesh.normals[::50] @ scene.placement.rotation
    assert np.allclose(world_to_mesh_file(turned, scene, placement, posture, direction=True), expected, atol=1e-4)


def test_the_pixels_of_regions_are_those_of_their_numbers():
    from lightopt.inspection.detection._regions import region_pixels

    labels = np.array([[0, 2, 2], [3, 0, 2], [1, 3, 0]], np.int32)
    for number, (row, column) in enumerate(region_pixels(labels, 3), start=1):
        assert np.array_equal(np.stack([row, column]), np.stack(np.nonzero(labels == number)))
    assert region_pixels(np.zeros((2, 2), np.int32), 0) == []


def strewn(*spots, lights=4):
    """Deviations with discs of 9 px: light, row, column and height of each."""
    found = noise(lights)
    y, x = np.mgrid[:200, :240]
    for light, row, column, height in spots:
        found.z[light][np.hypot(y - row, x - column) <= 4.5] += height
    score = score_deviations(found, min_images=1)
    high = threshold(0.05, 200 * 240, len(SCALES_PX))
    return (*split_regions(*find_regions(score, high), score, found, high), found)


def test_neighbours_that_wide_sums_join_are_two_defects():
    labels, count, _ = strewn((0, 100, 100, 12), (1, 100, 120, 12))
    assert count == 2
    assert labels[100, 100] != labels[100, 120]
    assert labels[100, 100] > 0 < labels[100, 120]
    # a weak one beside a strong one, too
    labels, count, _ = strewn((0, 100, 100, 40), (1, 100, 120, 8))
    assert (count, labels[100, 120] > 0) == (2, True)


def test_walls_across_from_each_other_are_one_defect_with_both_walls():
    # the glint of one wall is ten times as strong as what the other loses
    labels, count, found = strewn((0, 100, 100, 60), (0, 100, 111, -6))
    assert count == 1
    core = core_pixels(labels == 1, box_sums(found, (slice(0, 200), slice(0, 240)))[0])
    assert core[100, 100]
    assert core[100, 111]
    assert core.sum() == pytest.approx(2 * 69, rel=0.35)


def test_what_is_near_is_scipys_dilation_by_a_disc():
    from scipy import ndimage

    from lightopt.inspection.detection._regions import DISC, GAP_PX, _dilated

    mask = np.random.default_rng(5).random((40, 31)) < 0.03
    assert np.array_equal(_dilated(mask), ndimage.binary_dilation(np.pad(mask, GAP_PX), DISC))
