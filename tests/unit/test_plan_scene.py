"""Plans of a small part: postures, lights, exposures and tolerances against recounting image by image."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

from lightopt.config import load_part, load_rig
from lightopt.mesh import face_normals
from lightopt.optimize import (
    OBJECTIVES,
    Contrast,
    Inspection,
    Thresholds,
    area_units,
    find_candidates,
    luminance_matrix,
    unroll,
)
from lightopt.plan import (
    ObjectiveAssessment,
    PairAssessment,
    Setup,
    Survey,
    Tolerances,
    Wanted,
    choose_postures,
    drawn_patches,
    plan_exposures,
    trust_of,
)
from lightopt.plan import _choose as choosing
from lightopt.rendering import build_patches, cast_rays_at, visible_points
from lightopt.scene import build_catalogue, build_lights, build_scene, view_from_part
from lightopt.transforms import Posture

LIGHTS = """\
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [40, 60]}
  - {name: light2, distance_mm: 330, elevation_deg: 50, azimuth_deg: 225, elevation_range_deg: [30, 50]}
"""
CATALOGUE = """\
defect_catalogue:
  - {name: dent, kind: dent, size_mm: 0.6, slope_deg: 4}
  - {name: stain, kind: stain, size_mm: 1.5, R_d_factor: 0.7}
"""
POSTURES = (Posture(0.0, 0.0), Posture(-20.0, 90.0), Posture(25.0, 200.0), Posture(0.0, 130.0))


@pytest.fixture(scope="module")
def world(shared_bench, tmp_path_factory):
    """Rig, part and a survey of a few hundred patches in four postures."""
    bench = type(shared_bench).make(tmp_path_factory.mktemp("plan") / "bench")
    text = bench.rig.read_text(encoding="utf-8")
    head, rest = text.split("lights:\n", 1)
    text = head + LIGHTS + rest[rest.index("stage:") :]
    bench.rig.write_text(text, encoding="utf-8", newline="\n")
    with bench.part.open("a", encoding="utf-8") as file:
        file.write(CATALOGUE)
    rig, part = load_rig(bench.rig), load_part(bench.part)
    scene = replace(build_scene(rig, part), postures=POSTURES)
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=400)
    contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
    inspection = Inspection(trials=unroll(build_catalogue(part)), contrast=contrast)
    survey = Survey(scene=scene, table=table, caster=caster, inspection=inspection, threads=1)
    return rig, drawn_few(survey)


def drawn_few(survey):
    return replace(survey, table=drawn_patches(survey.table, 300))


def pairs_of(survey, posture, panels, *, exposure=1.0):
    """Plain flags (image, patch of the part, trial) of one image per panel, however the part lies."""
    view = view_from_part(survey.scene, posture)
    patches = survey.table.patches
    facets = face_normals(survey.scene.mesh)[patches.face]
    visible = visible_points(patches.centroids, facets, view, survey.caster)
    visible &= survey.table.visible.any(axis=0)
    table = replace(survey.table, postures=(posture,), visible=visible[None])
    seen = (
        replace(survey, table=table)
        .matrices(posture, [[p] for p in panels], exposures=(exposure,))[0]
        .visibility
    )
    flags = np.zeros((len(panels), len(patches), len(seen.trials)), bool)
    for image, words in enumerate(seen.words):
        bits = np.unpackbits(words[0].view(np.uint8), axis=1, bitorder="little")
        flags[image, seen.patch] = bits[:, : len(seen.trials)]
    return flags


def confirming(survey, shots, panels):
    """In how many images each pair is seen: a light's exposures in a posture are one image."""
    count = 0
    for posture in dict.fromkeys(posture for posture, _ in shots):
        levels = [exposure for other, exposure in shots if other == posture]
        flags = [pairs_of(survey, posture, panels, exposure=exposure) for exposure in levels]
        count = count + np.any(flags, axis=0).sum(axis=0)
    return count


def heavy(survey):
    """Weight of every pair."""
    areas = np.zeros(len(survey.table.patches), np.int64)
    areas[survey.patches] = area_units(survey.table.patches.areas[survey.patches])
    return areas[:, None] * np.array([trial.weight for trial in survey.inspection.trials])


def moved(rig, light, offset):
    config = rig.lights[light]
    config = config.model_copy(
        update={
            "elevation_deg": config.elevation_deg + offset[0],
            "azimuth_deg": config.azimuth_deg + offset[1],
        }
    )
    return build_lights(rig.model_copy(update={"lights": (config,)}))[0]


def setup_of(rig, postures, exposures=((1.0,),)):
    angles = tuple((light.elevation_deg, light.azimuth_deg) for light in rig.lights)
    return Setup(
        rig=rig,
        postures=tuple(postures),
        angles=(angles,) * len(postures),
        exposures=tuple(exposures) * (len(postures) // len(exposures)),
    )


def test_drawn_patches_stand_for_all_by_their_area(world):
    _, survey = world
    whole = build_patches(survey.scene, caster=survey.caster, budget=3000)
    drawn = drawn_patches(whole, 200)
    seen = whole.visible.any(axis=0)
    left = drawn.visible.any(axis=0)
    assert 100 < left.sum() <= 200
    assert not (left & ~seen).any()
    assert drawn.patches.areas[left].sum() == pytest.approx(whole.patches.areas[seen].sum())
    # each half of the surface keeps its share, to a few marks
    for axis in range(3):
        low = whole.patches.centroids[:, axis] < np.median(whole.patches.centroids[:, axis])
        shares = [
            table.patches.areas[low & of].sum() / table.patches.areas[of].sum()
            for table, of in ((whole, seen), (drawn, left))
        ]
        assert shares[1] == pytest.approx(shares[0], abs=0.05)
    assert drawn_patches(whole, int(seen.sum())) is whole


@pytest.mark.parametrize("least", [1, 2])
def test_tolerances_of_pairs_are_those_of_recounting_every_corner(world, least):
    rig, survey = world
    postures = POSTURES[1:3]
    exposures = ((1.0, 0.25), (1.0,))
    assess = PairAssessment(survey, setup_of(rig, postures, exposures), least=least)
    found = trust_of(assess, ["light1", "light2"], Tolerances(light_deg=4.0, pose_deg=3.0, draws=3, seed=1))
    weights = heavy(survey)

    def plain(pose, offsets):
        panels = [moved(rig, light, offset) for light, offset in enumerate(offsets)]
        count = 0
        for posture, levels in zip(postures, exposures, strict=True):
            there = Posture(posture.elevation_deg + pose[0], posture.rotation_deg + pose[1])
            count = count + confirming(survey, [(there, exposure) for exposure in levels], panels)
        return int(weights[count >= least].sum())

    corner = list(product((-4.0, 4.0), repeat=2))
    scores = {
        (pose, lights): plain(pose, lights)
        for pose in product((-3.0, 3.0), repeat=2)
        for lights in product(corner, repeat=2)
    }
    assert found.score == plain((0.0, 0.0), [(0.0, 0.0)] * 2)
    assert found.worst == min(scores.values()) < found.score
    assert scores[found.worst_pose, found.worst_lights] == found.worst
    draws = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 3, 2)) * np.array([3.0, 4.0, 4.0])[:, None]
    assert found.least_drawn == min(plain(d[0], d[1:]) for d in draws)
    assert found.quantile == found.least_drawn


def test_tolerances_of_coverage_are_those_of_recounting_every_corner(world):
    rig, survey = world
    postures = POSTURES[:2]
    thresholds = Thresholds(shade=10, saturation=255)
    assess = ObjectiveAssessment(
        replace(survey, inspection=None),
        setup_of(rig, postures),
        objective=OBJECTIVES["coverage"],
        thresholds=thresholds,
    )
    found = trust_of(assess, ["light1", "light2"], Tolerances(light_deg=6.0, pose_deg=2.0, draws=1))

    def plain(pose, offsets):
        panels = [[moved(rig, light, offset)] for light, offset in enumerate(offsets)]
        total = 0
        for posture in postures:
            there = Posture(posture.elevation_deg + pose[0], posture.rotation_deg + pose[1])
            facets = face_normals(survey.scene.mesh)[survey.table.patches.face]
            visible = visible_points(
                survey.table.patches.centroids, facets, view_from_part(survey.scene, there), survey.caster
            )
            visible &= survey.table.visible.any(axis=0)
            table = replace(survey.table, postures=(there,), visible=visible[None])
            matrix = luminance_matrix(survey.scene, table, there, panels, caster=survey.caster)
            levels = np.stack([layer[0] for layer in matrix.levels])
            usable = (levels >= 10) & (levels < 255)
            covered = (usable.sum(axis=0) >= 2) & ((levels >= 255).sum(axis=0) <= 1)
            total += int(area_units(matrix.areas)[covered].sum())
        return total

    corner = list(product((-6.0, 6.0), repeat=2))
    scores = [
        plain(pose, lights) for pose in product((-2.0, 2.0), repeat=2) for lights in product(corner, repeat=2)
    ]
    assert found.score == plain((0.0, 0.0), [(0.0, 0.0)] * 2)
    assert found.worst == min(scores)


@pytest.mark.parametrize("least", [1, 2])
def test_postures_and_lights_are_chosen_together(world, least):
    rig, survey = world
    candidates = find_candidates(rig, step_deg=10.0)
    lights = build_lights(rig)
    choice = choose_postures(survey, survey, POSTURES, lights, candidates, Wanted(least=least, count=2))
    weights = heavy(survey)
    total = weights[survey.patches].sum()

    def plain(some, places):
        panels = [candidates.panels[i][k] for i, k in enumerate(places)]
        count = sum(pairs_of(survey, posture, panels).sum(axis=0) for posture in some)
        return int(weights[count >= least].sum())

    assert choice.cover.total == total
    assert choice.cover.reached == plain(choice.postures, choice.lights)
    # no other lights would show more in these postures
    assert choice.exact
    assert choice.settled
    places = list(product(range(3), range(3)))
    assert choice.cover.reached == max(plain(choice.postures, some) for some in places)
    # nor do two other postures beyond the bound
    best = max(plain(two, choice.lights) for two in combinations(POSTURES, 2))
    assert choice.cover.reached <= best <= choice.cover.bound_share * total + 0.5
    alone = choose_postures(survey, survey, POSTURES, lights, None, Wanted(least=least, count=2))
    assert alone.lights is None
    assert alone.cover.share == pytest.approx(choice.before)
    assert choice.cover.share >= alone.cover.share


def test_where_positions_are_too_many_for_memory_the_turns_stay_on_drawn_patches(world, monkeypatch):
    rig, survey = world
    candidates = find_candidates(rig, step_deg=10.0)
    few = replace(survey, table=drawn_patches(survey.table, 60))
    ask = (survey, few, POSTURES[:2], build_lights(rig), candidates, Wanted(count=1))
    free = choose_postures(*ask)
    assert free.on_all
    assert free.settled
    # room for two candidate postures, not for six positions and their sums
    monkeypatch.setattr(choosing, "MOST_COUNT_BYTES", 2 * len(survey.patches) * 8)
    tight = choose_postures(*ask)
    assert not tight.on_all
    assert not tight.settled
    assert tight.turns < free.turns
    assert tight.cover.total == free.cover.total, "the figures are of all patches"


def test_the_target_takes_as_few_postures_as_it_needs(world):
    rig, survey = world
    lights = build_lights(rig)
    two = choose_postures(survey, survey, POSTURES, lights, None, Wanted(count=2))
    found = choose_postures(survey, survey, POSTURES, lights, None, Wanted(target=two.cover.share))
    assert len(found.postures) <= 2
    assert found.cover.share >= two.cover.share
    never = choose_postures(survey, survey, POSTURES, lights, None, Wanted(target=1.0))
    assert never.cover.share < 1.0
    assert never.cover.least is None


@pytest.mark.parametrize("least", [1, 2])
def test_exposures_are_planned_where_they_add_enough(world, least):
    rig, survey = world
    lights = build_lights(rig)
    offered = (1.0, 0.25, 0.0625)
    # a light's exposures do not confirm each other, so that they add little where two images must agree
    points = 1.0 if least == 1 else 0.0
    found = plan_exposures(survey, POSTURES[:2], [lights] * 2, offered, least=least, gain_points=points)
    weights = heavy(survey)
    total = weights[survey.patches].sum()

    def plain(shots):
        return int(weights[confirming(survey, shots, lights) >= least].sum()) / total

    base = [(posture, 1.0) for posture in POSTURES[:2]]
    assert found.before == pytest.approx(plain(base))
    shots = list(base)
    for shot in found.shots:
        gain = plain([*shots, (shot.posture, shot.exposure)]) - plain(shots)
        assert shot.gain == pytest.approx(gain)
        assert shot.planned == (gain > 0.0 and gain >= 0.01 * points)
        if shot.planned:
            shots.append((shot.posture, shot.exposure))
    assert found.after == pytest.approx(plain(shots))
    assert len(found.shots) == 4
    assert any(shot.planned for shot in found.shots)
    assert {found.of(posture)[0] for posture in POSTURES[:2]} == {1.0}
    none = plan_exposures(survey, POSTURES[:2], [lights] * 2, offered, least=least, gain_points=100.0)
    assert not any(shot.planned for shot in none.shots)
    assert none.after == none.before


def test_a_target_that_only_further_exposures_reach_is_reached_by_no_more_of_them_than_it_takes(world):
    rig, survey = world
    lights = build_lights(rig)
    without = choose_postures(survey, survey, POSTURES, lights, None, Wanted(target=1.0))
    offered = replace(survey, exposures=(1.0, 0.25, 0.0625))
    all_of_them = choose_postures(offered, offered, POSTURES, lights, None, Wanted(target=1.0)).cover
    assert all_of_them.all_reached > without.cover.all_reached
    target = 0.5 * (all_of_them.all_reached + without.cover.all_reached) / all_of_them.total
    choice = choose_postures(offered, offered, POSTURES, lights, None, Wanted(target=target))
    assert choice.cover.share >= target
    panels = [lights] * len(choice.postures)
    asked = {"least": 1, "gain_points": 100.0}
    none = plan_exposures(survey, choice.postures, panels, offered.exposures, **asked)
    assert none.after == none.before < target
    found = plan_exposures(survey, choice.postures, panels, offered.exposures, target=target, **asked)
    assert found.after >= target
    planned = [shot for shot in found.shots if shot.planned]
    assert found.after - planned[-1].gain < target
