"""The renderer against the slow float64 reference, which shares no line of code with it.

Expected, on the sample parts and on random meshes: 1e-4 relative on every pixel that is not at a silhouette, a crease
or the edge of a shadow; and among all hit pixels, those included, at most 0.1 % that disagree at all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from worlds import (
    PAPER,
    PARTS,
    bumps,
    corners,
    edge_pixels,
    posed_corners,
    scene_from_files,
    scene_from_mesh,
    soup,
    sphere,
)

from lightopt import render

RELATIVE = 1e-4
DISAGREE = 1e-3


def compare(camera, lights, scene, mesh, posture, pivot, reflectance, *, least_share, shadows=True):
    """Check all images of one posture; returns (p99, max) relative off edges and the share that disagrees at all."""
    images = next(iter(render(scene, threads=2, shadows=shadows)))
    triangles, normals = posed_corners(mesh, posture, pivot)
    hits = ref.trace(camera, triangles, normals)
    shape = (camera.height, camera.width)
    seen = (hits.face >= 0).reshape(shape)
    pixels = np.count_nonzero(seen)
    assert pixels > 1000
    assert np.count_nonzero(seen != images.geometry.hit) <= DISAGREE * pixels
    assert abs(images.back_faces - np.count_nonzero(hits.back)) <= DISAGREE * pixels
    off_edges, disagree = [], 0
    for light, image in zip(lights, images.lights, strict=True):
        expected = ref.render(camera, light, triangles, normals, hits=hits, shadows=shadows, **reflectance)
        level = image.level.astype(float)
        assert np.array_equal(level[~seen & ~images.geometry.hit], np.zeros(np.sum(~seen & ~images.geometry.hit)))
        error = np.abs(level - expected.level) / np.maximum(np.abs(expected.level), 1e-6)
        compared = seen & ~edge_pixels(expected)
        assert np.count_nonzero(compared) >= least_share * pixels
        off_edges.append(error[compared])
        disagree = max(disagree, np.count_nonzero(error[seen] > RELATIVE) / pixels)
        assert np.ptp(expected.level[compared]) > 10, "a picture of nothing would agree as well"
    error = np.concatenate(off_edges)
    figures = np.quantile(error, 0.99), error.max(), disagree
    print("p99 {:.1e}  max {:.1e}  any disagreement {:.2e}".format(*figures))
    assert figures[1] <= RELATIVE
    assert disagree <= DISAGREE
    return figures


def random_rig(rng):
    """A camera and two lights that use every number of the contract."""
    camera = ref.Camera(
        width=120,
        height=90,
        distance=rng.uniform(350, 600),
        elevation=rng.uniform(60, 115),
        azimuth=rng.uniform(0, 360),
        roll=rng.uniform(-180, 180),
        pixel_um=rng.uniform(25, 45),
        image_distance=rng.uniform(35, 45),
        distortion=(*rng.uniform(-0.3, 0.3, 2), *rng.uniform(-0.01, 0.01, 2), rng.uniform(-1, 1)),
    )
    lights = [
        ref.Light(
            distance=rng.uniform(150, 400),
            elevation=rng.uniform(25, 100),
            azimuth=rng.uniform(0, 360),
            size=tuple(rng.uniform(20, 100, 2)),
            k=int(k),
            normalisation=normalisation,
            falloff=falloff,
            emission=float(emission),
            gain=rng.uniform(0.3, 3),
        )
        for k, normalisation, falloff, emission in (
            (rng.integers(1, 4), "mean", "inverse_square", rng.uniform(0.5, 4)),
            (rng.integers(2, 4), "sum", "none", 0),
        )
    ]
    return camera, lights


# few pixels: the reference tries every ray on every triangle
SAMPLE_CAMERA = ref.Camera(width=112, height=84, pixel_um=54)
SAMPLE_LIGHTS = [ref.Light(azimuth=45, k=1), ref.Light(azimuth=225, elevation=35, k=2)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("part", "posture", "least_share"),
    [
        ("cover-knob", (0, 0), 0.8),
        pytest.param("cover-knob", (0, 82), 0.8, marks=pytest.mark.nightly),
        ("spout", (20, 90), 0.6),
        pytest.param("spout", (-30, 215), 0.6, marks=pytest.mark.nightly),
    ],
)
def test_sample_parts(tmp_path, part, posture, least_share):
    pivot = (3.0, -4.0, 10.0)
    scene = scene_from_files(
        tmp_path, SAMPLE_CAMERA, SAMPLE_LIGHTS, PARTS / f"{part}.stl", pivot=pivot, postures=[posture]
    )
    compare(SAMPLE_CAMERA, SAMPLE_LIGHTS, scene, scene.mesh, posture, pivot, PAPER, least_share=least_share)


@pytest.mark.parametrize("part", ["cover-knob", "spout"])
def test_sample_parts_without_shadows(tmp_path, part):
    light = [ref.Light(azimuth=135, elevation=40, k=1)]
    scene = scene_from_files(tmp_path, SAMPLE_CAMERA, light, PARTS / f"{part}.stl")
    compare(SAMPLE_CAMERA, light, scene, scene.mesh, (0, 0), (0, 0, 0), PAPER, least_share=0.6, shadows=False)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.nightly) for s in (2, 3, 4))])
@pytest.mark.parametrize(
    ("shape", "least_share"), [(bumps, 0.7), (soup, 0.3)], ids=["smooth-height-field", "faceted-triangles"]
)
def test_random_meshes_on_random_rigs(seed, shape, least_share):
    rng = np.random.default_rng(seed)
    camera, lights = random_rig(rng)
    posture = (rng.uniform(-25, 25), rng.uniform(0, 360))
    pivot = tuple(rng.uniform(-10, 10, 3))
    reflectance = {
        "R_d": rng.uniform(10, 80),
        "R_s": rng.uniform(100, 20000),
        "sigma": float(np.exp(rng.uniform(np.log(0.003), np.log(0.15)))),
    }
    mesh = shape(seed)
    scene = scene_from_mesh(camera, lights, mesh, pivot=pivot, postures=[posture], reflectance=reflectance)
    compare(camera, lights, scene, mesh, posture, pivot, reflectance, least_share=least_share)


@pytest.mark.slow
def test_files_and_functions_describe_the_same_rig(tmp_path):
    """Every number of a rig file reaches the physics: the reference was given the same numbers, not the file."""
    camera, lights = random_rig(np.random.default_rng(12))
    camera = replace(camera, width=80, height=60, pixel_um=1.5 * camera.pixel_um)
    pivot, posture = (4.0, 2.0, -7.0), (15, 130)
    scene = scene_from_files(
        tmp_path,
        camera,
        lights,
        PARTS / "cover-knob.stl",
        pivot=pivot,
        postures=[posture],
        anchor="centred",
        normals="facet",
    )
    compare(camera, lights, scene, scene.mesh, posture, pivot, PAPER, least_share=0.3)


def test_a_sphere_in_the_reference_is_the_sphere():
    """The reference itself, against a closed form: depth, normal and Lambert's law on a sphere of radius 20."""
    camera = ref.Camera(width=40, height=30, pixel_um=120)
    light = ref.Light(k=1, elevation=70)
    triangles, normals = corners(sphere(20, rows=64))
    image = ref.render(camera, light, triangles, normals, R_d=100, R_s=0, sigma=0.05)
    front = image.hits.front
    directions = camera.directions(camera.pixel_centres())
    along = directions @ camera.position
    depth = -along - np.sqrt(np.maximum(0, along**2 - camera.position @ camera.position + 400))
    inner = front & (np.abs(image.hits.normal[:, 2]) > 0.3)
    assert np.count_nonzero(inner) > 200
    assert np.abs(image.hits.distance - depth)[inner].max() < 0.2
    point = camera.position + depth[:, None] * directions
    source = light.points()[0][0]
    to_light = source - point
    lambert = 100 * np.einsum("ij,ij->i", point / 20, to_light) / np.linalg.norm(to_light, axis=1)
    assert np.abs(image.level.ravel() - np.maximum(0, lambert))[inner & (lambert > 5)].max() < 0.5
