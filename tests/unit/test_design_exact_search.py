"""The exact search gives what trying every combination gives: scores, argmax, ties, runner-up, to the last digit."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from hypothesis import given, strategies as st
from reference._search import all_combinations, coverage_value, paper_value

from lightopt.core.errors import InputError
from lightopt.design import OBJECTIVES, LevelThresholds, LuminanceMatrix, area_units, search
from lightopt.design.search._exact_search import CombinationSpace, NearBest
from lightopt.optics import Sensor

EIGHT_BITS = (np.uint8, 255)
TWELVE_BITS = (np.uint16, 4080)


def random_levels(rng, sizes, patches, kind=EIGHT_BITS, *, few=False):
    """Levels with all classes in them; with `few` values only, so that combinations tie."""
    dtype, top = kind
    levels = []
    for size in sizes:
        layer = rng.choice([0, 9, 10, 100, top], (size, patches)) if few else rng.integers(0, top, (size, patches))
        layer = np.where(rng.random((size, patches)) < 0.2, top, layer)
        levels.append(layer.astype(dtype))
    return tuple(levels)


def plain(matrix, objective, thresholds, allowed=None):
    weights = np.ones(len(matrix.areas), np.int64) if objective == "paper" else area_units(matrix.areas)
    t = (thresholds.shade, thresholds.saturation)
    if objective == "paper":
        value = partial(paper_value, shade=t[0], saturation=t[1], black=thresholds.black)
    else:
        value = partial(coverage_value, shade=t[0], saturation=t[1], areas=weights)
    return all_combinations(matrix.levels, value, *t, weights, allowed, thresholds.black)


def as_tuples(found):
    return [r.sort_key for r in found.ranking]


def agree(found, expected, keep):
    assert as_tuples(found) == expected[:keep]
    assert found.ties == sum(value == expected[0][0] for value, _, _ in expected) - 1
    assert found.scored + found.excluded + found.clashing >= len(expected)
    assert found.left == 0
    assert found.proven
    assert found.bound == -expected[0][0]
    assert found.gap == expected[1][0] - expected[0][0]


@pytest.mark.parametrize("kind", [EIGHT_BITS, TWELVE_BITS], ids=["8bit", "12bit"])
@pytest.mark.parametrize("few", [False, True], ids=["random", "ties"])
@pytest.mark.parametrize(
    ("objective", "sizes"),
    [
        ("paper", (4, 3, 5)),
        ("paper", (4, 3, 5, 2)),
        ("paper", (3, 2, 3, 2, 2)),
        ("paper", (2, 3, 2, 2, 1, 2)),
        ("coverage", (6, 5)),
        ("coverage", (4, 3, 5)),
        ("coverage", (4, 3, 5, 2)),
        ("coverage", (2, 3, 2, 2, 1, 2)),
    ],
)
def test_plain_reading_of_section_5_2(objective, sizes, few, kind):
    rng = np.random.default_rng(len(sizes))
    matrix = LuminanceMatrix(
        levels=random_levels(rng, sizes, 7 if few else 61, kind, few=few), areas=rng.random(7 if few else 61)
    )
    thresholds = LevelThresholds(shade=10, saturation=kind[1])
    found = search([matrix], OBJECTIVES[objective], thresholds, keep=17)
    expected = plain(matrix, objective, thresholds)
    agree(found, expected, 17)
    assert found.scored == len(expected)


@pytest.mark.slow
@given(data=st.data())
def test_plain_reading_of_any_small_matrix(data):
    lights = data.draw(st.integers(2, 5))
    sizes = data.draw(st.lists(st.integers(1, 3), min_size=lights, max_size=lights))
    patches = data.draw(st.integers(1, 6))
    shade = data.draw(st.integers(0, 40))
    saturation = data.draw(st.integers(shade + 1, 255))
    black = data.draw(st.integers(0, shade))
    level = st.sampled_from(sorted({0, max(0, shade - 1), shade, saturation - 1, saturation, 255}))
    levels = tuple(
        np.array(data.draw(st.lists(level, min_size=n * patches, max_size=n * patches)), np.uint8).reshape(n, -1)
        for n in sizes
    )
    areas = np.array(data.draw(st.lists(st.integers(0, 5), min_size=patches, max_size=patches))) * 1e-6
    matrix = LuminanceMatrix(levels=levels, areas=areas)
    thresholds = LevelThresholds(shade=shade, saturation=saturation, black=black)
    for name, objective in OBJECTIVES.items():
        if objective.refusal(lights):
            continue
        found = search([matrix], objective, thresholds, keep=1000)
        assert as_tuples(found) == plain(matrix, name, thresholds)
        # taken in small boxes, with bounds, the same
        cells = data.draw(st.integers(1, 6))
        boxed = search([matrix], objective, thresholds, keep=2, table_cells=cells)
        assert as_tuples(boxed) == as_tuples(found)[:2]
        assert (boxed.ties, boxed.bound, boxed.left) == (found.ties, found.bound, 0)
        assert boxed.scored + boxed.excluded == np.prod(sizes)


@pytest.mark.parametrize("name", ["paper", "coverage"])
def test_scores_are_those_of_the_definition_and_below_the_bound(name):
    rng = np.random.default_rng(5)
    levels = random_levels(rng, (3, 4, 2, 3), 200)
    thresholds = LevelThresholds(shade=10, saturation=255)
    objective = OBJECTIVES[name]
    matrix = LuminanceMatrix(levels=levels, areas=rng.random(200))
    weights = objective.weights(matrix.areas)
    scores = objective.scores(matrix, weights, thresholds, 1, None).reshape(3, 4, 2, 3)
    for place in np.ndindex(3, 4, 2, 3):
        assert scores[place] == objective.score(matrix.combination(place), weights, thresholds)
    assert scores.max() <= objective.bound(matrix, weights, thresholds)
    assert (scores.ravel() == objective.scores(matrix, weights, thresholds, 3, None)).all()


def test_more_patches_than_a_kernel_takes_at_once():
    rng = np.random.default_rng(7)
    levels = random_levels(rng, (2, 1, 2, 2), 140_001)
    matrix = LuminanceMatrix(levels=levels, areas=np.full(140_001, 1e-3))
    thresholds = LevelThresholds(shade=10, saturation=255)
    for objective in OBJECTIVES.values():
        found = search([matrix], objective, thresholds, keep=8)
        for ranked in found.ranking:
            one = matrix.combination(ranked.candidates)
            assert ranked.score == objective.score(one, objective.weights(matrix.areas), thresholds)


def test_a_limit_leaves_a_bound_that_holds():
    rng = np.random.default_rng(8)
    matrix = LuminanceMatrix(levels=random_levels(rng, (6, 6, 6, 6), 50), areas=rng.random(50))
    thresholds = LevelThresholds(shade=10, saturation=255)
    for objective in OBJECTIVES.values():
        whole = search([matrix], objective, thresholds, keep=2)
        part = search([matrix], objective, thresholds, keep=2, table_cells=64, limit=100)
        assert 0 < part.scored < whole.scored
        assert part.left > 0
        assert part.scored + part.excluded + part.left == 6**4
        assert part.best.score <= whole.best.score <= part.bound


def test_bounds_exclude_combinations_of_dark_positions():
    rng = np.random.default_rng(9)
    levels = [np.minimum(layer, 200) for layer in random_levels(rng, (8, 8, 8), 40)]
    for layer in levels[:2]:
        layer[4:] = 0
    matrix = LuminanceMatrix(levels=tuple(levels), areas=np.ones(40))
    thresholds = LevelThresholds(shade=10, saturation=255)
    boxed = search([matrix], OBJECTIVES["paper"], thresholds, keep=2, table_cells=16)
    whole = search([matrix], OBJECTIVES["paper"], thresholds, keep=2)
    assert boxed.excluded > 0
    assert as_tuples(boxed) == as_tuples(whole)


def test_several_postures_are_decided_by_their_sum():
    rng = np.random.default_rng(10)
    matrices = [
        LuminanceMatrix(levels=random_levels(rng, (3, 4, 2), patches), areas=rng.random(patches))
        for patches in (20, 35)
    ]
    thresholds = LevelThresholds(shade=10, saturation=255)
    for name, objective in OBJECTIVES.items():
        both = {}
        for matrix in matrices:
            for value, usable, combination in plain(matrix, name, thresholds):
                before = both.get(combination, (0, 0))
                both[combination] = (before[0] + value, before[1] + usable)
        expected = sorted((v, u, c) for c, (v, u) in both.items())
        agree(search(matrices, objective, thresholds, keep=24), expected, 24)


def test_colliding_panels_and_common_angles_restrict_the_space():
    rng = np.random.default_rng(11)
    matrix = LuminanceMatrix(levels=random_levels(rng, (3, 3, 3), 30), areas=rng.random(30))
    thresholds = LevelThresholds(shade=10, saturation=255)
    clash = np.zeros((3, 3), np.bool_)
    clash[2, :2] = True
    space = CombinationSpace(sizes=(3, 3, 3), groups=(tuple(np.arange(3) for _ in range(3)),), clashes={(0, 2): clash})
    found = search([matrix], OBJECTIVES["paper"], thresholds, space=space, keep=50)
    agree(found, plain(matrix, "paper", thresholds, lambda c: not clash[c[0], c[2]]), 50)
    assert (found.scored, found.clashing) == (21, 6)
    together = CombinationSpace(sizes=(3, 3, 3), groups=tuple((np.array([k]),) * 3 for k in range(3)))
    found = search([matrix], OBJECTIVES["coverage"], thresholds, space=together, keep=50)
    agree(found, plain(matrix, "coverage", thresholds, lambda c: len(set(c)) == 1), 50)
    clash[:] = True
    with pytest.raises(InputError, match="panels collide"):
        search([matrix], OBJECTIVES["paper"], thresholds, space=space)


def test_ties_go_to_more_usable_light_then_to_lower_candidates():
    # under every combination the one patch is usable twice; light 1's second candidate is brighter, light 2's are equal
    levels = (np.array([[50], [60]], np.uint8), np.array([[70], [70]], np.uint8))
    matrix = LuminanceMatrix(levels=levels, areas=np.array([0.25]))
    found = search([matrix], OBJECTIVES["coverage"], LevelThresholds(shade=10, saturation=255))
    assert [r.candidates for r in found.ranking] == [(1, 0), (1, 1), (0, 0), (0, 1)]
    assert (found.best.score, found.ties, found.gap) == (250_000, 3, 0)
    assert found.best.usable == 250_000 * 130


@pytest.mark.parametrize("name", ["paper", "coverage"])
@pytest.mark.parametrize("few", [False, True], ids=["random", "ties"])
def test_sets_near_the_best_are_those_of_the_plain_reading(name, few):
    rng = np.random.default_rng(7)
    levels = random_levels(rng, (4, 3, 5, 2), 40, few=few)
    areas = rng.random(40)
    matrix = LuminanceMatrix(levels=levels, areas=areas)
    thresholds, objective = LevelThresholds(shade=10, saturation=255), OBJECTIVES[name]
    scores = [-value for value, _, _ in plain(matrix, name, thresholds)]
    # within 0.5 % of the best score, or 0.5 points of the area
    whole = scores[0] if name == "paper" else int(area_units(areas).sum())
    near = sum(1000 * (scores[0] - score) <= 5 * whole for score in scores[1:])
    found = search([matrix], objective, thresholds)
    assert (found.near, found.near_exact) == (near, True)
    assert found.near >= found.ties
    # of boxes that a bound excluded some may be near: then the count is a lower limit, and says so
    for cells in (1, 7, 60):
        boxed = search([matrix], objective, thresholds, keep=2, table_cells=cells)
        assert boxed.near == near if boxed.near_exact else boxed.near <= near
        assert boxed.ties == found.ties
    stopped = search([matrix], objective, thresholds, keep=2, limit=8)
    assert not stopped.near_exact
    assert stopped.near <= near


def test_scores_near_the_best_are_counted_whatever_the_order_and_as_many_as_there_is_room_for():
    rng = np.random.default_rng(8)
    scores = rng.integers(0, 2000, 3000)
    expected = int((scores >= scores.max() - 100).sum())
    for order in (np.sort(scores), -np.sort(-scores), scores):
        near = NearBest(lambda best: 100)
        for some in np.array_split(order, 17):
            near.add(some)
        assert (near.count, near.exact) == (expected, True)
    full = NearBest(lambda best: 100, most=50)
    for some in np.array_split(scores, 17):
        full.add(some)
    assert not full.exact
    assert 10 < full.count < expected


def test_areas_are_kept_when_patches_are_split_where_they_stand():
    rng = np.random.default_rng(12)
    areas = rng.integers(1, 1000, 500) * 2.0**-18
    halves = np.repeat(areas / 2.0, 2)
    levels = random_levels(rng, (5, 4, 6), 500)
    split = tuple(np.repeat(layer, 2, axis=1) for layer in levels)
    thresholds = LevelThresholds(shade=10, saturation=255)
    whole, parts = (
        search([LuminanceMatrix(levels=some, areas=a)], OBJECTIVES["coverage"], thresholds)
        for some, a in ((levels, areas), (split, halves))
    )
    assert as_tuples(whole) == as_tuples(parts)
    assert whole.ties == parts.ties
    tiny = np.full(1000, 1e-7)
    assert area_units(tiny).sum() == 100, "patches smaller than the unit count, too"


def test_refusals_say_what_to_do():
    dark = LuminanceMatrix(levels=(np.zeros((2, 0), np.uint8),) * 3, areas=np.zeros(0))
    thresholds = LevelThresholds(shade=10, saturation=255)
    with pytest.raises(InputError, match="no patch is inspectable"):
        search([dark], OBJECTIVES["paper"], thresholds)
    two = LuminanceMatrix(levels=(np.zeros((2, 3), np.uint8),) * 2, areas=np.ones(3))
    with pytest.raises(InputError, match="nothing is left; expected at least 3 lights"):
        search([two], OBJECTIVES["paper"], thresholds)
    one = LuminanceMatrix(levels=(np.zeros((2, 3), np.uint8),), areas=np.ones(3))
    with pytest.raises(InputError, match="one light only"):
        search([one], OBJECTIVES["coverage"], thresholds)
    with pytest.raises(InputError, match="leaves none usable"):
        LevelThresholds(shade=255, saturation=255)
    with pytest.raises(InputError, match="share of full scale from 0 to 1"):
        LevelThresholds.of_sensor(Sensor(bit_depth=8), shade_share=10.0)
    with pytest.raises(InputError, match="expected uint8 or uint16 of shape"):
        LuminanceMatrix(levels=(np.zeros((2, 3)),), areas=np.ones(3))


def test_thresholds_of_sensors():
    assert LevelThresholds.of_sensor(Sensor(bit_depth=8), shade_share=10 / 255) == LevelThresholds(
        shade=10, saturation=255
    )
    assert LevelThresholds.of_sensor(
        Sensor(bit_depth=12, saturation_level=4080), shade_share=10 / 255
    ) == LevelThresholds(shade=161, saturation=4080)


def test_thresholds_are_of_light_above_black():
    # 10/255 of full scale of light delivers 10 levels above black, however dark black is
    def of(*, shade_share, black_level=0.0):
        sensor = Sensor(bit_depth=8, saturation_level=250, black_level=black_level)
        return LevelThresholds.of_sensor(sensor, shade_share=shade_share)

    assert of(shade_share=10 / 255, black_level=16) == LevelThresholds(shade=26, saturation=250, black=16)
    assert of(shade_share=10 / 255, black_level=16.5) == LevelThresholds(shade=27, saturation=250, black=17)
    # what is delivered without light is never usable
    assert of(shade_share=0.0, black_level=16.5) == LevelThresholds(shade=18, saturation=250, black=17)
    assert of(shade_share=0.0) == LevelThresholds(shade=1, saturation=250, black=0)
    with pytest.raises(InputError, match="black is 16, shaded below 262"):
        of(shade_share=246 / 255, black_level=16)


def test_paper_sums_light_above_black():
    levels = tuple(np.array([[level]], np.uint8) for level in (20, 50, 90, 255))
    matrix = LuminanceMatrix(levels=levels, areas=np.ones(1))
    found = search([matrix], OBJECTIVES["paper"], LevelThresholds(shade=30, saturation=255, black=16))
    assert (found.best.score, found.best.usable) == (34 + 74, 34 + 74)
