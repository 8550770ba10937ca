"""Planned defects, their units of evidence, and why some of them are not found."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.defects import BUILT_IN_CATALOGUE, CatalogueEntry, DefectShape
from lightopt.design import (
    BlindReason,
    DetectabilityObjective,
    LevelThresholds,
    LuminanceMatrix,
    blind_text,
    planned_catalogue,
)
from lightopt.design._blind_spots import blind_spots, by_light, defect_visibility
from lightopt.design.responses._evidence import spare_units
from lightopt.design.responses._luminance_matrix import Visibility
from lightopt.optics import Sensor

THRESHOLDS = LevelThresholds(shade=10, saturation=255, black=2)


def dent(slope_deg, name="dent"):
    return CatalogueEntry(name, DefectShape(kind="dent", length=2.0, width=2.0, slope=math.radians(slope_deg)))


def pack(flags):
    """Flags (…, t) as words (…, w), bit t % 64 of word t // 64."""
    flags = np.asarray(flags, bool)
    words = np.zeros((*flags.shape[:-1], -(-flags.shape[-1] // 64)), np.uint64)
    for t in range(flags.shape[-1]):
        words[..., t // 64] |= flags[..., t].astype(np.uint64) << np.uint64(t % 64)
    return words


def pack_units(units):
    """Units of evidence (…, p, t) up to 3 as flags (…, 3, p, w)."""
    units = np.asarray(units, int)
    return np.stack([pack(units > j) for j in range(3)], axis=-3)


def visibility_of(units, defects, count, *, patch=None, grazing=()):
    return Visibility(
        defects=defects,
        words=tuple(pack_units(layer) for layer in units),
        patch=np.arange(count, dtype=np.int32) if patch is None else np.asarray(patch, np.int32),
        grazing=np.array(grazing, np.int32),
    )


def planned(*catalogue):
    return planned_catalogue(catalogue).defects


def test_long_defects_are_planned_in_all_orientations_and_each_entry_weighs_the_same():
    defects = planned(*BUILT_IN_CATALOGUE)
    assert len(defects) == 8 + 6
    for entry in BUILT_IN_CATALOGUE:
        assert sum(defect.weight for defect in defects if defect.name == entry.name) == 8
    scratch = [defect.turn for defect in defects if defect.name == "scratch"]
    np.testing.assert_allclose(np.degrees(scratch), np.arange(8) * 22.5)
    assert [(defect.name, defect.turn) for defect in defects[-2:]] == [("stain", None), ("haze", None)]


def test_ranges_are_planned_in_steps_of_equal_ratio_and_weigh_as_one_kind():
    ranged = CatalogueEntry("dent", dent(2.0).shape, sizes=(0.5, 4.0), slopes=(0.5, 2.0))
    found = planned_catalogue((ranged, dent(3.0, name="other")))
    sizes = sorted({round(own.shapes[1].length, 6) for own in found.entries[:-1]})
    # from 0.6 times the least to 1.6 times the greatest
    assert len(sizes) == 3
    assert sizes[0] * 0.6 <= 1.0
    assert sizes[-1] * 1.6 >= 8.0
    assert all(b / a <= 1.6 / 0.6 + 1e-9 for a, b in itertools.pairwise(sizes))
    slopes = sorted({round(math.degrees(own.entry.shape.slope), 6) for own in found.entries[:-1]})
    np.testing.assert_allclose(slopes, 2.0 * 2.0 ** np.array([-2 / 3, 0, 2 / 3]), atol=1e-5)
    weights = {name: sum(d.weight for d in found.defects if d.name == name) for name in ("dent", "other")}
    assert weights["dent"] == weights["other"]
    # inspections find a slope from the amplitude
    assert [one.shape.length for one in ranged.in_sizes()] == pytest.approx(sizes)


@pytest.mark.parametrize(
    ("catalogue", "found"),
    [
        ((), "at least one kind of defect"),
        ((dent(0.0),), "slope above 0° up to 60°, found 0°"),
        ((dent(61.0),), "slope above 0° up to 60°, found 61°"),
        ((dent(3.0),) * 1025, "are 1025 hypotheses, more than 1024"),
    ],
)
def test_what_cannot_be_planned_for_is_refused(catalogue, found):
    with pytest.raises(InputError, match=found):
        planned_catalogue(catalogue)


def test_counts_and_weights_are_those_of_the_units():
    rng = np.random.default_rng(0)
    scratches = [
        CatalogueEntry(f"scratch {k}", DefectShape(kind="scratch", length=5, width=0.2, slope=0.1)) for k in range(9)
    ]
    stain = CatalogueEntry("stain", DefectShape(kind="stain", length=1, width=1, R_d_factor=0.5))
    defects = planned(*scratches, stain)
    sizes, patches = (3, 2, 4), 17
    units = [rng.integers(0, 4, (size, patches, len(defects))) for size in sizes]
    some = visibility_of(units, defects, patches)
    assert some.words[0].shape == (3, 3, patches, 2)
    weights = np.array([defect.weight for defect in defects])
    for needed in (1, 3, 4, 8):
        chosen = (2, 0, 3)
        counts = sum(layer[k] for layer, k in zip(units, chosen, strict=True))
        found = some.rows([np.array([k]) for k in chosen]).most_units(needed)[-1]
        np.testing.assert_array_equal(found, pack(counts >= needed))
        np.testing.assert_array_equal(some.weights(found), (counts >= needed) @ weights)
        most = sum(layer.max(axis=0) for layer in units)
        np.testing.assert_array_equal(some.most_units(needed)[-1], pack(most >= needed))
    assert weights.sum() == 80


EIGHT = planned(*(dent(1.0 + k, f"dent {k}") for k in range(8)))


def test_reasons_are_those_that_stand_in_between():
    # patches: found by both; two images, no contrast; one dark; one saturated; one dark and one saturated
    levels = (np.array([[90, 90, 2, 255, 255]], np.uint8), np.array([[90, 90, 90, 90, 2]], np.uint8))
    units = [np.zeros((1, 5, 8), int) for _ in levels]
    for layer in units:
        layer[0, 0] = 2
        layer[0, 1, :3] = 2
    some = visibility_of(units, EIGHT, 5, patch=[1, 2, 3, 4, 5], grazing=[7])
    matrix = LuminanceMatrix(levels=levels, areas=np.ones(5), visibility=some)
    areas = np.array([3, 1, 1, 1, 1, 1, 0, 2.0])
    found = blind_spots(areas, [defect_visibility(by_light([matrix]), THRESHOLDS, least=2)])
    expected = [
        BlindReason.SEEN,
        BlindReason.CONTRAST,
        BlindReason.SHADOWED,
        BlindReason.SATURATED,
        BlindReason.SHADOWED,
    ]
    assert found.codes.tolist() == [BlindReason.CAMERA, *expected, BlindReason.CAMERA, BlindReason.GRAZING]
    # what is seen at a grazing angle, 2 of 10, is in no share
    assert found.left_out == pytest.approx(0.2)
    assert found.seen == pytest.approx((1 + 3 / 8) / 8)
    reasons = found.by_reason()
    assert reasons == pytest.approx({1: 0.375, 3: 0.25, 4: 0.078125, 5: 0.125})
    assert found.seen + sum(reasons.values()) == pytest.approx(1.0)
    one = blind_spots(areas, [defect_visibility(by_light([matrix]), THRESHOLDS, least=1)])
    assert one.codes[5] == BlindReason.SATURATED
    assert blind_text(BlindReason.SATURATED + 1, ["left", "right"]) == "saturated by right"
    # light by light it is the same
    parts = [
        LuminanceMatrix(
            levels=levels[k : k + 1],
            areas=np.ones(5),
            visibility=visibility_of(units[k : k + 1], EIGHT, 5, patch=some.patch, grazing=some.grazing),
        )
        for k in (0, 1)
    ]
    again = blind_spots(areas, [defect_visibility((iter([(one, 0)]) for one in parts), THRESHOLDS, least=2)])
    assert again.codes.tolist() == found.codes.tolist()
    assert again.share.tolist() == found.share.tolist()


def matrix_with(units, levels):
    """A matrix of one patch."""
    return LuminanceMatrix(levels=levels, areas=np.ones(1), visibility=visibility_of(units, EIGHT, 1))


def test_all_positions_count_each_for_itself_and_postures_complete_each_other():
    levels = (np.array([[255], [60]], np.uint8), np.array([[2], [2]], np.uint8))
    units = [np.zeros((2, 1, 8), int) for _ in levels]
    units[0][0, 0, :4] = 3
    units[0][1, 0, 4:6] = 3
    first = defect_visibility(by_light([matrix_with(units, levels)]), THRESHOLDS, least=1)
    alone = blind_spots(np.ones(1), [first])
    assert alone.codes.tolist() == [BlindReason.CONTRAST]
    assert alone.seen == 6 / 8
    units = [layer.copy() for layer in units]
    units[1][1, 0, 6:] = 3
    both = matrix_with([units[1], units[1]], levels).combination((1, 1))
    other = defect_visibility(by_light([both]), THRESHOLDS, least=1)
    together = blind_spots(np.ones(1), [first, other])
    assert together.codes.tolist() == [BlindReason.SEEN]
    assert together.seen == 1.0
    assert blind_spots(np.ones(2), []).codes.tolist() == [BlindReason.CAMERA, BlindReason.CAMERA]


def test_images_of_other_postures_confirm_and_other_exposures_of_a_light_do_not():
    units = [np.zeros((1, 1, 8), int) for _ in range(2)]
    units[0][0, 0] = 3
    levels = (np.array([[60]], np.uint8), np.array([[2]], np.uint8))
    matrix = matrix_with(units, levels)
    once = defect_visibility(by_light([matrix]), THRESHOLDS, least=2)
    assert blind_spots(np.ones(1), [once]).seen == 0.0
    # the same image at another exposure shows the same defects: still one image
    assert blind_spots(np.ones(1), [defect_visibility(by_light([matrix, matrix]), THRESHOLDS, least=2)]).seen == 0.0
    # the image of another posture is a second one
    assert blind_spots(np.ones(1), [once, once]).codes.tolist() == [BlindReason.SEEN]
    # an exposure that saturates nothing takes the glare away
    bright = matrix_with(units, (np.array([[255]], np.uint8), np.array([[255]], np.uint8)))
    dim = matrix_with(units, (np.array([[60]], np.uint8), np.array([[60]], np.uint8)))
    glare = blind_spots(np.ones(1), [defect_visibility(by_light([bright]), THRESHOLDS, least=2)])
    assert glare.codes.tolist() == [BlindReason.SATURATED]
    mended = blind_spots(np.ones(1), [defect_visibility(by_light([bright, dim]), THRESHOLDS, least=2)])
    assert mended.codes.tolist() == [BlindReason.CONTRAST]


def test_fewer_images_decide_where_fewer_are_lit():
    """Of three patches the first is lit in two images, the second in one, the third in none; two must show a defect."""
    sensor = Sensor(bit_depth=8, read_noise_levels=1.0)
    levels = [np.array([[200, 200, 1]], np.uint8), np.array([[50, 1, 1], [50, 1, 2]], np.uint8)]
    spare = spare_units(levels, sensor, 2)
    assert spare.tolist() == [0, 1, 1]
    assert spare_units(levels, sensor, 1) is None
    # saturated images show as little as dark ones
    assert spare_units([levels[0], np.array([[255, 1, 1]], np.uint8)], sensor, 2).tolist() == [1, 1, 1]
    assert spare_units(levels, sensor, 3).tolist() == [4, 5, 5]
    defects = planned(dent(2.0))
    units = [np.array([[[3], [3], [3]]]), np.array([[[0], [0], [0]], [[0], [0], [0]]])]
    visibility = replace(visibility_of(units, defects, 3), spare=spare)
    goal = DetectabilityObjective(defects, min_images=2)
    matrix = LuminanceMatrix(levels=tuple(levels), areas=np.ones(3), visibility=visibility)
    weights = np.array([1, 10, 100], np.int64)
    each = defects[0].weight
    assert goal.bound(matrix, weights, THRESHOLDS) == 110 * each
    assert goal.scores(matrix, weights, THRESHOLDS, 1, None).tolist() == [110 * each, 110 * each]
    assert goal.score(matrix.combination((0, 1)), weights, THRESHOLDS) == 110 * each
    assert replace(visibility, spare=None).most_units(goal.needed)[-1].any() == 0
    alone = defect_visibility(by_light([matrix]), THRESHOLDS, least=2)
    assert blind_spots(np.ones(3), [alone]).share.tolist() == [0.0, 1.0, 1.0]
    # images of several postures add up: which of them light a patch is not known
    assert (
        blind_spots(np.ones(3), [alone, replace(alone, counts=np.zeros_like(alone.counts))]).share.tolist() == [0.0] * 3
    )
