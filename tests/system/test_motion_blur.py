"""Motion blur against a plain mean of images of the part displaced by hand, and against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from worlds import box, bumps, corners, levels, plane, scene_from_mesh

from lightopt.core.errors import InputError
from lightopt.defects import DefectShape, PlacedDefect
from lightopt.geometry import TriangleMesh
from lightopt.optics import expose
from lightopt.rendering import cast_rays_at, render_lights, render_posture
from lightopt.rig.simulated._bench_process import BenchTruth
from lightopt.rig.simulated._optics import BenchOptics
from lightopt.scene import Lens, Motion, motion_blur

MATTE = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.05}
GLOSSY = {"R_d": 20.0, "R_s": 5000.0, "sigma": 0.05}
CAMERA = ref.Camera(width=64, height=48, pixel_um=100.0)
PER_MM = CAMERA.image_distance / (CAMERA.distance * 1e-3 * CAMERA.pixel_um)  # pixels at the table
EXPOSURE_S = 0.01


def moving(scene, *, velocity=(0.0, 0.0, 0.0), turn=0.0):
    """The scene with its part moving so far in exposure 1 [mm], and turning so far [°]."""
    rates = {"velocity": np.array(velocity) / EXPOSURE_S, "turn_deg_per_s": turn / EXPOSURE_S}
    return replace(scene, motion=Motion(**rates, exposure_s=EXPOSURE_S))


def image(scene, **options):
    options = {"exposure": 1.0, "threads": 2} | options
    return render_lights(scene, scene.postures[0], caster=cast_rays_at(scene), **options)[0].level.astype(float)


@pytest.mark.parametrize("supersample", [1, 2])
def test_the_image_is_the_mean_of_images_of_the_part_displaced_by_hand(supersample):
    """On a tilted stage off its pivot: each image is of a mesh that plain NumPy has put where it is at the instant."""
    velocity, turn, pivot, posture = np.array([1.2, -0.8, 0.5]), 2.0, (3.0, -2.0, 5.0), (15.0, 40.0)
    light, mesh = ref.Light(elevation=55, azimuth=30, k=2), bumps(3)
    own = {"pivot": pivot, "reflectance": GLOSSY}
    scene = moving(scene_from_mesh(CAMERA, [light], mesh, postures=[posture], **own), velocity=velocity, turn=turn)
    found = levels(scene, supersample=supersample)
    triangles, normals = corners(mesh)
    path = float(motion_blur(scene, scene.postures[0], mesh.vertices).max())
    assert 2.0 < path < 6.0
    count = int(np.ceil(2 * float(motion_blur(scene, scene.postures[0], seen_points(scene)).max())))
    still = []
    for k in range(count):
        after = (k + 0.5) / count - 0.5
        there = posture[0], posture[1] + turn * after
        placed = ref.posed(triangles, *there, pivot) + velocity * after
        turned = ref.posed_normals(normals, *there)
        faces = np.arange(3 * len(placed)).reshape(-1, 3)
        here = TriangleMesh(placed.reshape(-1, 3), faces, turned.reshape(-1, 3))
        still.append(levels(scene_from_mesh(CAMERA, [light], here, reflectance=GLOSSY), supersample=supersample))
    expected = np.mean(still, axis=0)
    # rays that graze an edge may go by on either side, as their rounding is in another frame
    off = np.abs(found - expected) > 1e-3 * expected + 1e-3
    assert off.mean() < 0.003
    assert np.abs(expected - still[0]).max() > 20.0


def seen_points(scene):
    """Places of the surface that pixels look at, part frame."""
    posture = scene.postures[0]
    geometry = render_posture(replace(scene, lights=()), posture, caster=cast_rays_at(scene)).geometry
    rotation, translation = scene.stage.transform(posture)
    return (geometry.points[geometry.hit] - translation) @ rotation


@pytest.mark.parametrize("width", [3.0, 8.0])
@pytest.mark.parametrize("exposure", [1.0, 0.25])
def test_an_edge_becomes_a_ramp_as_wide_as_the_motion(width, exposure):
    """A matte plate under a far light: the share of the exposure in which it covers a pixel's centre."""
    lamp = ref.Light(distance=1e6, elevation=90, azimuth=0, k=1)
    scene = scene_from_mesh(CAMERA, [lamp], plane(half=8.3), reflectance=MATTE)
    found = image(moving(scene, velocity=(width / PER_MM, 0, 0)), exposure=exposure)
    blurred = width * exposure
    column = np.arange(CAMERA.width) + 0.5 - CAMERA.width / 2
    expected = 100.0 * np.clip(0.5 + (8.3 * PER_MM - np.abs(column)) / blurred, 0.0, 1.0)
    row = found[CAMERA.height // 2]
    count = np.ceil(2 * blurred)
    assert np.abs(row - expected).max() <= 100.0 * (0.5 / count) + 0.05
    assert np.count_nonzero((row > 1.0) & (row < 99.0)) >= 2 * (blurred - 2.0)
    # light is only spread: all of it is there
    assert row.sum() == pytest.approx(100.0 * 2 * 8.3 * PER_MM, rel=0.5 / (8.3 * PER_MM))


def test_a_plate_slides_away_under_its_highlight():
    """What the lights make of a plane stands still while it slides in itself; a stain on it goes with it."""
    lamp = ref.Light(distance=330, elevation=80, azimuth=90, size=(30, 30), k=4)
    scene = scene_from_mesh(CAMERA, [lamp], plane(half=200.0), reflectance=GLOSSY)
    still, blurred = image(scene), image(moving(scene, velocity=(6.0 / PER_MM, 0, 0)))
    assert still.max() > 2.0 * still.min()
    np.testing.assert_allclose(blurred, still, rtol=1e-4)
    stain = PlacedDefect(
        name="stain", shape=DefectShape(kind="stain", length=8.0, width=8.0, R_d_factor=0.2), **AT_ORIGIN
    )
    spoilt = replace(scene, defects=(stain,))
    moved = moving(spoilt, velocity=(6.0 / PER_MM, 0, 0))
    of_rest, of_motion = (levels(scene, supersample=3) - levels(one, supersample=3) for one in (spoilt, moved))
    profiles = [one.sum(axis=0) / one.sum() for one in (of_rest, of_motion)]
    columns = np.arange(CAMERA.width)
    spreads = [float(p @ columns**2 - (p @ columns) ** 2) for p in profiles]
    assert of_motion.sum() == pytest.approx(of_rest.sum(), rel=0.03)
    assert spreads[1] - spreads[0] == pytest.approx(6.0**2 / 12, rel=0.1)  # variance of a box


AT_ORIGIN = {"position": np.zeros(3), "normal": np.array([0.0, 0.0, 1.0]), "along": np.array([1.0, 0.0, 0.0])}


def test_a_lens_shows_a_part_that_moves():
    """Views through the lens, each at an instant of its own, against whole images through the lens at each instant."""
    scene = scene_from_mesh(CAMERA, [ref.Light(elevation=60, k=2)], box([-6, -5, 0], [6, 5, 20]), reflectance=MATTE)
    scene = replace(scene, camera=replace(scene.camera, lens=Lens(aperture=25.0, focus=545.0)))
    way, count = 5.0 / PER_MM, 12
    found = image(moving(scene, velocity=(way, 0, 0)))
    still = []
    for k in range(count):
        shift = np.array([way * ((k + 0.5) / count - 0.5), 0, 0])
        moved = replace(scene, mesh=replace(scene.mesh, vertices=scene.mesh.vertices + shift))
        still.append(image(moved))
    expected = np.mean(still, axis=0)
    error = np.abs(found - expected)
    assert error.max() < 0.06 * expected.max()
    assert error.mean() < 0.003 * expected.max()
    assert np.abs(still[count // 2] - expected).max() > 0.2 * expected.max()


def test_a_fast_rotation_shows_no_separate_highlights():
    """A tilted mirror turns by 40 σ: instants are so close that the highlight's path is smooth."""
    sharp = {"R_d": 0.0, "R_s": 1e5, "sigma": 0.004}
    lamp = ref.Light(distance=330, elevation=75, azimuth=0, size=(4, 4), k=4)
    mesh = plane(half=3.0, tilt=7.5, azimuth=90)
    scene = moving(scene_from_mesh(CAMERA, [lamp], mesh, reflectance=sharp), turn=9.0)
    dense = 400
    stage = scene.stage
    total = np.zeros((CAMERA.height, CAMERA.width))
    for k in range(dense):
        turned = replace(scene.postures[0], rotation_deg=9.0 * ((k + 0.5) / dense - 0.5))
        total += image(replace(scene, motion=None, stage=stage, postures=(turned,)))
    expected = total / dense
    found = image(scene)
    inside = expected > 0.05 * expected.max()
    assert np.median(np.abs(found - expected)[inside] / expected[inside]) < 0.02


def test_threads_and_repeats_make_no_difference():
    scene = moving(scene_from_mesh(CAMERA, [ref.Light()], bumps(1)), velocity=(0.5, 0.2, 0), turn=1.0)
    assert image(scene, threads=1).tobytes() == image(scene, threads=2).tobytes()


def test_a_part_at_rest_and_images_without_exposure_keep_their_bytes():
    scene = scene_from_mesh(CAMERA, [ref.Light()], bumps(1))
    at_rest = image(scene)
    assert image(moving(scene)).tobytes() == at_rest.tobytes()
    assert image(moving(scene, velocity=(2, 0, 0)), exposure=None).tobytes() == at_rest.tobytes()


def test_a_part_that_moves_too_far_is_refused_with_numbers():
    scene = moving(scene_from_mesh(CAMERA, [ref.Light()], plane()), velocity=(200.0 / PER_MM, 0, 0))
    text = r"moves 200 px and turns 0° in the 10 ms of exposure 1, .* 400 instants, expected at most 256"
    with pytest.raises(InputError, match=text):
        image(scene)
    assert image(scene, exposure=0.5).max() > 0.0


def test_the_simulated_camera_blurs_by_the_time_of_its_exposure():
    scene = moving(scene_from_mesh(CAMERA, [ref.Light(), ref.Light(azimuth=90)], bumps(2)), velocity=(0.8, 0, 0))
    bench = BenchOptics(scene, BenchTruth())
    frames = {}
    for exposure in (1.0, 0.25):
        bench.prepare(scene.postures[0], exposure=exposure)
        prepared = len(bench._layers)
        frames[exposure] = bench.frame({"light0": 1.0}, scene.postures[0], exposure=exposure)
        assert len(bench._layers) == prepared  # nothing was left to render
        own = replace(scene, lights=scene.lights[:1])
        expected = expose(
            image(own, exposure=exposure).astype(np.float32), sensor=scene.sensor, exposure=exposure, full_scale=255.0
        )
        assert np.array_equal(frames[exposure], expected)
    longer = frames[1.0].astype(float)
    assert np.abs(np.minimum(frames[0.25] * 4.0, 255.0) - longer).max() > 10.0
