"""Surface seen at more than 80° to its normal is in no score and no share, which then are those of any mesh."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lightopt.config import load_part, load_rig
from lightopt.core.transforms import Posture
from lightopt.design import (
    OBJECTIVES,
    DetectionModel,
    LevelThresholds,
    area_units,
    find_candidates,
    luminance_matrix,
    planned_catalogue,
    search,
)
from lightopt.design.responses._image_evaluator import ImageEvaluator, drawn_patches
from lightopt.rendering import GRAZING_DEG, build_patches, cast_rays_at
from lightopt.scene import build_catalogue, build_scene

SAMPLES = Path(__file__).resolve().parents[2] / "configs"

DISTANCE, RADIUS = 550.0, 15.0

RIG = f"""\
format: lightopt-rig/1
name: four
camera:
  {{distance_mm: {DISTANCE:g}, elevation_deg: 90, resolution_px: [400, 300], pixel_size_um: 17.6, image_distance_mm: 55,
    sensor: {{bit_depth: 8}}}}
light_source: {{size_mm: [60, 60], points: 1}}
lights:
""" + "".join(
    f"  - {{name: light{k}, distance_mm: 330, elevation_deg: 60, azimuth_deg: {45 + 90 * k}, "
    "elevation_range_deg: [30, 60]}\n"
    for k in range(4)
)


@pytest.fixture
def ball(tmp_path):
    """A sphere about the origin under the camera, 4,000 patches, and the rig."""
    trimesh.creation.icosphere(subdivisions=4, radius=RADIUS).export(tmp_path / "ball.stl")
    rig, part = tmp_path / "rig.yaml", tmp_path / "part.yaml"
    rig.write_text(RIG, encoding="utf-8")
    part.write_text(
        "format: lightopt-part/1\nname: ball\nmesh: {file: ball.stl, units: mm}\n"
        "placement: {anchor: as_modelled}\nreflectance: {R_d: 45, R_s: 0, sigma_rad: 0.1}\n",
        encoding="utf-8",
    )
    return load_rig(rig), load_part(part)


def caps():
    """Areas of a sphere seen at up to 80° to the normal, and at all."""
    grazing = math.radians(GRAZING_DEG)
    # triangle of centre, point and camera: 180° − 80° at the point
    at_camera = math.asin(RADIUS * math.sin(grazing) / DISTANCE)
    inspectable = 1.0 - math.cos(grazing - at_camera)
    return tuple(2.0 * math.pi * RADIUS**2 * share for share in (inspectable, 1.0 - RADIUS / DISTANCE))


def test_scores_and_shares_of_a_sphere_are_of_the_cap_that_is_seen_at_up_to_80_degrees(ball):
    rig, part = ball
    scene = build_scene(rig, part)
    caster = cast_rays_at(scene)
    (posture,) = scene.postures
    table = build_patches(scene, caster=caster, budget=4000)
    inspectable, visible = caps()
    candidates = find_candidates(rig, step_deg=30.0)
    inspection = DetectionModel(
        catalogue=planned_catalogue(build_catalogue(part)), sensor=scene.sensor, full_scale=255.0
    )
    matrix = luminance_matrix(scene, table, posture, candidates.panels, caster=caster, detection=inspection)
    assert matrix.areas.sum() == pytest.approx(inspectable, rel=0.01)
    assert matrix.areas.sum() + matrix.grazing_mm2 == pytest.approx(visible, rel=0.01)
    assert matrix.visibility is not None
    assert len(matrix.visibility.patch) == len(matrix.areas)
    both = np.intersect1d(matrix.visibility.patch, matrix.visibility.grazing)
    assert not len(both)
    # a plan's pairs are on the same patches, drawn or not
    evaluator = ImageEvaluator(scene=scene, table=table, caster=caster, detection=inspection)
    assert evaluator.weights.areas.sum() == pytest.approx(inspectable * 1e6, rel=0.01)
    drawn = replace(evaluator, table=drawn_patches(table, 500))
    assert drawn.weights.areas.sum() == pytest.approx(inspectable * 1e6, rel=0.02)
    # seen obliquely in one posture and well in another, a patch counts
    tilted = replace(scene, postures=(posture, Posture(30.0, 0.0)))
    two = replace(evaluator, scene=tilted, table=build_patches(tilted, caster=caster, budget=4000))
    assert two.weights.areas.sum() > evaluator.weights.areas.sum()


MESHES = (0.05, 0.02, 0.002)
"""Chord tolerances [mm]: 4,000 to 97,000 triangles."""


@pytest.fixture(scope="module")
def knob():
    """The sample knob tessellated coarsely to very finely: its best lights, and its scores under both rules."""
    rig = load_rig(SAMPLES / "rigs" / "four-panel.yaml")
    part = load_part(SAMPLES / "parts" / "cover-knob.yaml")
    found = {}
    for tolerance in MESHES:
        mesh = part.mesh.model_copy(update={"chord_tolerance_mm": tolerance})
        scene = build_scene(rig, part.model_copy(update={"mesh": mesh}), points=1)
        scene = replace(scene, postures=scene.postures[:1])
        caster = cast_rays_at(scene)
        table = build_patches(scene, caster=caster, budget=2000)
        candidates = find_candidates(rig, step_deg=30.0, points=1, scene=scene)
        thresholds = LevelThresholds.of_sensor(scene.sensor, shade_share=10 / 255)
        for counted in (False, True):
            some = replace(table, grazing=np.zeros_like(table.grazing)) if counted else table
            matrix = luminance_matrix(scene, some, scene.postures[0], candidates.panels, caster=caster)
            best = search([matrix], OBJECTIVES["coverage"], thresholds)
            area = int(area_units(matrix.areas).sum())
            shares = {ranked.candidates: ranked.score / area for ranked in best.ranking}
            found[tolerance, counted] = best.best.candidates, shares
    return found


@pytest.mark.slow
def test_the_best_share_and_the_best_lights_are_those_of_any_mesh(knob):
    for one, other in combinations(MESHES, 2):
        (coarse_best, coarse), (fine_best, fine) = knob[one, False], knob[other, False]
        assert len(coarse) == len(fine) == 16
        assert coarse[coarse_best] == pytest.approx(fine[fine_best], abs=0.005)
        # the same lights, or no more than half a point behind
        assert fine[coarse_best] > fine[fine_best] - 0.005
        assert coarse[fine_best] > coarse[coarse_best] - 0.005


@pytest.mark.slow
def test_with_grazing_surface_counted_the_answer_moves_with_the_mesh_and_reverses(knob):
    (coarse_best, coarse), (fine_best, fine) = knob[0.05, True], knob[0.02, True]
    assert abs(coarse[coarse_best] - fine[fine_best]) > 0.005
    high = max(knob[0.02, False][1])
    # all lights high: nearly the best of what can be inspected, far behind where the vertical wall counts
    assert knob[0.02, False][1][high] > knob[0.02, False][1][knob[0.02, False][0]] - 0.005
    assert fine[high] < fine[fine_best] - 0.02
