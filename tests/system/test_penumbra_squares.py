"""Interpolated penumbrae against full work at every sample: boxes over and on a plane, and a part that shades itself.

Expected: within 0.1 level or 0.1 % on 99.98 % of the lit pixels, within 0.3 level + 0.1 % on all, and for fewer rays.
At depth edges and contact shadows no square is smooth, so that full work is done there.
"""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from worlds import PARTS, box, merged, plane, scene_from_files, scene_from_mesh

import lightopt.rendering._converged_panel as converged
from lightopt.rendering import cast_rays_at, render_posture

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
    found, rays = rendered(scene)
    monkeypatch.setattr(converged, "SIDES", ())
    expected, all_rays = rendered(scene)
    error, lit, interpolated = np.abs(found - expected), expected > 0, found != expected
    over = np.mean(error[lit] > np.maximum(0.1, 0.001 * expected[lit]))
    print(
        f"{interpolated.sum():,} interpolated: p99.9 {np.percentile(error[interpolated], 99.9):.3f}, "
        f"max {error.max():.3f}, over 0.1 level {over:.4%} of the lit; rays {rays:,} of {all_rays:,}"
    )
    assert interpolated.sum() > 1000, "a picture without penumbrae would agree as well"
    assert over <= 0.0002
    assert np.max(error - 0.001 * expected) <= 0.3
    assert rays <= fewer * all_rays


@pytest.mark.parametrize(
    "sigma", [pytest.param(0.003, marks=pytest.mark.slow), 0.0475, pytest.param(0.15, marks=pytest.mark.nightly)]
)
def test_boxes_over_and_on_a_plane(monkeypatch, sigma):
    compare_with_full_work(monkeypatch, boxes(sigma), 0.8)


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
