"""Plans of a small part: postures, lights, exposures and tolerances against recounting image by image."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest
from planned import CATALOGUE

from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture, rotation_from_vector
from lightopt.design import (
    OBJECTIVES,
    DetectionModel,
    LevelThresholds,
    Tolerances,
    area_units,
    find_candidates,
    luminance_matrix,
    planned_catalogue,
)
from lightopt.design._blind_spots import planned_visibility
from lightopt.design._misalignment import ObjectiveAssessment, PairAssessment, Setup
from lightopt.design._tolerances import analyse_tolerances
from lightopt.design.postures import _light_positions as placing, _posture_search as turning
from lightopt.design.postures._exposures import plan_exposures
from lightopt.design.postures._plan_postures import choose_with_exposures, target_not_reached
from lightopt.design.postures._posture_search import PostureRequest, choose_postures
from lightopt.design.responses._evidence import UNITS_OF_IMAGE, PatchEvidence, spare_units
from lightopt.design.responses._image_evaluator import ImageCache, ImageEvaluator, drawn_patches
from lightopt.geometry import face_normals
from lightopt.rendering import build_patches, camera_visibility, cast_rays_at, hidden_by
from lightopt.scene import build_catalogue, build_lights, build_scene, obstructions, view_from_part

LIGHTS = """\
lights:
  - {name: light1, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45, elevation_range_deg: [40, 60]}
  - {name: light2, distance_mm: 330, elevation_deg: 50, azimuth_deg: 225, elevation_range_deg: [30, 50]}
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
    inspection = DetectionModel(
        catalogue=planned_catalogue(build_catalogue(part)), sensor=scene.sensor, full_scale=scene.reflectance.full_scale
    )
    evaluator = ImageEvaluator(scene=scene, table=table, caster=caster, detection=inspection, threads=1)
    return rig, drawn_few(evaluator)


def drawn_few(evaluator):
    return replace(evaluator, table=drawn_patches(evaluator.table, 300))


def deciding(evaluator, images):
    """The same with another number of images that must show a defect."""
    return replace(evaluator, detection=replace(evaluator.detection, min_images=images))


def table_at(evaluator, posture, nominal=None):
    """The patches that count in some posture, as the camera sees them in another one near the nominal one."""
    patches = evaluator.table.patches
    facets = face_normals(evaluator.scene.mesh)[patches.face]
    view = view_from_part(evaluator.scene, posture)
    visible, grazing = camera_visibility(patches.centroids, patches.normals, facets, view, evaluator.caster)
    visible &= evaluator.table.inspectable_anywhere
    grazing |= evaluator.table.grazing[evaluator.table.postures.index(nominal or posture)]
    return replace(evaluator.table, postures=(posture,), visible=visible[None], grazing=grazing[None])


def pairs_of(evaluator, posture, panels, *, exposure=1.0, nominal=None):
    """Plain units (image, patch of the part, defect) of one image per panel, however the part lies."""
    patches = evaluator.table.patches
    table = table_at(evaluator, posture, nominal)
    seen = replace(evaluator, table=table).matrices(posture, [[p] for p in panels], exposures=(exposure,))[0].visibility
    units = np.zeros((len(panels), len(patches), len(seen.defects)), int)
    for image, words in enumerate(seen.words):
        bits = np.unpackbits(words[0].view(np.uint8), axis=-1, bitorder="little")
        units[image, seen.patch] = bits.sum(axis=0)[:, : len(seen.defects)]
    assert units.max() <= UNITS_OF_IMAGE
    return units


def confirming(evaluator, shots, panels, *, nominal=None):
    """Units of each pair: of a light's exposures in a posture, which are one image, the best counts."""
    count = 0
    for posture in dict.fromkeys(posture for posture, _ in shots):
        levels = [exposure for other, exposure in shots if other == posture]
        units = [pairs_of(evaluator, posture, panels, exposure=exposure, nominal=nominal) for exposure in levels]
        count = count + np.max(units, axis=0).sum(axis=0)
    return count


def heavy(evaluator):
    """Weight of every pair."""
    areas = np.zeros(len(evaluator.table.patches), np.int64)
    areas[evaluator.patches] = area_units(evaluator.table.patches.areas[evaluator.patches])
    return areas[:, None] * np.array([defect.weight for defect in evaluator.detection.catalogue.defects])


def moved(rig, light, offset):
    config = rig.lights[light]
    config = config.model_copy(
        update={"elevation_deg": config.elevation_deg + offset[0], "azimuth_deg": config.azimuth_deg + offset[1]}
    )
    return build_lights(rig.model_copy(update={"lights": (config,)}))[0]


def setup_of(rig, postures, exposures=((1.0,),)):
    angles = tuple((light.elevation_deg, light.azimuth_deg) for light in rig.lights)
    return Setup(
        rig=rig,
        postures=tuple(postures),
        places=(angles,) * len(postures),
        exposures=tuple(exposures) * (len(postures) // len(exposures)),
    )


def test_drawn_patches_stand_for_all_by_their_area(world):
    _, evaluator = world
    whole = build_patches(evaluator.scene, caster=evaluator.caster, budget=3000)
    drawn = drawn_patches(whole, 200)
    seen = whole.inspectable_anywhere
    left = drawn.inspectable_anywhere
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


@pytest.mark.slow
@pytest.mark.parametrize("least", [1, 2])
def test_tolerances_of_pairs_are_those_of_recounting_every_corner(world, least):
    rig, evaluator = world
    evaluator = deciding(evaluator, least)
    postures = POSTURES[1:3]
    exposures = ((1.0, 0.7), (1.0,))
    # of a pair that both exposures show in part, the better one counts and not their sum
    long, short = (pairs_of(evaluator, postures[0], build_lights(rig), exposure=one) for one in exposures[0])
    assert ((long < UNITS_OF_IMAGE) & (long > 0) & (short > 0)).any()
    assess = PairAssessment(evaluator, setup_of(rig, postures, exposures))
    found = analyse_tolerances(assess, ["light1", "light2"], Tolerances(light_deg=4.0, pose_deg=3.0, draws=3, seed=1))
    weights = heavy(evaluator)

    def plain(pose, offsets):
        panels = [moved(rig, light, offset) for light, offset in enumerate(offsets)]
        count = 0
        for posture, levels in zip(postures, exposures, strict=True):
            there = Posture(posture.elevation_deg + pose[0], posture.rotation_deg + pose[1])
            shots = [(there, exposure) for exposure in levels]
            count = count + confirming(evaluator, shots, panels, nominal=posture)
        return int(weights[count >= evaluator.needed].sum())

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


OTHERS = """\
lights:
  - {name: ring, kind: ring, inner_radius_mm: 60, outer_radius_mm: 80, distance_mm: 250, segments: 2}
  - {name: bar, kind: bar, size_mm: [40, 20], distance_mm: 200, elevation_deg: 40, azimuth_deg: 90}
"""


def rig_of(rig, lights, name):
    """The rig with other lights."""
    text = rig.source.path.read_text(encoding="utf-8")
    head, rest = text.split("lights:\n", 1)
    path = rig.source.path.with_name(f"{name}.yaml")
    path.write_text(head + lights + rest[rest.index("stage:") :], encoding="utf-8")
    return load_rig(path)


def turned(panel, axis, degrees):
    return panel.moved(rotation_from_vector(math.radians(degrees) * np.array(axis)), np.zeros(3))


def test_channels_move_as_one_body_and_a_ring_overhead_tilts_both_ways(world):
    rig, _ = world
    setup = setup_of(rig_of(rig, OTHERS, "others"), POSTURES[:1])
    assert setup.names == ("ring", "bar")
    assert setup.bodies == ((0, 1), (2,))
    nominal = setup.panels(0)
    for offset, axis in (((5.0, 0.0), (-1.0, 0.0, 0.0)), ((0.0, 5.0), (0.0, 1.0, 0.0))):
        for light in (0, 1):
            # at azimuth 270° of the ring, its e_φ is X and its e_θ is Y
            off, expected = setup.panel(0, light, offset), turned(nominal[light], axis, 5.0)
            np.testing.assert_allclose(off.elements, expected.elements, atol=1e-9)
        cosine = off.outward @ nominal[1].outward
        assert cosine == pytest.approx(math.cos(math.radians(5.0)))
    # lower lights are off as their angles in the file would be
    bar = setup.panel(0, 2, (3.0, -7.0))
    np.testing.assert_allclose(bar.elements, moved(setup.rig, 2, (3.0, -7.0)).elements, atol=1e-9)
    assert setup.panel(0, 2, (0.0, 0.0)).centre.tolist() == nominal[2].centre.tolist()


def test_lights_that_a_programme_mixes_are_one_body(world):
    rig, _ = world
    programme = """\
programme:
  - {name: both, lights: {ring-1: 1, bar: 0.5}}
  - {name: half, lights: {ring-2: 1}}
"""
    setup = setup_of(rig_of(rig, OTHERS + programme, "mixed"), POSTURES[:1])
    assert setup.names == ("ring + bar",)
    off = setup.panel(0, 0, (4.0, 0.0))
    np.testing.assert_allclose(off.elements, turned(setup.panels(0)[0], (-1.0, 0.0, 0.0), 4.0).elements, atol=1e-9)


def test_images_of_all_kinds_of_light_are_held_by_their_places(world):
    rig, _ = world
    cache, setup = ImageCache(1_000), setup_of(rig_of(rig, OTHERS, "others"), POSTURES[:1])
    first, second, bar = setup.panels(0)
    cache.keep(POSTURES[0], (1.0,), first, np.arange(3))
    (held,) = cache.find(POSTURES[0], (1.0,), setup.panels(0)[0])
    assert held.tolist() == [0, 1, 2]
    others = (second, bar, setup.panel(0, 0, (1.0, 0.0)))
    assert [cache.find(POSTURES[0], (1.0,), one) for one in others] == [None] * 3


@pytest.mark.parametrize("together", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_tolerances_of_channels_are_those_of_recounting_every_corner(world, together):
    rig, evaluator = world
    evaluator = deciding(evaluator, 2)
    postures = POSTURES[:2]
    setup = setup_of(rig_of(rig, OTHERS, "others"), postures)
    assess = PairAssessment(evaluator, setup, together=together)
    corner = list(product((-12.0, 12.0), repeat=2))  # where the ring hides some of the part
    weights = heavy(evaluator)
    facts = evaluator.detection.sensor, 2
    found, hidden_places = assess((0.0, 0.0), [corner, corner]), 0

    def plain(offsets):
        nonlocal hidden_places
        panels = [setup.panel(0, light, offsets[body]) for light, body in ((0, 0), (1, 0), (2, 1))]
        counts = []
        for posture in postures:
            units = pairs_of(evaluator, posture, panels).sum(axis=0)
            if not together:
                # the bar lights a place in any of its corners, the ring, of which each corner is tried apart, as it is
                every = [panels[:1], panels[1:2], [setup.panel(0, 2, one) for one in corner]]
                levels = evaluator.matrices(posture, every)[0].levels
                seen = evaluator.table.inspectable(posture)
                units[seen] += spare_units(levels, *facts)[:, None]
            standing = obstructions(evaluator.scene.camera, panels)
            if standing is not None:
                scene = replace(evaluator.scene, camera=replace(evaluator.scene.camera, obstructions=standing))
                camera = view_from_part(scene, posture).camera
                hides = hidden_by(camera.obstructions, camera.position, evaluator.table.patches.centroids)
                units[hides] = 0
                hidden_places += int(hides.sum())
            counts.append(units)
        if together:
            return int(weights[sum(counts) >= evaluator.needed].sum())
        return sum(int(weights[one >= evaluator.needed].sum()) for one in counts)

    assert found.tolist() == [plain(offsets) for offsets in product(corner, corner)]
    assert hidden_places
    assert found.min() < found.max()


@pytest.mark.slow
def test_tolerances_of_coverage_are_those_of_recounting_every_corner(world):
    rig, evaluator = world
    postures = POSTURES[:2]
    thresholds = LevelThresholds(shade=10, saturation=255)
    assess = ObjectiveAssessment(
        replace(evaluator, detection=None),
        setup_of(rig, postures),
        objective=OBJECTIVES["coverage"],
        thresholds=thresholds,
    )
    found = analyse_tolerances(assess, ["light1", "light2"], Tolerances(light_deg=6.0, pose_deg=2.0, draws=1))

    def plain(pose, offsets):
        panels = [[moved(rig, light, offset)] for light, offset in enumerate(offsets)]
        total = 0
        for posture in postures:
            there = Posture(posture.elevation_deg + pose[0], posture.rotation_deg + pose[1])
            table = table_at(evaluator, there, posture)
            matrix = luminance_matrix(evaluator.scene, table, there, panels, caster=evaluator.caster)
            levels = np.stack([layer[0] for layer in matrix.levels])
            usable = (levels >= 10) & (levels < 255)
            covered = (usable.sum(axis=0) >= 2) & ((levels >= 255).sum(axis=0) <= 1)
            total += int(area_units(matrix.areas)[covered].sum())
        return total

    corner = list(product((-6.0, 6.0), repeat=2))
    scores = [plain(pose, lights) for pose in product((-2.0, 2.0), repeat=2) for lights in product(corner, repeat=2)]
    assert found.score == plain((0.0, 0.0), [(0.0, 0.0)] * 2)
    assert found.worst == min(scores)


@pytest.mark.parametrize("least", [1, 2])
def test_postures_and_lights_are_chosen_together(world, least):
    rig, evaluator = world
    evaluator = deciding(evaluator, least)
    candidates = find_candidates(rig, step_deg=10.0)
    lights = build_lights(rig)
    choice = choose_postures(evaluator, evaluator, lights, candidates, PostureRequest(count=2))
    weights = heavy(evaluator)
    total = weights[evaluator.patches].sum()

    def plain(some, places):
        panels = [candidates.panels[i][k] for i, k in enumerate(places)]
        count = sum(pairs_of(evaluator, posture, panels).sum(axis=0) for posture in some)
        return int(weights[count >= evaluator.needed].sum())

    assert choice.cover.total == total
    assert choice.cover.covered == plain(choice.postures, choice.lights)
    # no other lights would show more in these postures
    assert choice.exact
    assert choice.converged
    places = list(product(range(3), range(3)))
    assert choice.cover.covered == max(plain(choice.postures, some) for some in places)
    # nor do two other postures beyond the bound
    best = max(plain(two, choice.lights) for two in combinations(POSTURES, 2))
    assert choice.cover.covered <= best <= choice.cover.bound_share * total + 0.5
    alone = choose_postures(evaluator, evaluator, lights, None, PostureRequest(count=2))
    assert alone.lights is None
    assert alone.cover.share == pytest.approx(choice.initial.share)
    assert len(choice.initial.steps) == len(alone.cover.steps)
    # told of lights that moved only: of those that stay the plan itself says what they show
    assert alone.initial_if_moved is None
    moved = any(not np.allclose(a.outward, b.outward) for a, b in zip(choice.panels, lights, strict=True))
    assert choice.initial_if_moved == (choice.initial if moved else None)
    assert choice.cover.share >= alone.cover.share


def test_lights_between_the_candidates_cover_no_more_than_the_bound(world):
    """The bound is that of the best corner of each cell, posture by posture; a finer grid stays below it."""
    rig, evaluator = world
    evaluator, shots = deciding(evaluator, 2), [(posture, (1.0,)) for posture in POSTURES[:2]]
    candidates, finer = (find_candidates(rig, step_deg=step) for step in (10.0, 5.0))
    weights = heavy(evaluator)
    bound = placing.bound_between(evaluator, shots, candidates).score
    units = [
        [pairs_of(evaluator, posture, some) for some in candidates.panels] for posture, _ in shots
    ]  # of each posture and light, shape (positions, patches, defects)

    def best_corners(cells):
        return sum(np.max(own[light][[k, k + 1]], axis=0) for own in units for light, k in enumerate(cells))

    plain = [int(weights[best_corners(cells) >= evaluator.needed].sum()) for cells in product(range(2), repeat=2)]
    assert bound == max(plain)
    found = placing.best_positions(evaluator, shots, finer)
    coarse = placing.best_positions(evaluator, shots, candidates)
    assert coarse.covered <= found.covered <= bound
    assert coarse.covered < bound
    assert placing.bound_between(evaluator, shots, candidates, limit=3) is None


def test_no_image_of_drawn_patches_is_computed_twice(world, monkeypatch):
    rig, evaluator = world
    few = replace(evaluator, table=drawn_patches(evaluator.table, 60))
    candidates = find_candidates(rig, step_deg=10.0)
    # room for what three sets of lights show, fewer than are tried
    size = few.needed * len(POSTURES) * few.weights.masks.shape[1] * len(few.patches) * 8
    monkeypatch.setattr(turning, "CACHED_BYTES", 3 * size)
    computed, tried = [], set()
    compute, counts_under = ImageEvaluator._compute, turning.AlternatingSearch._counts_under

    def watched(self, posture, panels, missing, *rest):
        if self.table.patches is few.table.patches:  # of some of the postures
            some = [panels[at] for at in missing]
            computed.extend((posture, round(one.elevation, 9), round(one.azimuth, 9)) for one in some)
        compute(self, posture, panels, missing, *rest)

    def watched_counts(self, panels, lights):
        tried.add((self.where, lights))
        return counts_under(self, panels, lights)

    monkeypatch.setattr(ImageEvaluator, "_compute", watched)
    monkeypatch.setattr(turning.AlternatingSearch, "_counts_under", watched_counts)
    choose_postures(evaluator, few, build_lights(rig), candidates, PostureRequest(count=2))
    assert len([where for where, _ in tried if where == "drawn patches"]) > 3
    # the rig's own positions are among the candidates
    assert len(computed) == len(set(computed)) > 0


def test_where_positions_are_too_many_for_memory_the_turns_stay_on_drawn_patches(world, monkeypatch):
    rig, evaluator = world
    candidates = find_candidates(rig, step_deg=10.0)
    evaluator = replace(evaluator, table=evaluator.table_of(POSTURES[:2]))
    few = replace(evaluator, table=drawn_patches(evaluator.table, 60))
    ask = (evaluator, few, build_lights(rig), candidates, PostureRequest(count=1))
    free = choose_postures(*ask)
    assert free.on_all_patches
    assert free.converged
    # room for two candidate postures, not for six positions and their sums
    monkeypatch.setattr(placing, "MOST_COUNT_BYTES", 2 * evaluator.needed * len(evaluator.patches) * 8)
    tight = choose_postures(*ask)
    assert not tight.on_all_patches
    assert not tight.converged
    assert tight.iterations < free.iterations
    assert tight.cover.total == free.cover.total, "the figures are of all patches"


def test_the_target_takes_as_few_postures_as_it_needs(world):
    rig, evaluator = world
    lights = build_lights(rig)
    two = choose_postures(evaluator, evaluator, lights, None, PostureRequest(count=2))
    found = choose_postures(evaluator, evaluator, lights, None, PostureRequest(target=two.cover.share))
    assert len(found.postures) <= 2
    assert found.cover.share >= two.cover.share
    never = choose_postures(evaluator, evaluator, lights, None, PostureRequest(target=1.0))
    assert never.cover.share < 1.0
    assert never.cover.min_size is None


def test_reasons_for_an_unreached_target_are_of_the_surface_that_the_shares_are_of(world):
    rig, evaluator = world
    few = replace(evaluator, table=build_patches(evaluator.scene, caster=evaluator.caster, budget=400))
    assert drawn_patches(few.table, 20_000) is few.table, "so few that none are drawn"
    assert len(few.patches) < len(few.table.patches)
    choice = choose_postures(few, few, build_lights(rig), None, PostureRequest(target=1.0))
    text = str(target_not_reached(1.0, choice, few, least=1))
    assert "contrast under noise" in text
    assert "never seen by the camera" not in text
    assert "is not reached: with the present light positions, all" in text
    assert "add them, such as option 'exposures' 1,4,16. Lower the target" in text
    longer = replace(few, exposures=(4.0, 1.0))
    assert "--exposure" not in str(target_not_reached(1.0, choice, longer, least=1))
    # a bound that falls short of the target is not rounded up to it
    steps = (replace(choice.cover.steps[0], covered=900_000),)
    cover = replace(
        choice.cover,
        steps=steps,
        total=1_000_000,
        bounds=(0, 3 * 949_960),
        all_benefit=3 * 960_000,
        all_covered=960_000,
    )
    short = replace(choice, postures=choice.postures[:1], cover=cover)
    assert "show more than 94.996 % with these lights; 95 % are required" in str(
        target_not_reached(0.95, short, few, least=1)
    )


def test_positions_that_memory_has_no_room_for_are_evaluated_in_pieces(world, monkeypatch):
    rig, evaluator = world
    evaluator = replace(evaluator, exposures=(1.0, 0.25, 0.0625))
    candidates = find_candidates(rig, step_deg=5.0)
    setup = setup_of(rig, POSTURES[:2])
    sensor = evaluator.scene.sensor
    thresholds = LevelThresholds.of_sensor(sensor, shade_share=0.0)

    def looks():
        flags = evaluator.flags(POSTURES[0], candidates.panels)
        visibility = planned_visibility(evaluator, setup, candidates, evaluator.exposures, thresholds, 2)
        facts = [(s.counts, s.usable, s.saturated, s.first) for one in visibility for s in (one[2], one[1])]
        return [*flags, *(array for some in facts for array in some)]

    free = looks()
    # room for three places of the five that each light has, at three exposures
    room = 3 * evaluator._position_bytes(len(evaluator.table.inspectable(POSTURES[0])), 3)
    monkeypatch.setattr("lightopt.design.responses._image_evaluator.MOST_BYTES", room)
    monkeypatch.setitem(ImageEvaluator.matrices.__kwdefaults__, "most_bytes", room)
    with pytest.raises(InputError, match="there is room for"):
        evaluator.matrices(POSTURES[0], candidates.panels, exposures=evaluator.exposures)
    for one, other in zip(free, looks(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_images_that_are_kept_are_not_computed_again(world, monkeypatch):
    """Those of the same place of a light, of another object, too; others are computed, and all are the same."""
    rig, evaluator = world
    panels = find_candidates(rig, step_deg=10.0).panels
    fresh = evaluator.matrices(POSTURES[1], panels)
    keeping = replace(evaluator, images=ImageCache(10**9), keeps_images=True)
    keeping.matrices(POSTURES[1], [panels[0], panels[1][1:]])
    evaluated = []
    own = PatchEvidence.evaluate

    def counted(self, panel, *rest, **more):
        evaluated.append(panel)
        return own(self, panel, *rest, **more)

    monkeypatch.setattr(PatchEvidence, "evaluate", counted)
    again = keeping.matrices(POSTURES[1], find_candidates(rig, step_deg=10.0).panels)
    assert len(evaluated) == 1
    for one, other in zip(fresh, again, strict=True):
        for layer in range(2):
            assert np.array_equal(one.levels[layer], other.levels[layer])
            assert np.array_equal(one.visibility.words[layer], other.visibility.words[layer])
    keeping.matrices(POSTURES[1], panels, exposures=(1.0, 4.0))
    assert len(evaluated) == 1 + sum(map(len, panels))


@pytest.mark.parametrize("move", [False, True])
def test_a_target_that_drawn_patches_fall_short_of_is_counted_on_all(world, move):
    rig, evaluator = world
    lights = build_lights(rig)
    candidates = find_candidates(rig, step_deg=10.0) if move else None
    # drawn ones that one posture shows all of that any shows, and that is little
    weights = evaluator.table.patches.areas
    found = [pairs_of(evaluator, posture, lights).sum(axis=0) >= evaluator.needed for posture in POSTURES]
    shown = np.sum(found, axis=2)
    seen = evaluator.table.inspectable_anywhere
    poor = np.flatnonzero(seen & (shown.max(axis=0) == shown[0]))
    poor = poor[np.argsort(shown[0][poor], kind="stable")][:3]
    visible = np.zeros_like(evaluator.table.visible)
    visible[:, poor] = evaluator.table.visible[:, poor]
    few = replace(evaluator, table=replace(evaluator.table, visible=visible))
    assert weights[poor].sum() > 0.0
    by_number = [choose_postures(evaluator, evaluator, lights, candidates, PostureRequest(count=n)) for n in (1, 2, 3)]
    target = by_number[1].cover.share
    assert by_number[0].cover.share < target
    alone = choose_postures(few, few, lights, candidates, PostureRequest(target=target))
    assert alone.cover.share < target, "the drawn ones fall short"
    found = choose_postures(evaluator, few, lights, candidates, PostureRequest(target=target))
    assert found.cover.share >= target
    assert len(found.postures) <= 3


@pytest.mark.parametrize("least", [1, 2])
def test_exposures_are_planned_where_they_add_enough(world, least):
    rig, evaluator = world
    evaluator = deciding(evaluator, least)
    lights = build_lights(rig)
    offered = (1.0, 0.25, 0.0625)
    # a light's exposures do not confirm each other, so that they add little where two images must agree
    points = 1.0 if least == 1 else 0.0
    found = plan_exposures(evaluator, POSTURES[:2], [lights] * 2, offered, gain_points=points)
    weights = heavy(evaluator)
    total = weights[evaluator.patches].sum()

    def plain(shots):
        return int(weights[confirming(evaluator, shots, lights) >= evaluator.needed].sum()) / total

    base = [(posture, 1.0) for posture in POSTURES[:2]]
    assert found.before == pytest.approx(plain(base))
    shots = list(base)
    for shot in found.further:
        gain = plain([*shots, (shot.posture, shot.exposure)]) - plain(shots)
        assert shot.gain == pytest.approx(gain)
        enough = gain > 0.0 and gain >= 0.01 * points
        assert (shot.reason == "gain") == enough
        # since evidence adds up, two may show together what neither shows alone
        assert (shot.reason is not None) == enough or shot.reason == "pair"
        if shot.reason:
            shots.append((shot.posture, shot.exposure))
    pairs = [shot.gain for shot in found.further if shot.reason == "pair"]
    assert len(pairs) % 2 == 0
    for one, other in zip(pairs[::2], pairs[1::2], strict=True):
        assert one + other > 0.0
        assert one + other >= 0.02 * points
    assert found.after == pytest.approx(plain(shots))
    assert len(found.further) == 4
    assert any(shot.reason for shot in found.further)
    assert {found.of(posture)[0] for posture in POSTURES[:2]} == {1.0}
    none = plan_exposures(evaluator, POSTURES[:2], [lights] * 2, offered, gain_points=100.0)
    assert not any(shot.reason for shot in none.further)
    assert none.after == none.before


def test_a_target_that_only_further_exposures_reach_is_reached_by_no_more_of_them_than_it_takes(world):
    rig, evaluator = world
    lights = build_lights(rig)
    without = choose_postures(evaluator, evaluator, lights, None, PostureRequest(target=1.0))
    offered = replace(evaluator, exposures=(1.0, 0.25, 0.0625))
    all_of_them = choose_postures(offered, offered, lights, None, PostureRequest(target=1.0)).cover
    assert all_of_them.all_covered > without.cover.all_covered
    target = 0.5 * (all_of_them.all_covered + without.cover.all_covered) / all_of_them.total
    choice = choose_postures(offered, offered, lights, None, PostureRequest(target=target))
    assert choice.cover.share >= target
    panels = [lights] * len(choice.postures)
    requested = {"gain_points": 100.0}
    none = plan_exposures(evaluator, choice.postures, panels, offered.exposures, **requested)
    assert none.after == none.before < target
    found = plan_exposures(evaluator, choice.postures, panels, offered.exposures, target=target, **requested)
    assert found.after >= target
    planned = [shot for shot in found.further if shot.reason]
    assert found.after - planned[-1].gain < target
    assert {shot.reason for shot in planned} == {"target"}
    assert {shot.reason for shot in found.further if not shot.reason} <= {None}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(3, 8))])
def test_offering_exposures_never_makes_a_plan_worse(world, seed):
    rig, evaluator = world
    rng = np.random.default_rng(seed)
    evaluator = replace(evaluator, table=drawn_patches(evaluator.table, int(rng.integers(40, 300))))
    drawn = replace(evaluator, table=drawn_patches(evaluator.table, 30))
    least, count = int(rng.integers(1, 3)), int(rng.integers(1, 4))
    evaluator, drawn = deciding(evaluator, least), deciding(drawn, least)
    offered = (1.0, *rng.choice([4.0, 0.5, 0.25, 0.0625, 0.02], int(rng.integers(1, 4)), replace=False))
    points = float(rng.choice([0.0, 0.5, 1.0, 5.0]))
    lights, candidates = build_lights(rig), find_candidates(rig, step_deg=10.0)
    ask = (evaluator, drawn, lights, candidates)
    plain = choose_postures(*ask, PostureRequest(count=count))
    choice = choose_with_exposures(
        *ask, PostureRequest(count=count), exposures=offered, gain_points=points, run=RunContext()
    )
    brackets = choice.brackets
    assert choice.cover.share >= plain.cover.share
    assert len(choice.postures) <= count
    # the share is what exactly the planned images show, and the lights serve these best where that is said
    weights = heavy(evaluator)

    def plain_share(places):
        panels = [candidates.panels[i][k] for i, k in enumerate(places)]
        shots = [(posture, exposure) for posture in choice.postures for exposure in brackets.of(posture)]
        return int(weights[confirming(evaluator, shots, panels) >= evaluator.needed].sum())

    assert choice.cover.covered == plain_share(choice.lights)
    assert choice.cover.share == pytest.approx(brackets.after)
    if choice.converged:
        assert choice.cover.covered == max(plain_share(places) for places in product(range(3), range(3)))
    # the bound is what the best of all sets shows at any of the exposures
    best = max(
        int(weights[confirming(evaluator, list(product(some, offered)), choice.panels) >= evaluator.needed].sum())
        for some in combinations(POSTURES, len(choice.postures))
    )
    assert choice.cover.max_covered == best >= choice.cover.covered
    assert choice.cover.sets == math.comb(len(POSTURES), len(choice.postures))
    assert choice.cover.bound_share == best / choice.cover.total
    none = choose_with_exposures(
        *ask, PostureRequest(count=count), exposures=(1.0,), gain_points=points, run=RunContext()
    )
    nothing = none.brackets
    assert nothing is None
    assert none == plain


@pytest.mark.parametrize("seed", range(4))
def test_offering_exposures_never_takes_more_postures_for_a_target(world, seed):
    rig, evaluator = world
    rng = np.random.default_rng(seed)
    evaluator = replace(evaluator, table=drawn_patches(evaluator.table, int(rng.integers(60, 300))))
    lights, candidates = build_lights(rig), find_candidates(rig, step_deg=10.0)
    ask = (evaluator, evaluator, lights, candidates)
    target = 0.9 * choose_postures(*ask, PostureRequest(count=3)).cover.share
    plain = choose_postures(*ask, PostureRequest(target=target))
    choice = choose_with_exposures(
        *ask, PostureRequest(target=target), exposures=(1.0, 0.25, 0.0625), gain_points=1.0, run=RunContext()
    )
    brackets = choice.brackets
    assert choice.cover.share == pytest.approx(brackets.after)
    assert choice.cover.share >= target
    assert (-len(choice.postures), choice.cover.share) >= (-len(plain.postures), plain.cover.share)


def test_a_target_that_nothing_offered_reaches_has_no_exposures(world):
    rig, evaluator = world
    ask = (evaluator, evaluator, build_lights(rig), None, PostureRequest(target=1.0))
    choice = choose_with_exposures(*ask, exposures=(1.0, 0.25), gain_points=1.0, run=RunContext())
    brackets = choice.brackets
    assert brackets is None
    assert choice.cover.share < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("least", [1, 2])
@pytest.mark.parametrize("drawn", [40, pytest.param(300, marks=pytest.mark.nightly)])
def test_a_number_and_a_target_that_takes_as_many_give_the_same_plan(world, least, drawn):
    rig, evaluator = world
    evaluator = deciding(evaluator, least)
    few = replace(evaluator, table=drawn_patches(evaluator.table, drawn))
    ask = (evaluator, few, build_lights(rig), find_candidates(rig, step_deg=10.0))
    by_number = {n: choose_postures(*ask, PostureRequest(count=n)) for n in (1, 2, 3, 4)}
    for n, choice in by_number.items():
        found = choose_postures(*ask, PostureRequest(target=choice.cover.share))
        assert len(found.postures) <= n
        same = by_number[len(found.postures)]
        assert (found.postures, found.lights) == (same.postures, same.lights)
        assert found.cover.share == same.cover.share >= choice.cover.share
        capped = choose_postures(*ask, PostureRequest(count=n, target=choice.cover.share))
        assert (capped.postures, capped.lights) == (found.postures, found.lights)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_more_starts_are_never_worse_than_the_lights_as_they_stand_alone(world, count):
    rig, evaluator = world
    wanted = PostureRequest(count=count)
    candidates = find_candidates(rig, step_deg=5.0)
    turns = turning.AlternatingSearch(evaluator, candidates, where="all patches", prove=True, run=RunContext())
    lights = build_lights(rig)
    begin = turning.Solution(panels=lights, cover=turns.cover(lights, None, wanted), converged=False)
    alone = turns.improve(begin, 6, wanted)
    found = choose_postures(evaluator, evaluator, build_lights(rig), candidates, wanted)
    assert found.starts > 1
    assert found.cover.covered >= alone.cover.covered
    # nor does any single other posture better it
    weights = heavy(evaluator)
    units = [pairs_of(evaluator, posture, found.panels).sum(axis=0) for posture in POSTURES]
    for out, other in product(found.postures, set(POSTURES) - set(found.postures)):
        some = [*(set(found.postures) - {out}), other]
        shown = np.sum([units[POSTURES.index(posture)] for posture in some], axis=0)
        assert int(weights[shown >= evaluator.needed].sum()) <= found.cover.covered
