"""A lens of finite aperture against closed forms, and against rays through random places of a thin lens.

The Monte Carlo method shares no line of code with the renderer: it knows a focal length and the lens equation, sends
rays from random places of the lens through where random places of the pixels are in focus, and takes the mean.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from captured import PART, PARTS, RIG
from worlds import box, cap, corners, levels, merged, plane, scene_from_mesh

from lightopt.defects import (
    BUILT_IN_CATALOGUE,
    CatalogueEntry,
    DefectShape,
    PlacedDefect,
    defect_hypotheses,
    plane_to_image,
    search_grid,
)
from lightopt.design import DetectionModel, luminance_matrix, planned_catalogue
from lightopt.optics import expose
from lightopt.rendering import build_patches, cast_rays_at, render_lights
from lightopt.rig.simulated._bench_process import BenchTruth
from lightopt.rig.simulated._optics import BenchOptics
from lightopt.scene import Lens, build_scene, pixel_directions, project, through_lens, typical_blur

FOCAL, F_NUMBER, IMAGE_DISTANCE = 50.0, 2.0, 55.0
FOCUS = 1 / (1 / FOCAL - 1 / IMAGE_DISTANCE)  # 550 mm
APERTURE = FOCAL / F_NUMBER


def with_lens(scene, **lens):
    return replace(scene, camera=replace(scene.camera, lens=Lens(aperture=APERTURE, focus=FOCUS, **lens)))


def monte_carlo(camera, light, mesh, reflectance, *, views, seed=0):
    """Mean over random places of the lens and of each pixel, and its standard error, shape (H, W)."""
    rng = np.random.default_rng(seed)
    triangles, normals = corners(mesh)
    right, up, forward = camera.right_up_forward()
    total = square = 0.0
    for _ in range(views):
        radius, angle = 0.5 * APERTURE * np.sqrt(rng.random()), 2 * np.pi * rng.random()
        place = camera.position + radius * (np.cos(angle) * right + np.sin(angle) * up)
        pixels = camera.pixel_centres() + rng.random((camera.width * camera.height, 2)) - 0.5
        chief = camera.directions(pixels)
        sharp = camera.position + FOCUS * chief / (chief @ forward)[:, None]
        rays = (sharp - place) / np.linalg.norm(sharp - place, axis=1, keepdims=True)
        face, t, u, v = ref.closest(place, rays, triangles)
        weights = np.stack([1 - u - v, u, v], axis=1)[:, :, None]
        point, normal = ((corner[face] * weights).sum(axis=1) for corner in (triangles, normals))
        a, b, c = np.moveaxis(triangles[face], 1, 0)
        geometric = np.cross(b - a, c - a)
        geometric /= np.linalg.norm(geometric, axis=1, keepdims=True)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        back = (np.einsum("ij,ij->i", geometric, -rays) <= 0) & (face >= 0)
        hits = ref.Hits(face, back, t, point, normal, geometric, -rays)
        level = ref.render(camera, light, triangles, normals, hits=hits, **reflectance).level
        total, square = total + level, square + level**2
    mean = total / views
    return mean, np.sqrt(np.maximum(square / views - mean**2, 0) / (views - 1))


CASES = {
    # an edge 40 mm above what it hides, which is tilted through the focus, and its shadow
    "step": (merged(plane(10, tilt=40), box([-1, -2, 15], [2.5, 2, 35])), {"R_d": 120.0, "R_s": 0.0, "sigma": 0.05}),
    # in focus, but the images of four lights lie 30 mm behind it
    "mirror": (cap(60.0, half=7.0, cells=8), {"R_d": 5.0, "R_s": 4000.0, "sigma": 0.006}),
}


@pytest.mark.parametrize("case", ["step", pytest.param("mirror", marks=pytest.mark.nightly)])
def test_images_are_those_of_rays_through_a_thin_lens(case):
    mesh, reflectance = CASES[case]
    camera = ref.Camera(width=48, height=36, pixel_um=25.0, image_distance=IMAGE_DISTANCE)
    light = ref.Light(elevation=82, azimuth=30, size=(40, 40))
    scene = scene_from_mesh(camera, [light], mesh, reflectance=reflectance)
    views = 160
    expected, error = monte_carlo(camera, light, mesh, reflectance, views=views)
    found = levels(with_lens(scene), supersample=11)  # 128 views
    sharp = levels(scene, supersample=3)
    # well-spread views have a smaller error than random ones, which do not show how large theirs is where what is seen
    # differs in one view of hundreds
    error = np.hypot(error, expected.max() / views)
    z = (found - expected) / error
    lit = expected > 1.0
    assert np.count_nonzero(lit) > 500
    print(f"{case}: rms z {np.sqrt(np.mean(z[lit] ** 2)):.2f}, largest {np.abs(z[lit]).max():.2f}")
    assert np.sqrt(np.mean(z[lit] ** 2)) < 1.25
    assert np.abs(z[lit]).max() < 6
    blurred = np.abs(sharp - expected) > 6 * error
    assert np.count_nonzero(blurred[lit]) > 50, "a pinhole would pass as well"


def test_an_edge_out_of_focus_has_the_profile_of_the_disc():
    camera = ref.Camera(width=60, height=21, pixel_um=10.0, image_distance=IMAGE_DISTANCE)
    light = ref.Light(elevation=90, azimuth=0, k=1)
    mesh = plane(20, z=30.0)
    mesh = replace(mesh, vertices=mesh.vertices - np.array([20.0, 0.0, 0.0]))  # the edge is at x = 0
    scene = scene_from_mesh(camera, [light], mesh, reflectance={"R_d": 100.0, "R_s": 0.0, "sigma": 0.1})
    depth = camera.distance - 30.0
    diameter = APERTURE * IMAGE_DISTANCE * abs(1 / depth - 1 / FOCUS) / 0.01
    assert 10 < diameter < 20
    found = levels(with_lens(scene), supersample=16)[10]
    t = np.clip((np.arange(60) + 0.5 - 30) / (0.5 * diameter), -1, 1)
    profile = 0.5 - (np.arcsin(t) + t * np.sqrt(1 - t * t)) / np.pi
    np.testing.assert_allclose(found / found[15], profile, atol=0.02)


def test_points_in_focus_stay_where_they_are_and_others_move_by_the_circle_of_confusion():
    camera = ref.Camera(width=160, height=120, distortion=(-0.2, 0.1, 0.003, -0.002, 0.05))
    scene = scene_from_mesh(camera, [ref.Light()], plane())
    own = with_lens(scene).camera
    points = np.random.default_rng(1).uniform(-15, 15, (50, 3)) * [1, 1, 0]
    middle = np.stack(project(own, points)[:2])
    for place in ([1.0, 0.0], [-0.3, 0.8]):
        through = through_lens(own, np.array(place))
        np.testing.assert_allclose(np.stack(project(through, points)[:2]), middle, atol=1e-9)
        rays = pixel_directions(through, *middle)
        met = through.position + rays * (-through.position[2] / rays[:, 2])[:, None]
        np.testing.assert_allclose(met, points, atol=1e-9)
    near = np.array([[0.0, 0.0, 25.0]])
    ends = [np.array(project(through_lens(own, np.array([side, 0.0])), near)[:2]) for side in (1.0, -1.0)]
    expected = APERTURE * IMAGE_DISTANCE * abs(1 / (camera.distance - 25) - 1 / FOCUS) / 0.044
    assert np.linalg.norm(ends[0] - ends[1]) == pytest.approx(expected, rel=0.01)


def test_diffraction_spreads_the_light_and_keeps_it():
    camera = ref.Camera(width=160, height=160, pixel_um=20.0, image_distance=IMAGE_DISTANCE)
    scene = scene_from_mesh(camera, [ref.Light(k=1)], plane(1.0), reflectance={"R_d": 100.0, "R_s": 0.0, "sigma": 0.1})
    thin = replace(scene, camera=replace(scene.camera, lens=Lens(aperture=1.0, focus=FOCUS)))
    wide = replace(scene, camera=replace(scene.camera, lens=Lens(aperture=1.0, focus=FOCUS, wavelength=550e-6)))
    plain, spread = (levels(s) for s in (thin, wide))
    assert spread.sum() == pytest.approx(plain.sum(), rel=1e-5)
    assert spread.max() < 0.95 * plain.max()
    assert spread[plain == 0].max() > 1.0
    # far from it Airy's rings have a mean of 1 / (π³ ν r³) of its light
    cutoff = 1.0 * 0.02 / (550e-6 * IMAGE_DISTANCE)
    radius = 40.0
    ring = spread[80, 80 + 35 : 80 + 46].mean()
    assert ring == pytest.approx(plain.sum() / (np.pi**3 * cutoff * radius**3), rel=0.15)


def test_what_pixels_are_expected_to_see_of_a_blurred_stain_is_what_the_image_shows():
    camera = ref.Camera(width=64, height=48, pixel_um=10.0, image_distance=IMAGE_DISTANCE)
    level = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.1}
    scene = with_lens(scene_from_mesh(camera, [ref.Light(elevation=90, k=1)], plane(20, z=25.0), reflectance=level))
    shape = DefectShape(kind="stain", length=1.0, width=1.0, R_d_factor=0.5)
    footprint = 0.01 / IMAGE_DISTANCE * (camera.distance - 25)
    middle = np.array([0.5 * footprint, -0.5 * footprint, 25.0])  # in the middle of pixel (32, 24)
    stain = PlacedDefect(
        name="stain", shape=shape, position=middle, normal=np.array([0, 0, 1.0]), along=np.array([1.0, 0, 0])
    )
    good = levels(scene, supersample=11)
    change = (levels(replace(scene, defects=(stain,)), supersample=11) - good) / (-0.5 * good)
    blur = typical_blur(scene.camera, np.array([[0.0, 0.0, 25.0]]))
    assert blur > 10
    hypotheses = defect_hypotheses(CatalogueEntry(name="stain", shape=shape))
    seen = hypotheses.seen_by_pixels(1, 0, plane_to_image(0, footprint), blur_px=blur)
    expected = np.zeros_like(good)
    expected[24 + seen.row, 32 + seen.column] = seen.weight
    # the faintest pixels are left out of hypotheses
    np.testing.assert_allclose(change, expected, atol=0.07)
    assert (change**2).sum() == pytest.approx((expected**2).sum(), rel=0.03)
    assert search_grid(hypotheses, footprint, blur).ratio > search_grid(hypotheses, footprint).ratio
    sharp = hypotheses.seen_by_pixels(1, 0, plane_to_image(0, footprint))
    assert (expected**2).sum() < 0.6 * (sharp.weight**2).sum()  # a blurred defect is harder to find


def test_a_plan_expects_less_evidence_of_defects_out_of_focus(tmp_path):
    (tmp_path / "knob.stl").write_bytes((PARTS / "cover-knob.stl").read_bytes())
    (tmp_path / "part.yaml").write_text(PART, encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    scene = build_scene(tmp_path / "rig.yaml", tmp_path / "part.yaml")
    catalogue = planned_catalogue([one for one in BUILT_IN_CATALOGUE if one.name == "dent"])
    detection = DetectionModel(catalogue=catalogue, sensor=scene.sensor, full_scale=255.0)
    units = []
    for lens in (None, Lens(aperture=APERTURE, focus=540.0), Lens(aperture=APERTURE, focus=440.0)):
        own = replace(scene, camera=replace(scene.camera, lens=lens))
        caster = cast_rays_at(own)
        table = build_patches(own, caster=caster, budget=600)
        panels = [[light] for light in own.lights]
        found = luminance_matrix(own, table, own.postures[0], panels, caster=caster, detection=detection)
        units.append(sum(int(np.bitwise_count(words).sum()) for words in found.visibility.words))
    sharp, near, far = units
    assert sharp > 1000
    assert 0.6 * sharp < near <= 1.02 * sharp
    assert far < 0.6 * sharp


def test_the_simulated_camera_has_the_lens():
    camera = ref.Camera(width=48, height=36, pixel_um=50.0, image_distance=IMAGE_DISTANCE)
    scene = with_lens(scene_from_mesh(camera, [ref.Light()], box([-5, -5, 0], [5, 5, 40])))
    frame = BenchOptics(scene, BenchTruth()).frame({"light0": 1.0}, scene.postures[0], exposure=1.0)
    expected = expose(levels(scene), sensor=scene.sensor, exposure=1.0, full_scale=255.0)
    assert np.array_equal(frame, expected)
    assert np.count_nonzero((frame > 3) & (frame < 0.9 * frame.max())) > 100


def test_threads_and_repeats_make_no_difference():
    camera = ref.Camera(width=64, height=48, pixel_um=100.0)
    scene = with_lens(scene_from_mesh(camera, [ref.Light()], plane(tilt=30)), wavelength=550e-6)
    caster = cast_rays_at(scene)
    one, two = (render_lights(scene, scene.postures[0], caster=caster, threads=n)[0].level for n in (1, 2))
    assert one.tobytes() == two.tobytes()
    assert one.max() > 0
