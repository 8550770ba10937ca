"""Panels from a mirror ball: mirror points against Fermat's principle, known panels found again, images rendered."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import rig_targets as targets
import trimesh
from rig_targets import CAMERA, LIGHTS, POSTURES, RADIUS, STAGE
from scipy.optimize import minimize

from lightopt.core.errors import InputError
from lightopt.estimate.rig_calibration._ball_fit import (
    PANEL_PARAMETERS,
    MirroredPanel,
    fit_ball,
    mirror_points,
    mirrored_image,
    outline_distances,
)
from lightopt.estimate.rig_calibration._ball_images import measure_ball
from lightopt.estimate.rig_calibration._board_fit import filed_covariance
from lightopt.estimate.rig_calibration._deviations import displaced
from lightopt.geometry import TriangleMesh
from lightopt.lights import panel_corners
from lightopt.optics import Reflectance, Sensor, expose
from lightopt.rendering import render
from lightopt.scene import Scene
from lightopt.scene._camera import Distortion


@pytest.mark.parametrize("seed", range(4))
def test_mirror_point_is_where_the_path_is_shortest(seed):
    rng = np.random.default_rng(seed)
    centre, radius = rng.normal(0.0, 5.0, 3), rng.uniform(2.0, 15.0)
    eye, point = np.array([0.0, 0.0, 550.0]), np.array([150.0, 80.0, 250.0]) + rng.normal(0.0, 40.0, 3)

    def place(angles):
        s, t = angles
        return centre + radius * np.array([math.sin(s) * math.cos(t), math.sin(s) * math.sin(t), math.cos(s)])

    shortest = minimize(
        lambda a: np.linalg.norm(place(a) - eye) + np.linalg.norm(place(a) - point),
        [0.3, 0.5],
        method="Nelder-Mead",
        options={"xatol": 1e-10, "fatol": 1e-13, "maxiter": 4000},
    )
    # a length is flat at its minimum: half of the digits
    assert np.allclose(mirror_points(centre, radius, eye, point), place(shortest.x), atol=1e-5)


def test_mirror_points_reflect_in_the_plane_of_incidence():
    points = np.random.default_rng(0).normal(0.0, 200.0, (500, 3)) + np.array([0.0, 0.0, 300.0])
    centre, eye = np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 550.0])
    found = mirror_points(centre, RADIUS, eye, points)
    seen = np.isfinite(found[:, 0])
    assert seen.mean() > 0.9
    normal = (found - centre)[seen] / RADIUS
    to_eye, to_point = eye - found[seen], points[seen] - found[seen]
    to_eye /= np.linalg.norm(to_eye, axis=1)[:, None]
    to_point /= np.linalg.norm(to_point, axis=1)[:, None]
    assert np.allclose(2.0 * np.sum(normal * to_eye, axis=1)[:, None] * normal - to_eye, to_point, atol=1e-9)


def test_point_behind_the_ball_is_not_mirrored():
    assert np.isnan(mirror_points(np.zeros(3), 10.0, np.array([0.0, 0.0, 550.0]), np.array([0.0, 1.0, -300.0]))).all()


@pytest.mark.parametrize("distortion", [Distortion(), Distortion(k1=-0.2, p1=0.001)])
def test_outline_is_where_lines_of_sight_touch_the_ball(distortion):
    camera = replace(CAMERA, distortion=distortion, principal_point=(790.0, 610.0))
    centre = np.array([12.0, -9.0, 20.0])
    points = targets.outline_points(centre, RADIUS, 60, camera)
    assert np.abs(outline_distances(camera, centre, RADIUS, points)).max() < 1e-6
    # in pixels, outward
    middle = points.mean(axis=0)
    outward = (points - middle) / np.linalg.norm(points - middle, axis=1)[:, None]
    assert np.allclose(outline_distances(camera, centre, RADIUS, points + 0.3 * outward), 0.3, atol=2e-3)


def fitted(seed, **options):
    rng = np.random.default_rng(seed)
    panels = targets.moved_panels(rng)
    centre = np.array([3.0, -2.0, 12.0]) + rng.normal(0.0, 1.0, 3)
    views = targets.ball_views(rng, panels, centre)
    options = {"lights": LIGHTS, "camera": CAMERA, "stage": STAGE, "radius": RADIUS, "size_error": 0.1, **options}
    return panels, centre, fit_ball(views, **options)


def statistics(seeds):
    errors, scores = [], []
    for seed in range(seeds):
        panels, _, fit = fitted(seed)
        assert fit.left_out == ()
        assert fit.unobservable == ()
        for light, true, half in zip(fit.lights, panels, fit.half_widths_95, strict=True):
            own, offset = targets.panel_errors(light, true)
            errors.append(own)
            scores.append(np.concatenate([offset, own[3:]]) / half)
    return np.sqrt(np.mean(np.square(errors), axis=0)), np.abs(scores) <= 1.0


@pytest.mark.slow
def test_panels_are_found_and_intervals_hold():
    rms, covered = statistics(4)
    assert rms[:2].max() < 0.3  # lateral [mm]
    assert rms[2] < 1.5  # range [mm]
    assert np.degrees(rms[3:5]).max() < 1.3  # normal, for a few seeds
    assert covered.mean() > 0.85


@pytest.mark.nightly
def test_intervals_cover_as_often_as_they_say():
    rms, covered = statistics(200)
    assert rms[:2].max() < 0.3
    assert rms[2] < 1.5
    assert np.degrees(rms[3:5]).max() < 1.0
    assert 0.92 < covered.mean() < 0.98
    assert covered.mean(axis=0).min() > 0.92
    assert covered.mean(axis=0).max() < 0.98


def test_exact_views_give_the_panels_exactly():
    rng = np.random.default_rng(7)
    panels, centre = targets.moved_panels(rng, size_error=0.0), np.array([3.0, -2.0, 12.0])
    views = targets.ball_views(rng, panels, centre, corner=1e-6, outline=1e-6)
    fit = fit_ball(views, lights=LIGHTS, camera=CAMERA, stage=STAGE, radius=RADIUS)
    assert np.allclose(fit.centre, centre, atol=1e-5)
    for light, true in zip(fit.lights, panels, strict=True):
        assert np.abs(targets.panel_errors(light, true)[0]).max() < 1e-2
    assert all(light.reference_distance == pytest.approx(330.0) for light in fit.lights)


def test_wrong_image_is_left_out_and_named():
    rng = np.random.default_rng(3)
    panels, centre = targets.moved_panels(rng), np.array([3.0, -2.0, 12.0])
    views = targets.ball_views(rng, panels, centre)
    image = views[2].panels["light2"]
    wrong = MirroredPanel(corners=image.corners + np.array([4.0, -3.0]), covariance=image.covariance)
    views[2] = replace(views[2], panels={**views[2].panels, "light2": wrong})
    fit = fit_ball(views, lights=LIGHTS, camera=CAMERA, stage=STAGE, radius=RADIUS, size_error=0.1)
    assert fit.left_out == ((POSTURES[2], "light2"),)
    assert abs(targets.panel_errors(fit.lights[1], panels[1])[0][0]) < 0.4


def test_light_that_no_view_shows_is_unobservable():
    rng = np.random.default_rng(5)
    panels = targets.moved_panels(rng)
    views = targets.ball_views(rng, panels[:3], np.array([3.0, -2.0, 12.0]))
    fit = fit_ball(views, lights=LIGHTS, camera=CAMERA, stage=STAGE, radius=RADIUS, size_error=0.1)
    assert fit.unobservable == tuple(f"light4 {name}" for name in PANEL_PARAMETERS[:6])


def test_one_tilt_is_refused():
    rng = np.random.default_rng(1)
    views = targets.ball_views(rng, LIGHTS, np.array([3.0, -2.0, 12.0]), postures=POSTURES[:4])
    with pytest.raises(InputError, match="another tilt"):
        fit_ball(views, lights=LIGHTS, camera=CAMERA, stage=STAGE, radius=RADIUS)


def test_errors_of_camera_and_stage_widen_the_intervals():
    _, _, alone = fitted(2)
    names, covariance = filed_covariance(CAMERA, STAGE)
    _, _, open_rig = fitted(2, rig_names=names, rig_covariance=covariance, fit_rig=True)
    assert np.all(open_rig.half_widths_95 >= alone.half_widths_95 - 1e-9)
    assert open_rig.half_widths_95[:, :3].max() > 2.0 * alone.half_widths_95[:, :3].max()
    _, _, known = fitted(2, rig_names=names, rig_covariance=1e-12 * covariance, fit_rig=True)
    assert known.half_widths_95 == pytest.approx(alone.half_widths_95, rel=2e-3)
    # of a measured rig that stays, what the fit makes of another camera is what is added
    longer = np.array([[(0.001 * CAMERA.image_distance / CAMERA.pixel_size) ** 2]])
    _, _, measured_rig = fitted(2, rig_names=["camera.focal_px"], rig_covariance=longer)
    _, _, other = fitted(2, camera=replace(CAMERA, image_distance=CAMERA.image_distance * 1.001))
    assert np.array_equal(measured_rig.lights[0].centre, alone.lights[0].centre)
    shift = other.lights[0].centre - alone.lights[0].centre
    added = measured_rig.panels_covariance[:3, :3] - alone.panels_covariance[:3, :3]
    assert np.allclose(added, np.outer(shift, shift), atol=0.1 * float(shift @ shift))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(1, 30))])
def test_panels_are_found_with_a_camera_and_a_stage_as_filed(seed):
    """Without a board, within the intervals: the rig file is as far off as is expected of one."""
    rng = np.random.default_rng(seed)
    names, covariance = filed_covariance(CAMERA, STAGE)
    off = rng.normal(size=len(names)) * np.sqrt(np.diag(covariance))
    camera, stage = displaced(CAMERA, STAGE, names, off)
    of_rig = {"rig_names": names, "rig_covariance": covariance, "fit_rig": True}
    panels, _, fit = fitted(seed, camera=camera, stage=stage, **of_rig)
    assert fit.rms < 1.2
    for panel, found, half in zip(panels, fit.lights, fit.half_widths_95, strict=True):
        # four standard errors
        assert np.all(np.abs(found.centre - panel.centre) < 4.0 / 1.96 * half[:3])


# images


def rendered(seed, *, postures=POSTURES, sigma=0.004):
    """A chrome ball under panels 3 mm and 2° off, levels at exposure 1 by posture and light."""
    rng = np.random.default_rng(seed)
    panels = targets.moved_panels(
        rng, shift=3.0 / math.sqrt(3.0), turn=math.radians(2.0) / math.sqrt(3.0), size_error=0.0
    )
    centre = np.array([3.0, -2.0, 12.0]) + rng.normal(0.0, 1.0, 3)
    sphere = trimesh.creation.icosphere(subdivisions=6, radius=RADIUS)
    vertices = np.asarray(sphere.vertices)
    normals = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    scene = Scene(
        camera=CAMERA,
        lights=panels,
        mesh=TriangleMesh(vertices + centre, np.asarray(sphere.faces), normals),
        reflectance=Reflectance(R_d=30.0, R_s=16000.0, sigma=sigma),
        sensor=Sensor(bit_depth=8, read_noise_levels=0.8, electrons_per_level=60.0),
        stage=STAGE,
        postures=tuple(postures),
    )
    return scene, panels, centre, render(scene, supersample=2, shadows=False)


def measured(scene, images, rng, *, exposure=1.0):
    short, long = (
        {i.light: expose(i.level, sensor=scene.sensor, exposure=e, full_scale=255.0, rng=rng) for i in images.lights}
        for e in (exposure, 2.0)
    )
    return measure_ball(
        short, posture=images.posture, sensor=scene.sensor, radius_px=12500.0 * RADIUS / 538.0,
        outline_images=list(long.values()),
    )[0]  # fmt: skip


@pytest.mark.slow
def test_rendered_ball_is_measured_where_it_is():
    scene, panels, centre, images = rendered(1, postures=POSTURES[1:2])
    rotation, translation = STAGE.transform(POSTURES[1])
    ball = rotation @ centre + translation
    first = next(iter(images))
    view = measured(scene, first, np.random.default_rng(0))
    away = outline_distances(CAMERA, ball, RADIUS, view.outline)
    assert len(away) > 300
    assert abs(float(away.mean())) < 0.3  # the common offset that the fit leaves free
    middle = view.outline - view.outline.mean(axis=0)
    pattern = away @ (middle / RADIUS / 22.7) * 2.0 / len(away)
    assert np.abs(pattern).max() < 0.02
    for panel in panels:
        true = mirrored_image(CAMERA, ball, RADIUS, panel_corners(panel))
        found = view.panels[panel.name].corners
        off = np.array([found[np.argmin(np.linalg.norm(found - corner, axis=1))] - corner for corner in true])
        assert np.abs(off).max() < 0.12
        assert np.abs(off.mean(axis=0)).max() < 0.05

    too_long = expose(first.lights[2].level, sensor=scene.sensor, exposure=1.5, full_scale=255.0)
    good = expose(first.lights[0].level, sensor=scene.sensor, exposure=1.0, full_scale=255.0)
    both = (first.lights[0].level + first.lights[1].level).astype(np.float32)
    both = expose(both, sensor=scene.sensor, exposure=1.0, full_scale=255.0)
    # a bad highlight costs its own panel only
    bad = {"light1": good, "light2": both, "light3": too_long, "light4": np.zeros_like(good)}
    view, problems = measure_ball(
        bad, posture=POSTURES[1], sensor=scene.sensor, radius_px=232.0, outline_images=[good]
    )  # fmt: skip
    assert list(view.panels) == ["light1"]
    expected_texts = "more than one highlight", "saturated: .*shorter", "no highlight"
    for text, expected in zip(problems, expected_texts, strict=True):
        assert re.search(expected, text), text
    noise = np.random.default_rng(0).integers(0, 4, good.shape).astype(np.uint8)
    with pytest.raises(InputError, match="outline of the ball shows at"):
        measure_ball({"light1": noise}, posture=POSTURES[1], sensor=scene.sensor, radius_px=232.0)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(3))
def test_panels_are_found_in_rendered_images(seed):
    scene, panels, centre, images = rendered(seed)
    rng = np.random.default_rng(100 + seed)
    views = [measured(scene, posture, rng) for posture in images]
    fit = fit_ball(views, lights=LIGHTS, camera=CAMERA, stage=STAGE, radius=RADIUS, size_error=0.1)
    assert np.allclose(fit.centre, centre, atol=2e-3)
    for light, true in zip(fit.lights, panels, strict=True):
        own, _ = targets.panel_errors(light, true)
        assert np.abs(own[:2]).max() < 0.3
        assert abs(own[2]) < 1.5
        assert np.degrees(np.abs(own[3:5])).max() < 1.0
