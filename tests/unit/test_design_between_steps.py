"""What light positions between the candidates can score at most."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh
from test_design_candidates import light, rig_of
from test_design_detectability import matrix_of, random_matrix, trials_of

from lightopt import build_scene, load_part
from lightopt.core.transforms import Posture
from lightopt.design import (
    OBJECTIVES,
    DetectabilityObjective,
    DetectionModel,
    LevelThresholds,
    LuminanceMatrix,
    find_candidates,
    planned_catalogue,
    search,
)
from lightopt.design._cells import Cells, cell_clashes, intervals, light_cells
from lightopt.design._problem import OptimizeOptions
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.search import _between_steps
from lightopt.design.search._between_steps import BetweenSteps, bound_between, cell_levels, share_outside
from lightopt.design.search._exact_search import CombinationSpace
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import build_catalogue

PLATE = """\
format: lightopt-part/1
name: plate
mesh: {file: plate.stl, units: mm}
placement: {anchor: rest_on_table}
postures: [{elevation_deg: 20, rotation_deg: 0}]
reflectance: {R_d: 1.5, R_s: 300, sigma_rad: 0.03}
"""
THRESHOLDS = LevelThresholds(shade=10, saturation=255)


def test_intervals_join_neighbours_and_take_near_values_for_one():
    assert intervals([30.0, 35.0, 40.0]) == [(30.0, 35.0), (35.0, 40.0)]
    assert intervals([45.0]) == [(45.0, 45.0)]
    # a place measured near a step, and the end of the range after a last short step
    assert intervals([30.0, 35.0, 35.02, 40.0, 40.2]) == [(30.0, 35.02), (35.0, 40.2)]
    assert intervals([0.0, 120.0, 240.0], full_turn=True) == [(0.0, 120.0), (120.0, 240.0), (240.0, 360.0)]


def test_cells_have_the_candidates_at_their_corners():
    grid = list(itertools.product((30.0, 40.0, 50.0), (0.0, 10.0)))
    left = [place for place in grid if place not in ((50.0, 0.0), (50.0, 10.0), (40.0, 10.0))]
    found, corners = light_cells(grid, left, full_turn=False)
    assert found == (((30.0, 40.0), (0.0, 10.0)), ((40.0, 50.0), (0.0, 10.0)))
    assert [[left[k] for k in some] for some in corners] == [[(30.0, 0.0), (30.0, 10.0), (40.0, 0.0)], [(40.0, 0.0)]]
    round_the_part = [(45.0, azimuth) for azimuth in (0.0, 120.0, 240.0)]
    found, corners = light_cells(round_the_part, round_the_part, full_turn=True)
    assert [some.tolist() for some in corners] == [[0, 1], [1, 2], [0, 2]]
    assert found[-1] == ((45.0, 45.0), (240.0, 360.0))


def test_cells_collide_where_all_of_their_corners_do():
    clash = np.array([[True, True, False], [True, True, False]])
    corners = ([np.array([0, 1])], [np.array([0, 1]), np.array([1, 2])])
    (found,) = cell_clashes({(0, 1): clash}, corners).values()
    assert found.tolist() == [[True, False]]
    assert cell_clashes({(0, 1): clash}, ([np.array([0, 1])], [np.array([1, 2])])) == {}


def test_cells_of_a_rig_are_combined_as_its_places_are(tmp_path):
    dome = "name: e, kind: dome, radius_mm: 200, segments: 2, distance_range_mm: [0, 40], distance_step_mm: 20"
    rig = rig_of(tmp_path, light("a", 50, 0), f"{dome}, camera_hole_mm: 150")
    found = find_candidates(rig, step_deg=10.0).cells
    assert found.moves == (False, True, True)
    assert [len(cells) for cells in found.of_lights] == [1, 2, 2]
    # channels of the dome stand in one cell
    assert [[row.tolist() for row in group] for group in found.space.groups] == [[[0], [0], [0]], [[0], [1], [1]]]
    fixed = rig_of(tmp_path, light("a", 50, 0), light("b", 50, 90))
    assert not any(find_candidates(fixed, step_deg=10.0).cells.moves)


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
        for cells, row in zip(found.of_lights[:2], rows[:2], strict=True):
            assert {cells[k][0] for k in row} == {elevations}
        assert rows[2].tolist() == [0]


def grid_of(*sizes: int) -> Cells:
    """Cells between so many steps of one angle of each light."""
    ends = [[(float(k), k + 1.0) for k in range(n - 1)] for n in sizes]
    of_lights = tuple(tuple((own,) for own in some) for some in ends)
    corners = tuple(tuple(np.array([k, k + 1]) for k in range(n - 1)) for n in sizes)
    return Cells(of_lights, corners, CombinationSpace.of([n - 1 for n in sizes]))


@pytest.mark.parametrize("name", ["coverage", "paper"])
@pytest.mark.parametrize("seed", range(6))
def test_no_levels_between_the_candidates_score_more_than_the_bound(name, seed):
    """Levels drawn between those of neighbouring candidates, patch by patch, are searched like candidates."""
    rng = np.random.default_rng(seed)
    sizes, patches = (4, 3, 3, 3), 40
    levels = [rng.choice([0, 5, 9, 10, 60, 200, 254, 255], (n, patches)).astype(np.uint8) for n in sizes]
    matrix = LuminanceMatrix(levels=tuple(levels), areas=rng.uniform(0.5, 2.0, patches))
    cells = grid_of(*sizes)
    bound = bound_between([matrix], OBJECTIVES[name], THRESHOLDS, cells, limit=10**9)
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
    assert bound_between([still], OBJECTIVES[name], THRESHOLDS, cells, limit=10**9) == best


def test_the_best_level_of_a_cell():
    layer = np.array([[0, 5, 100, 255, 255, 3], [9, 20, 255, 255, 0, 4]], np.uint8)
    assert cell_levels(layer, [np.array([0, 1])], THRESHOLDS).tolist() == [[9, 20, 254, 255, 254, 4]]


@pytest.mark.parametrize("seed", range(4))
def test_no_evidence_between_the_candidates_finds_more_than_the_bound(seed):
    rng = np.random.default_rng(seed)
    sizes, trials = (3, 4, 3), trials_of([3, 1, 2])
    flags, matrix = random_matrix(rng, sizes, 12, trials, share=0.5)
    objective, cells = DetectabilityObjective(trials, 2), grid_of(*sizes)
    bound = bound_between([matrix], objective, THRESHOLDS, cells, limit=10**9)
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
    ask = ([matrix], OBJECTIVES["coverage"], THRESHOLDS, grid_of(3, 3))
    monkeypatch.setattr(_between_steps, "MOST_BYTES", 2 * 2 * 150)
    assert bound_between(*ask, limit=10**9) == 0
    monkeypatch.setattr(_between_steps, "MOST_BYTES", 2 * 2 * 150 - 1)
    assert bound_between(*ask, limit=10**9) is None


@pytest.mark.parametrize("tested", ["levels", "defects"])
def test_a_highlight_that_passes_between_the_candidates_is_noticed(tmp_path, tested):
    """A plate tilted by 20 degrees mirrors light from 50 degrees: between candidates at 30 and 70, not at 48 and 52."""
    trimesh.creation.box((30.0, 30.0, 2.0)).export(tmp_path / "plate.stl")
    (tmp_path / "part.yaml").write_text(PLATE, encoding="utf-8")
    part = load_part(tmp_path / "part.yaml")
    shares = []
    for ends, step in (("[30, 70]", 40.0), ("[44, 56]", 2.0)):
        rig = rig_of(tmp_path, light("a", 50, 270, f", elevation_range_deg: {ends}"), light("b", 40, 180))
        scene = build_scene(rig, part)
        caster = cast_rays_at(scene)
        facts = {"sensor": scene.sensor, "full_scale": scene.reflectance.full_scale}
        catalogue = planned_catalogue(build_catalogue(part))
        model = None if tested == "levels" else DetectionModel(catalogue=catalogue, **facts)
        evaluator = ImageEvaluator(scene, build_patches(scene, caster=caster, budget=500), caster, model, threads=1)
        shots = [(posture, (1.0,)) for posture in scene.postures]
        options = OptimizeOptions(step_deg=step)
        shares.append(share_outside(rig, find_candidates(rig, step_deg=step), options, evaluator, shots))
    assert shares[0] > 0.1
    assert shares[1] < 0.02
    said = BetweenSteps(bound=1, outside=shares[0]).warning([Posture(20.0, 0.0)])
    assert said is not None
    assert "(20°, 0°): midway between candidate positions" in said
    assert BetweenSteps(bound=1, outside=0.01).warning([Posture(20.0, 0.0)]) is None
