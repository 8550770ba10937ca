"""What light positions between the candidates can score at most."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from test_design_candidates import light, rig_of
from test_design_detectability import matrix_of, random_matrix, trials_of

from lightopt.core.errors import LightoptError
from lightopt.core.transforms import Posture
from lightopt.design import (
    OBJECTIVES,
    DetectabilityObjective,
    LevelThresholds,
    LuminanceMatrix,
    OptimizeOptions,
    find_candidates,
    optimize,
    search,
)
from lightopt.design._cells import Cells, LightCells, cell_clashes, intervals, light_cells
from lightopt.design.search import _between_steps
from lightopt.design.search._between_steps import (
    BetweenSteps,
    ProbedCells,
    bound_between,
    cell_levels,
    excess_of_levels,
)
from lightopt.design.search._exact_search import CombinationSpace

PLATE = """\
format: lightopt-part/1
name: plate
mesh: {file: plate.stl, units: mm}
placement: {anchor: rest_on_table}
postures: [{elevation_deg: 20, rotation_deg: 0}]
reflectance: {R_d: 20, R_s: 300, sigma_rad: 0.05}
"""
THRESHOLDS = LevelThresholds(shade=10, saturation=255)


def test_intervals_join_neighbours():
    assert intervals([30.0, 35.0, 40.0]) == [(30.0, 35.0), (35.0, 40.0)]
    assert intervals([45.0]) == [(45.0, 45.0)]
    assert intervals([0.0, 120.0, 240.0], full_turn=True) == [(0.0, 120.0), (120.0, 240.0), (240.0, 360.0)]


def cells_of(axes, candidates, *, places=None, full_turn=False):
    grid = list(itertools.product(*axes)) if places is None else places
    panels = {place: f"panel at {place}" for place in grid}
    return light_cells(axes, grid, candidates, panels, full_turn=full_turn)


def test_cells_have_all_corners_of_the_grid_and_one_allowed_at_least():
    axes = (30.0, 40.0, 50.0, 60.0), (0.0, 10.0)
    allowed = [(30.0, 0.0), (30.0, 10.0), (40.0, 0.0)]
    found = cells_of(axes, allowed)
    assert found.cells == (((30.0, 40.0), (0.0, 10.0)), ((40.0, 50.0), (0.0, 10.0)))
    # candidates first, then what is excluded: it bounds what lies between
    assert [some.tolist() for some in found.corners] == [[0, 1, 2, 3], [2, 3, 4, 5]]
    assert found.beyond == ("panel at (40.0, 10.0)", "panel at (50.0, 0.0)", "panel at (50.0, 10.0)")
    around = [(45.0, azimuth) for azimuth in (0.0, 120.0, 240.0)]
    found = cells_of(((45.0,), (0.0, 120.0, 240.0)), around, full_turn=True)
    assert [some.tolist() for some in found.corners] == [[0, 1], [1, 2], [0, 2]]
    assert found.cells[-1] == ((45.0, 45.0), (240.0, 360.0))


def test_a_measured_place_is_the_corner_that_it_stands_for():
    """Also in a range no wider than a step, where it is nearer to the grid's place than the ends to each other."""
    measured = (44.59, 0.3)
    axes, grid = ((44.5, 45.5), (0.0, 20.0)), [measured, (44.5, 20.0), (45.5, 0.0), (45.5, 20.0)]
    (corners,) = cells_of(axes, grid, places=grid).corners
    assert [grid[k] for k in corners] == grid


def test_cells_collide_where_all_of_their_corners_do():
    clash = np.array([[True, True, False], [True, True, False]])
    first = LightCells((), (np.array([0, 1]),), ())
    second = LightCells((), (np.array([0, 1]), np.array([1, 2])), ())
    (found,) = cell_clashes({(0, 1): clash}, (first, second)).values()
    assert found.tolist() == [[True, False]]
    assert cell_clashes({(0, 1): clash}, (first, LightCells((), (np.array([1, 2]),), ()))) == {}
    # of corners that are excluded as positions, none is one
    beyond = LightCells((), (np.array([0, 1, 3]),), ())
    assert cell_clashes({(0, 1): clash}, (first, beyond))[0, 1].tolist() == [[True]]


def test_cells_of_a_rig_are_combined_as_its_places_are(tmp_path):
    dome = "name: e, kind: dome, radius_mm: 200, segments: 2, distance_range_mm: [0, 40], distance_step_mm: 20"
    rig = rig_of(tmp_path, light("a", 50, 0), f"{dome}, camera_hole_mm: 150")
    found = find_candidates(rig, step_deg=10.0).cells
    assert [own.moves for own in found.of_lights] == [False, True, True]
    assert [len(own.cells) for own in found.of_lights] == [1, 2, 2]
    # channels of the dome stand in one cell
    assert [[row.tolist() for row in group] for group in found.space.groups] == [[[0], [0], [0]], [[0], [1], [1]]]
    fixed = rig_of(tmp_path, light("a", 50, 0), light("b", 50, 90))
    assert not find_candidates(fixed, step_deg=10.0).cells.moves


def test_lights_at_a_common_elevation_share_its_interval(tmp_path):
    rig = rig_of(
        tmp_path,
        light("a", 40, 0, ", elevation_range_deg: [30, 60], azimuth_range_deg: [0, 10]"),
        light("b", 50, 90, ", elevation_range_deg: [45, 70]"),
        light("c", 55, 180),
    )
    found = find_candidates(rig, step_deg=5.0, common_elevation=True).cells
    between = [(45.0, 50.0), (50.0, 55.0), (55.0, 60.0)]
    assert len(found.space.groups) == len(between)
    for elevations, rows in zip(between, found.space.groups, strict=True):
        for own, row in zip(found.of_lights[:2], rows[:2], strict=True):
            assert {own.cells[k][0] for k in row} == {elevations}
        assert rows[2].tolist() == [0]


def grid_of(*sizes: int) -> Cells:
    """Cells between so many steps of one angle of each light."""
    lights = [cells_of((tuple(map(float, range(n))),), [(float(k),) for k in range(n)]) for n in sizes]
    return Cells(tuple(lights), CombinationSpace.of([n - 1 for n in sizes]))


def bound_of(matrix, objective, cells):
    """The bound where no corner is excluded; None for none."""
    nothing = LuminanceMatrix(levels=tuple(layer[:0] for layer in matrix.levels), areas=matrix.areas)
    if matrix.visibility is not None:
        empty = replace(matrix.visibility, words=tuple(words[:0] for words in matrix.visibility.words))
        nothing = replace(nothing, visibility=empty)
    found = bound_between([matrix], [nothing], objective, THRESHOLDS, cells, limit=10**9)
    return None if found is None else found.score


@pytest.mark.parametrize("name", ["coverage", "paper"])
@pytest.mark.parametrize("seed", range(6))
def test_no_levels_between_the_candidates_score_more_than_the_bound(name, seed):
    """Levels drawn between those of neighbouring candidates, patch by patch, are searched like candidates."""
    rng = np.random.default_rng(seed)
    sizes, patches = (4, 3, 3, 3), 40
    levels = [rng.choice([0, 5, 9, 10, 60, 200, 254, 255], (n, patches)).astype(np.uint8) for n in sizes]
    matrix = LuminanceMatrix(levels=tuple(levels), areas=rng.uniform(0.5, 2.0, patches))
    cells = grid_of(*sizes)
    bound = bound_of(matrix, OBJECTIVES[name], cells)
    assert bound is not None
    for _ in range(20):
        between = [rng.integers(np.minimum(x[:-1], x[1:]), np.maximum(x[:-1], x[1:]), endpoint=True) for x in levels]
        drawn = LuminanceMatrix(levels=tuple(x.astype(np.uint8) for x in between), areas=matrix.areas)
        assert search([drawn], OBJECTIVES[name], THRESHOLDS, keep=2).best.score <= bound
    # and it is no further away than the corners require: the bound of patches that do not change is their score
    still = LuminanceMatrix(
        levels=tuple(np.repeat(x[:1], n, axis=0) for x, n in zip(levels, sizes, strict=True)), areas=matrix.areas
    )
    best = search([still], OBJECTIVES[name], THRESHOLDS, keep=2).best.score
    assert bound_of(still, OBJECTIVES[name], cells) == best


def test_the_best_level_of_a_cell():
    layer = np.array([[0, 5, 100, 255, 255, 3], [9, 20, 255, 255, 0, 4]], np.uint8)
    assert cell_levels(layer, [np.array([0, 1])], THRESHOLDS).tolist() == [[9, 20, 254, 255, 254, 4]]


@pytest.mark.parametrize("seed", range(4))
def test_no_evidence_between_the_candidates_finds_more_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    sizes, trials = (3, 4, 3), trials_of([3, 1, 2])
    flags, matrix = random_matrix(rng, sizes, 12, trials, share=0.5)
    objective, cells = DetectabilityObjective(trials, 2), grid_of(*sizes)
    bound = bound_of(matrix, objective, cells)
    greatest = 0
    for _ in range(20):
        units = [np.sort([x[:-1], x[1:]], axis=0) for x in map(np.asarray, flags)]
        between = [rng.integers(low, high, endpoint=True) for low, high in units]
        drawn = matrix_of(between, trials, matrix.areas, [x[:-1] for x in matrix.levels])
        greatest = max(greatest, search([drawn], objective, THRESHOLDS, keep=2).best.score)
    assert 0 < greatest <= bound
    best_of_corners = [np.maximum(x[:-1], x[1:]) for x in map(np.asarray, flags)]
    cornered = matrix_of(best_of_corners, trials, matrix.areas, [x[:-1] for x in matrix.levels])
    assert search([cornered], objective, THRESHOLDS, keep=2).best.score == bound


def test_no_bound_where_memory_does_not_suffice(monkeypatch):
    matrix = LuminanceMatrix(levels=tuple(np.zeros((3, 50), np.uint8) for _ in range(2)), areas=np.ones(50))
    ask = (matrix, OBJECTIVES["coverage"], grid_of(3, 3))
    monkeypatch.setattr(_between_steps, "MOST_BYTES", 2 * 2 * 150)
    assert bound_of(*ask) == 0
    monkeypatch.setattr(_between_steps, "MOST_BYTES", 2 * 2 * 150 - 1)
    assert bound_of(*ask) is None


@pytest.mark.parametrize(
    ("name", "corners", "midway", "others"),
    [
        ("paper", (100, 100), 255, (200, 80, 10)),  # takes the place of the highest
        ("paper", (100, 100), 200, (210, 80, 10)),
        ("coverage", (255, 255), 5, (255, 100, 100)),  # one saturated image less
        ("coverage", (3, 5), 60, (100, 0, 0)),
    ],
)
def test_what_lies_above_the_corners_inside_is_part_of_the_bound(name, corners, midway, others):
    """One patch under four lights, of which the first moves: its level midway is not between those of its corners."""
    still = [np.array([[level], [level]], np.uint8) for level in others]
    matrix = LuminanceMatrix(
        levels=(np.array([[corners[0]], [corners[1]], [midway]], np.uint8), *still), areas=np.ones(1)
    )
    rows = ((np.array([0, 1]),), *((np.array([0]),) for _ in others))
    inside = ((np.array([2]),), *((np.array([1]),) for _ in others))
    tested = ProbedCells(panels=((),) * 4, corners=rows, inside=inside)
    objective = OBJECTIVES[name]
    excess = excess_of_levels(tested, [matrix], objective, THRESHOLDS)
    base = bound_of(matrix.rows([np.arange(2)] * 4), objective, grid_of(2, 2, 2, 2))
    assert base is not None
    there = LuminanceMatrix(levels=(matrix.levels[0][2:], *(own[:1] for own in still)), areas=matrix.areas)
    reached = objective.score(there, objective.weights(there.areas), THRESHOLDS)
    assert reached > base
    raised = BetweenSteps.of(base, excess, full=objective.full_score(10**6), best=base, postures=[])
    assert raised.bound >= reached


def test_a_bound_below_the_best_is_an_error_of_the_program():
    with pytest.raises(LightoptError, match="internal error"):
        BetweenSteps.of(5, 0.0, full=10, best=6, postures=[Posture(0.0, 0.0)])
    assert BetweenSteps.of(9, 0.5, full=10, best=6, postures=[]).bound == 10


@pytest.mark.parametrize(
    ("objective", "ends", "steps", "warns"),
    [
        ("detectability", "[30, 70]", (40.0, 2.0), True),  # the highlight lies between the first candidates
        ("coverage", "[30, 70]", (10.0, 2.0), False),
        ("paper", "[30, 70]", (20.0, 2.0), True),  # levels are greatest between them
        ("paper", "[40, 90]", (5.0, 2.0), True),  # and the last ones are in the camera's view
        ("paper", "[30, 70]", (2.0, 1.0), False),
    ],
)
def test_no_finer_step_exceeds_a_bound(tmp_path, objective, ends, steps, warns):
    """A plate tilted by 20 degrees that mirrors light from 50 degrees, under three lights that move alike."""
    trimesh.creation.box((30.0, 30.0, 2.0)).export(tmp_path / "plate.stl")
    (tmp_path / "part.yaml").write_text(PLATE, encoding="utf-8")
    lights = [
        light(name, 50, turn, f", elevation_range_deg: {ends}")
        for name, turn in zip("abc", (248, 270, 292), strict=True)
    ]
    rig = rig_of(tmp_path, *lights)
    options = OptimizeOptions(objectives=(objective,), min_images=1, patch_budget=200, images=False)
    results = [
        optimize(rig, tmp_path / "part.yaml", tmp_path / "out", options=replace(options, step_deg=step))
        for step in steps
    ]
    coarse, fine = (one.results[0].answers[0] for one in results)
    assert coarse.between is not None
    assert coarse.found.best.score <= fine.found.best.score <= coarse.between.bound
    assert warns is any("between candidate positions" in text for text in results[0].warnings)
    if warns:
        assert coarse.between.excess > 0.01
    said = results[0].results[0].between_text
    assert said is not None
    assert said.startswith("positions between the candidates are expected to score at most ")
