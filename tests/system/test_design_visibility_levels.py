"""Which defects an image shows is what the equations say of a leaning or stained patch; levels stay as they were."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import reference as ref
from test_design_luminance import LIGHTS, matrix_of, small_scene
from worlds import PAPER, posed_corners

from lightopt.defects import BUILT_IN_CATALOGUE, PIXEL_RATIOS, DefectShape, pixel_shares, tangent_direction
from lightopt.design import Contrast, DetectionModel, defect_hypotheses, find_candidates, luminance_matrix
from lightopt.design.responses._image_evaluator import ImageEvaluator, patch_points
from lightopt.optics import Sensor
from lightopt.rendering import (
    build_patches,
    cast_rays_at,
    converged_panel,
    shade_converged,
    shade_variants,
    surface_variants,
)
from lightopt.rendering._converged_panel import panel_probes, probe_targets
from lightopt.scene import pixel_footprint, view_from_part

TRIALS = defect_hypotheses(BUILT_IN_CATALOGUE)
SENSOR = Sensor(bit_depth=8, saturation_level=240, black_level=6, read_noise_levels=0.8, electrons_per_level=60)


def flags(words, count):
    """Bits t % 64 of words t // 64 as flags."""
    return np.stack([words[..., t // 64] >> np.uint64(t % 64) & np.uint64(1) for t in range(count)], -1) == 1


def leaning(normals, axes, slope, direction):
    towards = [tangent_direction(n, direction, x_axis=axes[:, 0], y_axis=axes[:, 1]) for n in normals]
    return math.cos(slope) * normals + math.sin(slope) * np.array(towards)


@pytest.mark.slow
@pytest.mark.parametrize("shadows", [True, pytest.param(False, marks=pytest.mark.nightly)])
def test_bits_are_the_definition_in_plain_numpy(tmp_path, shadows):
    """Plain equations at every visible centroid for each defect; a bit may differ where the contrast is at its edge."""
    scene, rig = small_scene(tmp_path, "spout")
    scene = replace(scene, sensor=SENSOR)
    posture = scene.postures[1]
    inspection = DetectionModel(hypotheses=TRIALS, contrast=Contrast(sensor=SENSOR, full_scale=255.0, threshold=5.0))
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=60)
    panels = find_candidates(rig, step_deg=10.0).panels
    exposures = (1.0, 0.25)
    evaluator = ImageEvaluator(scene=scene, table=table, caster=caster, detection=inspection, shadows=shadows)
    found = evaluator.matrices(posture, panels, exposures=exposures)
    surface, seen = patch_points(scene, table, posture)
    visibility = found[0].visibility
    assert visibility is not None
    np.testing.assert_array_equal(visibility.patch, seen)
    turn = posture.elevation_deg, posture.rotation_deg
    triangles, _ = posed_corners(scene.mesh, turn)
    eye = scene.camera.position - ref.posed(surface.points, *turn)
    camera = view_from_part(scene, posture).camera
    footprint = pixel_footprint(camera, 1.0) * ((surface.points - camera.position) @ camera.forward)
    cosine = np.einsum("ij,ij->i", surface.normals, surface.views)
    angles = [
        [(40.0, 20.0), (45.0, 20.0), (50.0, 20.0)],
        [(35.0, 150.0)],
        [(55.0, 260.0), (60.0, 260.0), (65.0, 260.0)],
    ]

    dark = {}

    @cache
    def leaning_by(slope, direction):
        return leaning(surface.normals, scene.placement.rotation, slope, direction)

    def level(light, at, normals, reflectance):
        hits = SimpleNamespace(
            point=ref.posed(surface.points, *turn),
            normal=ref.posed_normals(normals, *turn),
            geometric=ref.posed_normals(surface.facets, *turn),
            view=eye / np.linalg.norm(eye, axis=1, keepdims=True),
        )
        panel = replace(light, elevation=at[0], azimuth=at[1])
        total = np.zeros(len(seen))
        for source, weight in zip(*panel.points(), strict=True):
            terms = sum(ref.point_terms(hits, panel, source, **reflectance))
            if tuple(source) not in dark:
                dark[tuple(source)] = shadows & ref.in_shadow(hits, source, triangles)
            total += panel.gain * weight * np.where(dark[tuple(source)], 0.0, terms)
        return total

    side = footprint / np.sqrt(np.maximum(cosine, 1e-9))

    def changes(trial, change):
        """What the two pixels see, from what each wall of the same defect does to a pixel that it fills."""
        own = change(trial)
        others = [other for other in TRIALS if other.name == trial.name]
        if trial.kind == "scratch":
            others = [trial, others[(others.index(trial) + 4) % 8]]
        common = sum(change(other) for other in others) / len(others)
        shape = DefectShape(kind=trial.kind, length=trial.length, width=trial.width, slope=trial.slope)
        ratio, table = side / trial.width, pixel_shares(shape)
        share = [np.interp(np.log(ratio), np.log(PIXEL_RATIOS), table[:, i]) for i in range(4)]
        share = np.where(ratio < PIXEL_RATIOS[0], 1.0, share)
        share = share * np.minimum(1.0, PIXEL_RATIOS[-1] / ratio) ** 2
        return [share[i] * (own - common) + share[i + 1] * common for i in (0, 2)]

    differing = shown = total = 0
    for light, ends in ((0, (0,)), (1, (-1,)), (2, (0,))):
        for k in ends:
            at = angles[light][k]
            good = level(LIGHTS[light], at, surface.normals, PAPER)
            own = [flags(one.visibility.words[light][k], len(TRIALS)) for one in found]
            filled = {}

            def change(trial, light=light, at=at, good=good, filled=filled):
                if trial not in filled:
                    changed = {
                        "R_d": PAPER["R_d"] * trial.R_d_factor,
                        "R_s": PAPER["R_s"] / trial.sigma_factor**2,
                        "sigma": PAPER["sigma"] * trial.sigma_factor,
                    }
                    filled[trial] = level(LIGHTS[light], at, leaning_by(trial.slope, trial.direction), changed) - good
                return filled[trial]

            for t in (*range(0, len(TRIALS), 5), len(TRIALS) - 1):
                two = changes(TRIALS[t], change)
                for index, exposure in enumerate(exposures):
                    a = np.minimum(240, 6 + exposure * good)
                    noise = np.sqrt(0.8**2 + (a - 6) / 60 + 1 / 12)
                    expected = np.zeros(len(seen), bool)
                    for one in two:
                        b = np.minimum(240, 6 + exposure * (good + one))
                        expected |= np.abs(b - a) >= 5 * noise
                    expected &= cosine >= math.cos(math.radians(80))
                    differing += np.count_nonzero(expected != own[index][:, t])
                    shown += np.count_nonzero(expected)
                    total += len(expected)
    assert 0.02 < shown / total < 0.98
    assert differing <= 2e-4 * total


@pytest.mark.parametrize("points", [None, "auto"])
def test_levels_are_the_same_with_and_without_defects_and_threads(tmp_path, points):
    scene, rig = small_scene(tmp_path, "spout", points=points)
    posture = scene.postures[0]
    plain, found, table = matrix_of(scene, rig, posture, budget=120)
    inspection = DetectionModel(hypotheses=TRIALS, contrast=Contrast(sensor=scene.sensor, full_scale=255.0))
    caster = cast_rays_at(scene)
    examined = [
        luminance_matrix(scene, table, posture, found.panels, caster=caster, detection=inspection, threads=threads)
        for threads in (1, 3)
    ]
    for one, other in zip(plain.levels, examined[0].levels, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(examined[0].visibility.words, examined[1].visibility.words, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_converged_panels_on_leaning_patches(tmp_path):
    """Where the panel is seen whole, what the renderer itself says of the turned normal; in penumbrae nearly."""
    scene, _ = small_scene(tmp_path, "spout", points="auto")
    posture = scene.postures[0]
    caster = cast_rays_at(scene)
    table = build_patches(scene, caster=caster, budget=60)
    surface, _ = patch_points(scene, table, posture)
    axes = scene.placement.rotation
    references = np.array([tangent_direction(n, 0.0, x_axis=axes[:, 0], y_axis=axes[:, 1]) for n in surface.normals])
    few = [TRIALS[k] for k in (3, 12, 25, -2, -1)]
    variants = surface_variants(
        slope=np.array([trial.slope for trial in few]),
        direction=np.array([trial.direction for trial in few]),
        R_d_factor=np.array([trial.R_d_factor for trial in few]),
        sigma_factor=np.array([trial.sigma_factor for trial in few]),
        reflectance=scene.reflectance,
    )
    for light in view_from_part(scene, posture).lights:
        probes = panel_probes(surface, probe_targets(light), caster).sum(axis=1)
        whole = (probes == 0) | (probes == 5)
        panel = converged_panel(light, centre=caster.centre, radius=caster.radius)
        found = shade_variants(surface, references, panel, variants, reflectance=scene.reflectance, caster=caster)
        for t, trial in enumerate(few):
            changed = scene.reflectance.changed(R_d_factor=trial.R_d_factor, sigma_factor=trial.sigma_factor)
            turned = replace(surface, normals=leaning(surface.normals, axes, trial.slope, trial.direction))
            diffuse, specular, _ = shade_converged(
                turned,
                panel,
                sample=2 * np.arange(len(surface)),
                shape=(1, 2 * len(surface)),
                reflectance=changed,
                caster=caster,
            )
            exact = changed.R_d * diffuse + changed.R_s * specular
            off = np.abs(np.minimum(found.varied[t], 255) - np.minimum(exact, 255))
            assert (off[whole] < 0.02).all()
            assert np.mean(off < 3.0) > 0.98
