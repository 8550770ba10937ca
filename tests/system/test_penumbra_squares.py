"""Interpolated penumbrae against full work at every sample: boxes over and on a plane, and a part that shades itself.

Expected: within 0.1 level or 0.1 % on 99.98 % of the lit pixels, within 0.3 level + 0.1 % on all, for fewer points that
are worked out. At depth edges and contact shadows no square is smooth, so that full work is done there.

What is worked out by silhouettes is what rays give: the same levels, for a tenth of the rays.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from worlds import PARTS, box, merged, plane, scene_from_files, scene_from_mesh

import lightopt.rendering._converged_panel as converged
from lightopt.geometry import RayCaster
from lightopt.optics import SpecularModel
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.rendering._penumbra import shade_penumbra

LIGHTS = [ref.Light(elevation=62, azimuth=90), ref.Light(elevation=30, azimuth=200)]
R_S = {0.003: 1e5, 0.0475: 12500.0, 0.15: 800.0}


def boxes(sigma, side=1):
    """One box in the air, one that stands on the plane, and a narrow post, seen in the direction of mirrored light.

    In 360 × 270 pixels, or in ones that are so many times as long.
    """
    camera = ref.Camera(width=360 // side, height=270 // side, pixel_um=14.7 * side, elevation=62)
    mesh = merged(
        plane(40),
        box(np.array([-7.0, -4.0, 9.0]), np.array([6.0, 8.0, 14.0])),
        box(np.array([-14.0, -9.0, 0.0]), np.array([-9.0, -2.0, 3.0])),
        box(np.array([9.0, -8.0, 0.0]), np.array([9.8, -7.2, 8.0])),
    )
    return scene_from_mesh(
        camera, LIGHTS, mesh, points="auto", reflectance={"R_d": 45.0, "R_s": R_S[sigma], "sigma": sigma}
    )


def rendered(scene, threads=2):
    """Levels of all lights (n, height, width), and the number of rays."""
    images = render_posture(scene, scene.postures[0], caster=cast_rays_at(scene), threads=threads)
    return np.array([image.level for image in images.lights]), images.rays


def compare_with_full_work(monkeypatch, scene, fewer):
    points = []

    def counted(surface, *rest):
        points[-1] += len(surface)
        return shade_penumbra(surface, *rest)

    monkeypatch.setattr(converged, "shade_penumbra", counted)
    points.append(0)
    found, _ = rendered(scene, threads=1)
    monkeypatch.setattr(converged, "SIDES", ())
    points.append(0)
    expected, _ = rendered(scene, threads=1)
    error, lit, interpolated = np.abs(found - expected), expected > 0, found != expected
    over = np.mean(error[lit] > np.maximum(0.1, 0.001 * expected[lit]))
    print(
        f"{interpolated.sum():,} interpolated: p99.9 {np.percentile(error[interpolated], 99.9):.3f}, "
        f"max {error.max():.3f}, over 0.1 level {over:.4%} of the lit; {points} points"
    )
    assert interpolated.sum() > 1000, "a picture without penumbrae would agree as well"
    assert over <= 0.0002
    assert np.max(error - 0.001 * expected) <= 0.3
    assert points[0] <= fewer * points[1]


@pytest.mark.parametrize(
    "sigma", [pytest.param(0.003, marks=pytest.mark.slow), 0.0475, pytest.param(0.15, marks=pytest.mark.nightly)]
)
def test_boxes_over_and_on_a_plane(monkeypatch, sigma):
    compare_with_full_work(monkeypatch, boxes(sigma), 0.8)


@pytest.mark.parametrize("sigma", [0.003, pytest.param(0.0475, marks=pytest.mark.slow)])
def test_boxes_under_tails(monkeypatch, sigma):
    scene = boxes(sigma)
    tails = replace(scene.reflectance, R_s=12500.0 * (0.0475 / sigma) ** 2, model=SpecularModel(name="ggx"))
    compare_with_full_work(monkeypatch, replace(scene, reflectance=tails), 0.8)


def test_part_that_shades_itself(monkeypatch, tmp_path):
    camera, light = ref.Camera(width=320, height=240, pixel_um=20), ref.Light(elevation=45, azimuth=80)
    scene = scene_from_files(tmp_path, camera, [light], PARTS / "spout.stl", points="auto")
    compare_with_full_work(monkeypatch, scene, 0.95)


def test_any_number_of_threads_gives_the_same_bytes():
    scene = boxes(0.0475, side=2)
    one, rays = rendered(scene, threads=1)
    four, as_many = rendered(scene, threads=4)
    assert one.tobytes() == four.tobytes()
    assert rays == as_many


def compare_with_rays(monkeypatch, scene, fewer):
    found, rays = rendered(scene)
    silhouettes = RayCaster.silhouettes

    def none_found(*arguments):
        edges = silhouettes(*arguments)
        return edges._replace(found=np.zeros_like(edges.found))

    monkeypatch.setattr(RayCaster, "silhouettes", none_found)
    expected, all_rays = rendered(scene)
    differing = found != expected
    print(f"{differing.sum()} levels differ, by {np.abs(found - expected).max():.2g} at most; {rays:,} of {all_rays:,}")
    assert np.max(np.abs(found - expected) - 2e-4 * expected) <= 0.02
    assert differing.mean() <= 1e-3  # edges of boxes that pass exactly through corners of cells
    assert rays <= fewer * all_rays


def test_silhouettes_of_boxes_are_what_rays_meet(monkeypatch):
    compare_with_rays(monkeypatch, boxes(0.0475, side=2), 0.5)


def test_silhouettes_of_a_part_that_shades_itself_are_what_rays_meet(monkeypatch, tmp_path):
    camera, light = ref.Camera(width=320, height=240, pixel_um=20), ref.Light(elevation=45, azimuth=80)
    scene = scene_from_files(tmp_path, camera, [light], PARTS / "spout.stl", points="auto")
    compare_with_rays(monkeypatch, scene, 0.2)
