"""Trials, their bits, and why some of them are not seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lightopt.core.errors import InputError
from lightopt.defects import BUILT_IN_CATALOGUE, CatalogueEntry, DefectShape
from lightopt.design import BlindReason, LevelThresholds, LuminanceMatrix, Visibility, blind_text, defect_hypotheses
from lightopt.design.blind_spots._blind_spots import blind_spots, by_light, defect_visibility

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


def visibility_of(flags, trials, areas, *, patch=None, grazing=()):
    count = len(areas)
    return Visibility(
        hypotheses=trials,
        words=tuple(pack(layer) for layer in flags),
        areas=np.asarray(areas, float),
        patch=np.arange(count, dtype=np.int32) if patch is None else np.asarray(patch, np.int32),
        grazing=np.array(grazing, np.int32),
    )


def test_built_in_catalogue_unrolls_to_walls_all_around_and_each_entry_weighs_the_same():
    trials = defect_hypotheses(BUILT_IN_CATALOGUE)
    assert len(trials) == 5 * 8 + 2
    for entry in BUILT_IN_CATALOGUE:
        own = [trial for trial in trials if trial.name == entry.name]
        assert sum(trial.weight for trial in own) == 8
        assert {trial.slope for trial in own} == {entry.shape.slope}
    scratch = [trial.direction for trial in trials if trial.name == "scratch"]
    np.testing.assert_allclose(np.degrees(scratch), np.arange(8) * 45.0)
    assert (trials[0].name, round(np.degrees(trials[0].slope)), trials[0].direction) == ("scratch", 4, 0.0)
    assert [(trial.name, trial.slope) for trial in trials[-2:]] == [("stain", 0.0), ("haze", 0.0)]


@pytest.mark.parametrize(
    ("catalogue", "directions", "found"),
    [
        ((), 8, "at least one kind of defect"),
        ((dent(0.0),), 8, "slope above 0° up to 60°, found 0°"),
        ((dent(61.0),), 8, "slope above 0° up to 60°, found 61°"),
        ((dent(3.0),), 7, "expected an even number, 8 or more, found 7"),
        ((dent(3.0),), 9, "expected an even number, 8 or more, found 9"),
        ((dent(3.0),), 1026, "are 1026 trials, more than 1024"),
    ],
)
def test_what_cannot_be_planned_for_is_refused(catalogue, directions, found):
    with pytest.raises(InputError, match=found):
        defect_hypotheses(catalogue, directions=directions)


def test_counts_and_weights_are_those_of_the_flags():
    rng = np.random.default_rng(0)
    catalogue = [dent(1.0 + k, f"dent {k}") for k in range(9)]
    catalogue.append(CatalogueEntry("stain", DefectShape(kind="stain", length=1, width=1, R_d_factor=0.5)))
    trials = defect_hypotheses(catalogue)
    sizes, patches = (3, 2, 4), 17
    flags = [rng.random((size, patches, len(trials))) < 0.4 for size in sizes]
    some = visibility_of(flags, trials, rng.random(patches))
    assert some.words[0].shape == (3, patches, 2)
    weights = np.array([trial.weight for trial in trials])
    for least in (1, 2, 3):
        chosen = (2, 0, 3)
        counts = sum(layer[k].astype(int) for layer, k in zip(flags, chosen, strict=True))
        seen = some.rows([np.array([k]) for k in chosen]).reachable(least)
        np.testing.assert_array_equal(seen, pack(counts >= least))
        np.testing.assert_array_equal(some.weights(seen), (counts >= least) @ weights)
        union = sum(layer.any(axis=0).astype(int) for layer in flags)
        np.testing.assert_array_equal(some.reachable(least), pack(union >= least))
    assert some.total_weight == weights.sum() == 80


def test_visibility_of_other_images_is_refused():
    trials = defect_hypotheses([dent(2.0)])
    some = visibility_of([np.ones((2, 3, 8)), np.ones((1, 3, 8))], trials, np.ones(3))
    levels = tuple(np.zeros((size, 3), np.uint8) for size in (2, 1))
    assert LuminanceMatrix(levels=levels, areas=np.ones(3), visibility=some).visibility is some
    with pytest.raises(InputError, match="expected the visibility of the same images"):
        LuminanceMatrix(levels=levels[::-1], areas=np.ones(3), visibility=some)
    with pytest.raises(InputError, match="light 0: expected uint64"):
        visibility_of([np.ones((2, 4, 8))], trials, np.ones(3))


def test_reasons_are_those_that_stand_in_between():
    trials = defect_hypotheses([dent(2.0)])
    # patches: seen in both; two images, no contrast; one dark; one saturated; one dark and one saturated
    levels = (np.array([[90, 90, 2, 255, 255]], np.uint8), np.array([[90, 90, 90, 90, 2]], np.uint8))
    flags = [np.zeros((1, 5, 8), bool) for _ in levels]
    for layer in flags:
        layer[0, 0] = True
        layer[0, 1, :3] = True
    some = visibility_of(flags, trials, [1, 1, 1, 1, 1], patch=[1, 2, 3, 4, 5], grazing=[7])
    matrix = LuminanceMatrix(levels=levels, areas=some.areas, visibility=some)
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
            areas=some.areas,
            visibility=visibility_of(flags[k : k + 1], trials, some.areas, patch=some.patch, grazing=some.grazing),
        )
        for k in (0, 1)
    ]
    again = blind_spots(areas, [defect_visibility((iter([(one, 0)]) for one in parts), THRESHOLDS, least=2)])
    assert again.codes.tolist() == found.codes.tolist()
    assert again.share.tolist() == found.share.tolist()


def matrix_with(flags, levels, trials):
    """A matrix of one patch."""
    return LuminanceMatrix(levels=levels, areas=np.ones(1), visibility=visibility_of(flags, trials, np.ones(1)))


def test_all_positions_count_each_for_itself_and_postures_complete_each_other():
    trials = defect_hypotheses([dent(2.0)])
    levels = (np.array([[255], [60]], np.uint8), np.array([[2], [2]], np.uint8))
    flags = [np.zeros((2, 1, 8), bool) for _ in levels]
    flags[0][0, 0, :4] = True
    flags[0][1, 0, 4:6] = True
    first = defect_visibility(by_light([matrix_with(flags, levels, trials)]), THRESHOLDS, least=1)
    alone = blind_spots(np.ones(1), [first])
    assert alone.codes.tolist() == [BlindReason.CONTRAST]
    assert alone.seen == 6 / 8
    flags = [layer.copy() for layer in flags]
    flags[1][1, 0, 6:] = True
    both = matrix_with([flags[1], flags[1]], levels, trials).combination((1, 1))
    other = defect_visibility(by_light([both]), THRESHOLDS, least=1)
    together = blind_spots(np.ones(1), [first, other])
    assert together.codes.tolist() == [BlindReason.SEEN]
    assert together.seen == 1.0
    assert blind_spots(np.ones(2), []).codes.tolist() == [BlindReason.CAMERA, BlindReason.CAMERA]


def test_images_of_other_postures_confirm_and_other_exposures_of_a_light_do_not():
    trials = defect_hypotheses([dent(2.0)])
    flags = [np.zeros((1, 1, 8), bool) for _ in range(2)]
    flags[0][0, 0] = True
    levels = (np.array([[60]], np.uint8), np.array([[2]], np.uint8))
    matrix = matrix_with(flags, levels, trials)
    once = defect_visibility(by_light([matrix]), THRESHOLDS, least=2)
    assert blind_spots(np.ones(1), [once]).seen == 0.0
    # the same image at another exposure shows the same trials: still one image
    assert blind_spots(np.ones(1), [defect_visibility(by_light([matrix, matrix]), THRESHOLDS, least=2)]).seen == 0.0
    # the image of another posture is a second one
    assert blind_spots(np.ones(1), [once, once]).codes.tolist() == [BlindReason.SEEN]
    # an exposure that saturates nothing takes the glare away
    bright = matrix_with(flags, (np.array([[255]], np.uint8), np.array([[255]], np.uint8)), trials)
    dim = matrix_with(flags, (np.array([[60]], np.uint8), np.array([[60]], np.uint8)), trials)
    glare = blind_spots(np.ones(1), [defect_visibility(by_light([bright]), THRESHOLDS, least=2)])
    assert glare.codes.tolist() == [BlindReason.SATURATED]
    mended = blind_spots(np.ones(1), [defect_visibility(by_light([bright, dim]), THRESHOLDS, least=2)])
    assert mended.codes.tolist() == [BlindReason.CONTRAST]
