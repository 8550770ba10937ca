"""The search for detectability gives what trying every combination plainly gives, to the last digit of the count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from reference._search import all_combinations, detectability_value
from test_design_visibility import visibility_of

from lightopt.defects import BUILT_IN_CATALOGUE
from lightopt.design import (
    DetectabilityObjective,
    LevelThresholds,
    LuminanceMatrix,
    area_units,
    planned_catalogue,
    search,
)
from lightopt.design.objectives import _scores_by_units as unit_sums
from lightopt.design.responses._pairs import PlannedDefect

THRESHOLDS = LevelThresholds(shade=10, saturation=255)


def trials_of(weights):
    """Trials that differ in their weights alone."""
    return tuple(PlannedDefect(name=f"trial {k}", weight=weight) for k, weight in enumerate(weights))


def matrix_of(flags, trials, areas, levels):
    return LuminanceMatrix(
        levels=levels, areas=np.asarray(areas, float), visibility=visibility_of(flags, trials, len(areas))
    )


def random_matrix(rng, sizes, patches, trials, *, share=0.4, smooth=False):
    flags = []
    for size in sizes:
        layer = rng.integers(1, 4, (size, patches, len(trials))) * (rng.random((size, patches, len(trials))) < share)
        if smooth:
            # each trial is visible in one run of candidates, if at all
            a, b = np.sort(rng.integers(0, size + 1, (2, patches, len(trials))), axis=0)
            place = np.arange(size)[:, None, None]
            layer = ((place >= a) & (place < b)) * rng.integers(1, 4, (1, patches, len(trials)))
        flags.append(layer)
    levels = tuple(rng.choice([0, 20, 100, 255], (size, patches)).astype(np.uint8) for size in sizes)
    return flags, matrix_of(flags, trials, rng.random(patches) * 1e-3, levels)


def plain(flags, matrix, trials, needed):
    """All combinations, best first, as the reference has them."""
    areas = area_units(matrix.areas)
    weights = [trial.weight for trial in trials]
    # what is scored is not a level: the value is looked up by the combination
    index = [np.arange(len(layer))[:, None] for layer in flags]

    def value(columns):
        images = [layer[int(i)] for layer, (i,) in zip(flags, columns, strict=True)]
        return detectability_value(images, areas, weights, needed)

    ranked = all_combinations(index, value, 0, 0, 0)
    usable = [
        (np.where((layer >= 10) & (layer < 255), layer, 0).astype(np.int64) * areas).sum(axis=1)
        for layer in matrix.levels
    ]
    return sorted(
        (value, -sum(int(own[i]) for own, i in zip(usable, combination, strict=True)), combination)
        for value, _, combination in ranked
    )


def as_tuples(found):
    return [r.sort_key for r in found.ranking]


@given(data=st.data())
def test_plain_reading_of_any_small_matrix(data):
    """Ties, lights with one candidate, two to six lights, any weights: ranking, ties, runner-up and bound."""
    lights = data.draw(st.integers(2, 6))
    sizes = data.draw(st.lists(st.integers(1, 3), min_size=lights, max_size=lights))
    patches = data.draw(st.integers(1, 4))
    weights = data.draw(st.lists(st.integers(1, 9), min_size=1, max_size=4))
    min_images = data.draw(st.integers(1, min(3, lights)))
    trials = trials_of(weights)
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    flags = [
        rng.integers(0, 4, (size, patches, len(trials)))
        * (rng.random((size, patches, len(trials))) < data.draw(st.sampled_from([0.0, 0.3, 0.8, 1.0])))
        for size in sizes
    ]
    areas = rng.integers(0, 4, patches) * 1e-6
    levels = tuple(rng.choice([0, 30, 255], (size, patches)).astype(np.uint8) for size in sizes)
    matrix = matrix_of(flags, trials, areas, levels)
    objective = DetectabilityObjective(trials, min_images)
    expected = plain(flags, matrix, trials, objective.needed)
    found = search([matrix], objective, THRESHOLDS, keep=1000)
    assert as_tuples(found) == expected
    assert found.ties == sum(value == expected[0][0] for value, _, _ in expected) - 1
    # taken in small boxes, with bounds, the same
    cells = data.draw(st.integers(1, 6))
    boxed = search([matrix], objective, THRESHOLDS, keep=2, table_cells=cells)
    assert as_tuples(boxed) == as_tuples(found)[:2]
    assert (boxed.ties, boxed.bound, boxed.left) == (found.ties, found.bound, 0)


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("sizes", [(6, 5), (4, 1, 5, 3), (2, 3, 2, 1, 2, 2)])
@pytest.mark.parametrize("min_images", [1, 2, 3])
def test_built_in_catalogue_and_more_trials_than_a_word_has_bits(sizes, min_images, smooth):
    rng = np.random.default_rng(min_images)
    for trials in (planned_catalogue(BUILT_IN_CATALOGUE).defects, trials_of(rng.integers(1, 40, 150).tolist())):
        flags, matrix = random_matrix(rng, sizes, 9, trials, smooth=smooth)
        objective = DetectabilityObjective(trials, min_images)
        if objective.refusal(len(sizes)):
            continue
        weights = objective.weights(matrix.areas)
        scores = objective.scores(matrix, weights, THRESHOLDS, 2, None)
        places = list(np.ndindex(*sizes))
        some = rng.choice(len(places), 12, replace=False)
        for k in some:
            images = [layer[i] for layer, i in zip(flags, places[k], strict=True)]
            expected = detectability_value(images, weights, [trial.weight for trial in trials], objective.needed)
            assert scores[k] == expected
            assert objective.score(matrix.combination(places[k]), weights, THRESHOLDS) == expected
        assert scores.max() <= objective.bound(matrix, weights, THRESHOLDS)


@pytest.mark.parametrize("min_images", [1, 2, 4])
def test_plain_sums_take_over_where_units_change_everywhere_and_agree(monkeypatch, min_images):
    rng = np.random.default_rng(3)
    trials = trials_of(rng.integers(1, 9, 70).tolist())
    _, matrix = random_matrix(rng, (7, 1, 6, 5), 40, trials)
    objective = DetectabilityObjective(trials, min_images)
    weights = objective.weights(matrix.areas)
    whole = objective.scores(matrix, weights, THRESHOLDS, 2, None)
    shares: list[float] = []
    for most, patches, words in ((1 << 10, 7, 1 << 27), (40, 40, 1 << 12), (1, 3, 1 << 12)):
        monkeypatch.setattr(unit_sums, "LEAST_NODES", 1)
        monkeypatch.setattr(unit_sums, "MOST_NODES", most)
        monkeypatch.setattr(unit_sums, "CHUNK_PATCHES", patches)
        monkeypatch.setattr(unit_sums, "TASK_WORDS", words)
        shares.clear()
        again = objective.scores(matrix, weights, THRESHOLDS, 3, shares.append)
        np.testing.assert_array_equal(again, whole)
        assert shares == sorted(shares)
        assert shares[-1] <= 1.0


def test_details_name_what_is_worst():
    trials = planned_catalogue(BUILT_IN_CATALOGUE).defects
    flags = [np.full((1, 2, len(trials)), 3), np.zeros((1, 2, len(trials)), int)]
    flags[0][0, 0, 8] = 0  # dents on the first patch
    flags[0][0, :, 3] = 0  # scratches along 67.5°
    areas = np.array([3.0, 1.0])
    levels = (np.zeros((1, 2), np.uint8),) * 2
    matrix = matrix_of(flags, trials, areas, levels)
    objective = DetectabilityObjective(trials)
    facts = objective.details([matrix, matrix], [objective.weights(areas)] * 2)
    assert facts["defects"] == {
        "scratch": 0.875,
        "dent": 0.25,
        "bump": 1.0,
        "pit": 1.0,
        "blister": 1.0,
        "stain": 1.0,
        "haze": 1.0,
    }
    assert facts["worst_defect"] == "dent"
    assert facts["worst_direction_deg"] == 67.5
    assert facts["directions_deg"]["0"] == 1.0
    score = objective.score(matrix, objective.weights(areas), THRESHOLDS)
    share = objective.share_of_whole(score, 4_000_000)
    assert share == pytest.approx(np.mean(list(facts["defects"].values())))
    assert objective.format_score(score, 0.0) == f"{4 * share:.2f} mm²"
    assert objective.format_score(score, 200_000.0) == f"{4 * share:.1f} mm²"


def test_more_images_than_lights_are_refused():
    trials = trials_of([1])
    assert "5 images, and the rig has 4 lights only" in DetectabilityObjective(trials, 5).refusal(4)
