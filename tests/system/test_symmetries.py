"""What must not matter, does not: turning the whole world, the number of threads, how images are cut into blocks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from worlds import PAPER, PARTS, bumps, levels, plane, scene_from_files, scene_from_mesh, sphere

import lightopt.rendering._images as blocks
from lightopt import render
from lightopt.core.transforms import rotation_z
from lightopt.geometry import transformed

CAMERA = ref.Camera(width=120, height=90, pixel_um=50, elevation=70, azimuth=300, roll=20)
LIGHTS = [
    ref.Light(elevation=40, azimuth=100, k=2),
    ref.Light(elevation=65, azimuth=250, k=3, falloff="inverse_square"),
]


def all_images(scene, **options):
    return [image.level.astype(float) for images in render(scene, threads=2, **options) for image in images.lights]


def off(one, two, relative):
    """Share of lit pixels that differ."""
    differs = np.abs(one - two) > relative * np.maximum(np.abs(one), np.abs(two))
    return np.count_nonzero(differs) / max(1, np.count_nonzero(one))


@pytest.mark.parametrize("turn", [90.0, -137.0])
@pytest.mark.parametrize("by", ["posture", "mesh"])
def test_turning_rig_and_part_together_changes_nothing(tmp_path, turn, by):
    """Azimuths of camera and lights plus the part's rotation; apart from pixels that an edge passes through."""
    still = scene_from_files(tmp_path, CAMERA, LIGHTS, PARTS / "spout.stl")
    camera = replace(CAMERA, azimuth=(CAMERA.azimuth + turn) % 360)
    lights = [replace(x, azimuth=(x.azimuth + turn) % 360) for x in LIGHTS]
    postures = [(0, turn)] if by == "posture" else [(0, 0)]
    turned = scene_from_files(tmp_path / "turned", camera, lights, PARTS / "spout.stl", postures=postures)
    if by == "mesh":
        turned = replace(turned, mesh=transformed(still.mesh, rotation_z(np.deg2rad(turn)), np.zeros(3)))
    else:
        turned = replace(turned, mesh=still.mesh)
    for one, two in zip(all_images(still), all_images(turned), strict=True):
        assert one.max() > 100
        assert off(one, two, 1e-6) <= 1e-3


def test_pivot_on_the_axis_of_a_rotation_does_not_matter():
    mesh = bumps(5)
    one, two = (levels(scene_from_mesh(CAMERA, LIGHTS[:1], mesh, pivot=(0, 0, z), postures=[(0, 75)])) for z in (0, 40))
    assert off(one, two, 1e-6) <= 1e-3


def test_posture_order_and_company_do_not_matter():
    mesh = bumps(6)
    alone = [all_images(scene_from_mesh(CAMERA, LIGHTS, mesh, postures=[p])) for p in ((0, 0), (10, 40))]
    together = all_images(scene_from_mesh(CAMERA, LIGHTS, mesh, postures=[(10, 40), (0, 0)]))
    for one, two in zip(alone[1] + alone[0], together, strict=True):
        assert np.array_equal(one, two)


def test_lights_together_are_the_sum_of_lights_alone():
    """A panel whose points count in full is its points' sum: two lights, shadows and lobes, add in the image."""
    mesh = bumps(7)
    pair = ref.Light(elevation=90, azimuth=270, distance=250, size=(300, 300), k=2, normalisation="sum")
    points = pair.points()[0]
    alone = [
        ref.Light(
            distance=np.linalg.norm(p),
            elevation=np.rad2deg(np.arcsin(p[2] / np.linalg.norm(p))),
            azimuth=np.rad2deg(np.arctan2(p[1], p[0])) % 360,
            size=(1, 1),
            k=1,
        )
        for p in points
    ]
    total = np.sum(all_images(scene_from_mesh(CAMERA, alone, mesh)), axis=0)
    together = levels(scene_from_mesh(CAMERA, [pair], mesh))
    assert off(total, together, 1e-6) <= 1e-3


def test_company_of_other_lights_does_not_matter():
    mesh = bumps(8)
    together = all_images(scene_from_mesh(CAMERA, LIGHTS, mesh))
    for light, image in zip(LIGHTS, together, strict=True):
        assert np.array_equal(levels(scene_from_mesh(CAMERA, [light], mesh)), image)


# how finely a converged panel's penumbrae are worked out depends on what its light is worth
EXACTLY, TO_TOLERANCE = {"rtol": 1e-6, "atol": 1e-9}, {"rtol": 1e-3, "atol": 0.1}


@pytest.mark.parametrize(("points", "close"), [(None, EXACTLY), ("auto", TO_TOLERANCE)])
def test_components_add_and_are_linear_in_the_coefficients(points, close):
    mesh = bumps(9)

    def image(**coefficients):
        shine = {**PAPER, **coefficients}
        scene = scene_from_mesh(CAMERA, LIGHTS[:1], mesh, reflectance=shine, points=points)
        return next(iter(render(scene, layers=True, threads=2))).lights[0]

    both = image()
    assert both.diffuse.max() > 10
    assert both.specular.max() > 10
    np.testing.assert_allclose(both.level, both.diffuse + both.specular, rtol=1e-6)
    np.testing.assert_allclose(image(R_d=90.0).diffuse, 2 * both.diffuse, **close)
    np.testing.assert_allclose(image(R_s=25000.0).specular, 2 * both.specular, **close)
    np.testing.assert_allclose(image(R_s=0.0).level, both.diffuse, **close)
    np.testing.assert_allclose(image(R_d=0.0).level, both.specular, **close)


@pytest.mark.slow
@pytest.mark.parametrize(("points", "supersample"), [(None, 3), ("auto", 1)])
def test_threads_give_identical_bytes(tmp_path, monkeypatch, points, supersample):
    monkeypatch.setattr(blocks, "BLOCK_SAMPLES", 3000)  # many blocks to get out of step with
    scene = scene_from_files(tmp_path, CAMERA, LIGHTS, PARTS / "spout.stl", points=points, postures=[(10, 200)])
    wanted = None
    for threads in (1, 2, 5):
        images = next(iter(render(scene, threads=threads, supersample=supersample, layers=True)))
        g = images.geometry
        found = (
            b"".join(
                x.tobytes()
                for x in (
                    *(a for light in images.lights for a in (light.level, light.diffuse, light.specular)),
                    *(g.points, g.normals, g.distance, g.patch, g.hit),
                )
            )
            + repr((images.rays, images.back_faces)).encode()
        )
        wanted = wanted or found
        assert found == wanted, f"{threads} threads"


@pytest.mark.parametrize("supersample", [1, 2])
def test_blocks_give_identical_bytes(tmp_path, monkeypatch, supersample):
    scene = scene_from_files(tmp_path, CAMERA, LIGHTS, PARTS / "spout.stl", postures=[(10, 200)])
    wanted = all_images(scene, supersample=supersample)
    for size in (1, 1000, 7777):
        monkeypatch.setattr(blocks, "BLOCK_SAMPLES", size)
        for one, two in zip(wanted, all_images(scene, supersample=supersample), strict=True):
            assert np.array_equal(one, two), f"blocks of {size} samples"


def test_supersampling_is_the_mean_of_finer_pixels(tmp_path):
    coarse = ref.Camera(width=60, height=45, pixel_um=90, roll=20)
    fine = replace(coarse, width=180, height=135, pixel_um=30)
    together = levels(scene_from_files(tmp_path, coarse, LIGHTS[:1], PARTS / "spout.stl"), supersample=3)
    apart = levels(scene_from_files(tmp_path, fine, LIGHTS[:1], PARTS / "spout.stl"))
    mean = apart.reshape(45, 3, 60, 3).mean(axis=(1, 3))
    assert off(together, mean, 1e-5) <= 1e-3


def test_supersampling_converges_to_the_area_average():
    """A matte square's edge, turned by the roll, covers each pixel in part: the level goes to covered area × level."""
    camera = ref.Camera(width=40, height=40, pixel_um=100, roll=17)
    light = ref.Light(distance=1e7, elevation=90, azimuth=270, k=1)
    mesh = plane(15)
    scene = scene_from_mesh(camera, [light], mesh, reflectance={"R_d": 100.0, "R_s": 0.0, "sigma": 0.05})
    partly = levels(scene, supersample=12)
    # the share of each pixel, 1 mm wide, that lies within the square turned by the roll: by 50 × 50 samples
    c, s = np.cos(np.deg2rad(17)), np.sin(np.deg2rad(17))
    places = (np.arange(40 * 50) + 0.5) / 50 - 20
    x, y = np.meshgrid(places, -places)
    inside = (np.abs(c * x - s * y) < 15) & (np.abs(s * x + c * y) < 15)
    covered = 100 * inside.reshape(40, 50, 40, 50).mean(axis=(1, 3))
    assert np.count_nonzero((covered > 5) & (covered < 95)) > 80
    errors = [np.abs(levels(scene, supersample=n) - covered).max() for n in (1, 4, 12)]
    assert errors[0] > 30
    assert errors[1] < 15
    assert errors[2] < 5
    assert partly.sum() == pytest.approx(100 * 900, rel=1e-3)


def test_mirror_image_of_the_world_is_the_mirror_image():
    """A sphere is its own mirror image: a light at the azimuth 180° − φ gives the picture flipped left to right."""
    camera = ref.Camera(width=80, height=60, pixel_um=70)
    mesh = sphere(18, rows=48)
    one = levels(scene_from_mesh(camera, [ref.Light(azimuth=35, k=3)], mesh))
    two = levels(scene_from_mesh(camera, [ref.Light(azimuth=145, k=3)], mesh))
    diagonal_edges = off(one, two[:, ::-1], 2e-2)
    assert one.max() > 200
    assert diagonal_edges < 0.02
