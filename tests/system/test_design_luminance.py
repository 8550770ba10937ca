"""The luminance matrix is what the camera would deliver of each patch, and the search over it is section 5.2's."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import reference as ref
from reference._search import all_combinations, coverage_value, paper_value
from worlds import PAPER, PARTS, posed_corners, scene_from_files

from lightopt.config import load_rig
from lightopt.core.transforms import Posture
from lightopt.design import OBJECTIVES, LevelThresholds, area_units, find_candidates, luminance_matrix, search
from lightopt.design.responses._image_evaluator import patch_points
from lightopt.rendering import build_patches, cast_rays_at, render_posture

LIGHTS = [
    ref.Light(elevation=45.0, azimuth=20.0),
    ref.Light(elevation=35.0, azimuth=150.0, gain=0.8, size=(50.0, 30.0)),
    ref.Light(elevation=60.0, azimuth=260.0, falloff="inverse_square", emission=1.0),
]
RANGES = ((40.0, 50.0), None, (55.0, 65.0))
THRESHOLDS = LevelThresholds(shade=10, saturation=255)


def small_scene(folder, part, *, points=None, postures=((0, 0), (-10, 170))):
    camera = ref.Camera(width=160, height=120, pixel_um=44.0)
    scene = scene_from_files(folder, camera, LIGHTS, PARTS / f"{part}.stl", points=points, postures=postures)
    rig = load_rig(folder / "rig.yaml")
    lights = tuple(
        light.model_copy(update={"elevation_range_deg": ends}) for light, ends in zip(rig.lights, RANGES, strict=True)
    )
    return scene, rig.model_copy(update={"lights": lights})


def matrix_of(scene, rig, posture, *, budget, step=5.0, shadows=True, threads=2):
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=budget)
    found = find_candidates(rig, step_deg=step)
    matrix = luminance_matrix(scene, table, posture, found.panels, caster=caster, shadows=shadows, threads=threads)
    return matrix, found, table


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "shadows"),
    [
        ("spout", True),
        ("cover-knob", False),
        *(pytest.param(*case, marks=pytest.mark.nightly) for case in (("cover-knob", True), ("spout", False))),
    ],
)
def test_levels_are_those_of_the_equations_at_the_centroids(tmp_path, part, shadows):
    """Plain NumPy equations at every visible centroid, quantised; a level may differ where it is at a rounding edge."""
    scene, rig = small_scene(tmp_path, part)
    posture = scene.postures[1]
    matrix, found, table = matrix_of(scene, rig, posture, budget=400, shadows=shadows)
    surface, seen = patch_points(scene, table, posture)
    assert len(seen) == matrix.levels[0].shape[1] > 300
    triangles, _ = posed_corners(scene.mesh, (posture.elevation_deg, posture.rotation_deg))
    at = {
        "point": ref.posed(surface.points, posture.elevation_deg, posture.rotation_deg),
        "normal": ref.posed_normals(surface.normals, posture.elevation_deg, posture.rotation_deg),
        "geometric": ref.posed_normals(surface.facets, posture.elevation_deg, posture.rotation_deg),
    }
    eye = scene.camera.position - at["point"]
    hits = SimpleNamespace(**at, view=eye / np.linalg.norm(eye, axis=1, keepdims=True))
    differing = total = 0
    for light, layer, angles in zip(LIGHTS, matrix.levels, found.places, strict=True):
        for row, (elevation, azimuth) in zip(layer, angles, strict=True):
            panel = replace(light, elevation=elevation, azimuth=azimuth)
            level = np.zeros(len(seen))
            for source, weight in zip(*panel.points(), strict=True):
                terms = sum(ref.point_terms(hits, panel, source, **PAPER))
                dark = ref.in_shadow(hits, source, triangles) if shadows else np.zeros(len(seen), bool)
                level += panel.gain * weight * np.where(dark, 0.0, terms)
            expected = np.clip(np.floor(level + 0.5), 0, 255)
            differing += np.count_nonzero(expected != row)
            total += len(row)
    assert [len(layer) for layer in matrix.levels] == [3, 1, 3]
    assert differing <= 1e-3 * total


def test_levels_are_those_of_the_image_and_do_not_depend_on_threads(tmp_path):
    """A patch and the pixel in its middle differ by what they average only; all but a few levels are equal or next."""
    scene, rig = small_scene(tmp_path, "cover-knob")
    posture = scene.postures[0]
    matrix, found, table = matrix_of(scene, rig, posture, budget=20_000)
    again, _, _ = matrix_of(scene, rig, posture, budget=20_000, threads=1)
    for one, other in zip(matrix.levels, again.levels, strict=True):
        np.testing.assert_array_equal(one, other)
    images = render_posture(scene, posture, caster=cast_rays_at(scene), patches=table.patches)
    _, seen = patch_points(scene, table, posture)
    row_of = np.full(len(table.patches), -1)
    row_of[seen] = np.arange(len(seen))
    shown = images.geometry.patch
    pixels = np.flatnonzero((shown >= 0).ravel())
    pixels = pixels[row_of[shown.ravel()[pixels]] >= 0]
    now = found.places[0].index((45.0, 20.0))
    image = np.clip(np.floor(images.lights[0].level.ravel()[pixels] + 0.5), 0, 255)
    patch = matrix.levels[0][now, row_of[shown.ravel()[pixels]]].astype(float)
    assert np.median(np.abs(image - patch)) <= 1
    assert np.mean((image >= 255) == (patch >= 255)) > 0.99


def test_converged_panels(tmp_path):
    """points: auto agrees with many points, and never exceeds the same panel without shadows."""
    scene, rig = small_scene(tmp_path, "spout", points="auto")
    posture = scene.postures[0]
    matrix, _, _ = matrix_of(scene, rig, posture, budget=1500)
    bare, _, _ = matrix_of(scene, rig, posture, budget=1500, shadows=False)
    (tmp_path / "many").mkdir()
    many_scene, many_rig = small_scene(tmp_path / "many", "spout", points=256)
    many, _, _ = matrix_of(many_scene, many_rig, posture, budget=1500)
    for auto, open_sky, points in zip(matrix.levels, bare.levels, many.levels, strict=True):
        assert (auto <= open_sky).all()
        assert np.mean(np.abs(auto.astype(int) - points) <= 1) > 0.97


@pytest.mark.parametrize("part", ["cover-knob", "spout"])
def test_plain_reading_on_sample_parts(tmp_path, part):
    """The fast search and the plain loop agree on real matrices, for both objectives and each posture."""
    scene, rig = small_scene(tmp_path, part)
    for posture in scene.postures:
        matrix, _, _ = matrix_of(scene, rig, posture, budget=2000, step=2.5)
        units = area_units(matrix.areas)
        ones = np.ones(len(units), np.int64)
        for name, value, weights in (
            ("paper", lambda columns: paper_value(columns, 10, 255), ones),
            ("coverage", lambda columns, units=units: coverage_value(columns, 10, 255, units), units),
        ):
            expected = all_combinations(matrix.levels, value, 10, 255, weights)
            found = search([matrix], OBJECTIVES[name], THRESHOLDS, keep=25)
            ranked = [r.sort_key for r in found.ranking]
            assert ranked == expected[:25]


def test_coverage_hardly_changes_when_the_mesh_is_refined_anew(tmp_path):
    """The same positions on another refinement cover the same area to within 1 %."""
    scene, rig = small_scene(tmp_path, "cover-knob", postures=((0, 0),))
    posture = Posture(0.0, 0.0)
    scores = []
    for budget in (12_000, 30_000):
        matrix, _, _ = matrix_of(scene, rig, posture, budget=budget)
        objective = OBJECTIVES["coverage"]
        scores.append(objective.scores(matrix, area_units(matrix.areas), THRESHOLDS, 2, None))
    np.testing.assert_allclose(scores[0], scores[1], rtol=0.01)
