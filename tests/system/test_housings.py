"""Housings of the lights in the surroundings that a part mirrors: closed forms, and a sum over all directions."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from reference._frames import axes
from scipy.special import ndtr
from worlds import PARTS, levels, plane, scene_from_mesh, sphere

from lightopt import build_scene
from lightopt.config import load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration import Placement
from lightopt.inspection.prediction._nearby_placement import shifted_scene
from lightopt.optics import white_level
from lightopt.preflight import check_scene
from lightopt.rendering import SurfacePoints, cast_rays_at, render_lights, render_posture
from lightopt.rendering._interreflection import PartLight
from lightopt.rendering._surface import trace_samples
from lightopt.scene import Housings, move_part
from lightopt.scene._lights import build_housings

MIRROR = {"R_d": 0.0, "R_s": 1e6, "sigma": 0.002}
SATIN = {"R_d": 45.0, "R_s": 12500.0, "sigma": 0.0475}
CAMERA = ref.Camera(width=96, height=72, pixel_um=40.0)
LAMP = ref.Light(distance=330, elevation=70, azimuth=30, size=(60, 40), k=2, gain=0.5)
MARGIN, AROUND, HOUSING = 15.0, 80.0, 10.0


def rectangle(light, margin):
    """A housing's numbers of a light of the reference."""
    out, across, along = axes(light.elevation, light.azimuth)
    half = 0.5 * np.array(light.size) + margin
    return np.array([light.distance * out, out, across / half[0], along / half[1]])


def housed(scene, *lights, level=HOUSING, margin=MARGIN):
    rows = np.array([rectangle(light, margin) for light in lights])
    return replace(scene, housings=Housings(level=level, rectangles=rows))


def mirrored_share(scene):
    """Of the light of a narrow lobe, from all directions alike."""
    r = scene.reflectance
    return 8.0 * r.sigma**2 * (1.0 - 4.0 / 3.0 * r.sigma**2) * r.R_s / white_level(r)


@pytest.mark.parametrize("posture", [(0.0, 0.0), (2.0, 8.0)])
def test_a_mirror_shows_each_light_in_a_dark_frame(posture):
    """Each pixel mirrors, in plain NumPy, a place in the frame around the lamp, on the lamp, or in the white box."""
    mesh = plane(half=60.0, tilt=9.0, azimuth=125.0)
    scene = scene_from_mesh(CAMERA, [LAMP], mesh, postures=[posture], reflectance=MIRROR)
    found = levels(housed(replace(scene, environment=AROUND), LAMP)) - levels(scene)
    corners = ref.posed(mesh.vertices[mesh.faces], *posture, (0, 0, 0))[0]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    rays = CAMERA.directions(CAMERA.pixel_centres())
    points = CAMERA.position + rays * ((corners[0] - CAMERA.position) @ normal / (rays @ normal))[:, None]
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    ways = rays - 2.0 * (rays @ normal)[:, None] * normal
    middle, out, *_ = rectangle(LAMP, MARGIN)
    reach = (middle - points) @ out / (ways @ out)
    place = points + reach[:, None] * ways - middle
    _, across, along = axes(LAMP.elevation, LAMP.azimuth)
    beyond = np.maximum(
        np.abs(place @ across) - 0.5 * LAMP.size[0], np.abs(place @ along) - 0.5 * LAMP.size[1]
    ).reshape(found.shape)
    blurred = 5.0 * 2.0 * MIRROR["sigma"] * 330.0  # of the edges, by the lobe [mm]
    share = mirrored_share(scene) * LAMP.gain
    inside, outside = beyond < MARGIN - blurred, beyond > MARGIN + blurred
    assert min(inside.sum(), outside.sum(), np.sum(inside & (beyond > 0)), np.sum(beyond < 0)) > 100
    np.testing.assert_allclose(found[inside], share * HOUSING, rtol=0.02)
    np.testing.assert_allclose(found[outside], share * AROUND, rtol=0.02)
    edge = found[~inside & ~outside]
    assert edge.min() > 0.9 * share * HOUSING
    assert edge.max() < 1.1 * share * AROUND


def surface_points(points, normal, views):
    count = len(points)
    normals = np.tile(np.array(normal, float), (count, 1))
    views = np.array(views, float)
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    return SurfacePoints(np.array(points, float), normals, normals, views, np.ones(count, bool))


def part_light(scene):
    return PartLight.of_scene(scene, scene.lights, cast_rays_at(scene), housings=scene.housings)


def test_the_share_of_the_lobe_that_falls_on_a_half_plane():
    """Seen along the normal, half vectors lie in a Gaussian of σ and what they mirror at twice their angle."""
    height, sigma = 300.0, 0.03
    scene = scene_from_mesh(
        CAMERA, [ref.Light()], plane(half=90.0), reflectance={"R_d": 0.0, "R_s": 1e4, "sigma": sigma}
    )
    # all of x > 0 at that height, far out
    far = 1e5
    rows = np.array([[[far, 0, height], [0, 0, 1.0], [1 / far, 0, 0], [0, 1 / far, 0]]])
    scene = replace(scene, environment=100.0, housings=Housings(level=0.0, rectangles=rows))
    x, y = np.linspace(-40.0, 40.0, 17), np.random.default_rng(1).uniform(-10.0, 10.0, 40)
    places = [(a, b, 0) for a in x for b in y]
    found = part_light(scene).specular(surface_points(places, (0, 0, 1), [(0, 0, 1)] * len(places)))
    found = found[0, 0].reshape(len(x), len(y))
    most = mirrored_share(scene) * 100.0
    expected = most * ndtr(-x / height / (2.0 * sigma))
    np.testing.assert_allclose(found.mean(axis=1), expected, atol=0.01 * most)
    assert np.abs(found - expected[:, None]).max() < 0.06 * most


def sum_of_directions(scene, surface, steps=(500, 2000)):
    """Diffuse and specular light of the surroundings, as a sum over cells of the hemisphere."""
    r, white = scene.reflectance, white_level(scene.reflectance)
    theta = (np.arange(steps[0]) + 0.5) / steps[0] * 0.5 * np.pi
    phi = (np.arange(steps[1]) + 0.5) / steps[1] * 2.0 * np.pi
    t, p = (a.ravel() for a in np.meshgrid(theta, phi, indexing="ij"))
    ways = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
    cells = np.sin(t) * (0.5 * np.pi / steps[0]) * (2.0 * np.pi / steps[1])
    found = []
    for point, view in zip(surface.points, surface.views, strict=True):
        level = np.full(len(ways), scene.environment)
        for middle, out, across, along in scene.housings.rectangles:
            reach = (middle - point) @ out / (ways @ out)
            place = point + reach[:, None] * ways - middle
            level[(reach > 0) & (np.abs(place @ across) <= 1) & (np.abs(place @ along) <= 1)] = scene.housings.level
        half = ways + view
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        lobe = r.R_s / view[2] * np.exp(-0.5 * (np.arccos(np.clip(half[:, 2], -1, 1)) / r.sigma) ** 2)
        parts = (r.R_d * ways[:, 2], lobe)
        found.append([float(np.sum(part * level * cells)) / (math.pi * white) for part in parts])
    return np.array(found).T


@pytest.mark.parametrize(("around", "housing"), [(60.0, 0.0), (0.0, 60.0)])
def test_two_housings_against_a_sum_over_all_directions(around, housing):
    lamps = [LAMP, ref.Light(distance=250, elevation=50, azimuth=160, size=(80, 30), k=2)]
    scene = scene_from_mesh(CAMERA, lamps, plane(half=30.0), reflectance=SATIN)
    scene = housed(replace(scene, environment=around), *lamps, level=housing, margin=20.0)
    places = [(0, 0, 0), (10, -5, 0), (-12, 8, 0), (3, 20, 0)]
    # mirrored towards the edge of the first housing, its middle, the second, and the box
    views = []
    for place, target in zip(places, ([20, 40], [0, 0], [5, -20], [160, 90]), strict=True):
        lamp = lamps[1] if target == [5, -20] else lamps[0]
        out, across, along = axes(lamp.elevation, lamp.azimuth)
        to = lamp.distance * out + target[0] * across + target[1] * along - np.array(place, float)
        views.append(to * [-1, -1, 1])
    surface = surface_points(places, (0, 0, 1), views)
    diffuse, specular = sum_of_directions(scene, surface)
    own = part_light(scene)
    np.testing.assert_allclose(own.diffuse(surface)[0, 0], 0.5 * diffuse, rtol=0.03, atol=0.1)
    np.testing.assert_allclose(own.specular(surface)[0, 0], 0.5 * specular, rtol=0.03, atol=0.15)
    assert np.ptp(specular) > 10.0


def test_a_frame_is_sharp_in_a_curved_mirror():
    """Frames a few pixels wide in a ball: interpolated squares of pixels against every pixel for itself."""
    lamps = [ref.Light(distance=330, elevation=e, azimuth=a, size=(60, 60), k=2) for e, a in ((60, 45), (40, 200))]
    scene = scene_from_mesh(CAMERA, lamps, sphere(16.0, rows=128), reflectance=MIRROR)
    scene = housed(replace(scene, environment=AROUND), *lamps, margin=25.0)
    image = levels(scene) - levels(replace(scene, environment=0.0, housings=None))
    dark = image < 0.5 * (AROUND + HOUSING) * mirrored_share(scene)
    count = np.count_nonzero(dark & (image > 0))
    assert 40 < count < 2000
    caster = cast_rays_at(scene)
    y, x = (a.ravel() for a in np.mgrid[: CAMERA.height, : CAMERA.width])
    hits, surface = trace_samples(caster, scene.mesh, scene.camera, x + 0.5, y + 0.5, neighbours=True)
    alone = np.zeros(image.size)
    alone[hits.ray] = part_light(scene).specular(surface)[0, 0]
    seen = np.zeros(image.size, bool)
    facing = np.einsum("ij,ij->i", surface.normals, surface.views) > 0.3
    seen[hits.ray[facing]] = True
    off = np.abs(alone - image.ravel())[seen]
    assert np.mean(off > 0.05 * AROUND * mirrored_share(scene)) < 0.01


def test_housings_move_with_camera_and_lights_in_predictions_of_a_displaced_part():
    bare = scene_from_mesh(CAMERA, [LAMP], plane(half=60.0, tilt=9.0, azimuth=125.0), reflectance=MIRROR)
    scene = housed(replace(bare, environment=AROUND), LAMP)
    turn, shift = rotation_z(0.05), np.array([6.0, -4.0, 0.0])

    def displaced(own):
        shifted = shifted_scene(own, Placement(), own.postures[0], np.array([*shift[:2], 0.05]))
        return render_lights(shifted, own.postures[0], caster=cast_rays_at(own))[0].level.astype(float)

    found = displaced(scene) - displaced(bare)
    expected = levels(move_part(scene, turn, shift)) - levels(move_part(bare, turn, shift))
    step = mirrored_share(scene) * LAMP.gain * (AROUND - HOUSING)
    unmoved = levels(scene) - levels(bare)
    assert np.mean(np.abs(found - expected)) < 0.003 * step
    assert np.mean(np.abs(unmoved - expected)) > 0.01 * step


RIG = """\
format: lightopt-rig/1
name: housed
camera: {distance_mm: 550, elevation_deg: 90, resolution_px: [64, 48], pixel_size_um: 100, image_distance_mm: 55,
  sensor: {bit_depth: 8}}
light_source: {size_mm: [60, 40], points: 4}
lights:
  - {name: panel, distance_mm: 330, elevation_deg: 60, azimuth_deg: 45}
  - {name: bar, kind: bar, size_mm: [200, 20], distance_mm: 300, elevation_deg: 30, azimuth_deg: 90}
  - {name: dome, kind: dome, radius_mm: 150}
  - {name: screen, kind: display, size_mm: [300, 200], distance_mm: 400, elevation_deg: 50, azimuth_deg: 0,
     pattern: {kind: sine, period_mm: 20}}
environment: {level: 5, housings: {margin_mm: 10, level: 1}}
"""
PART = """\
format: lightopt-part/1
name: plate
mesh: {file: plate.stl, units: mm}
reflectance: {R_d: 45.0, R_s: 12500, sigma_rad: 0.0475}
postures: [{elevation_deg: 0, rotation_deg: 0}]
"""


@pytest.fixture
def rig_of(tmp_path):
    def load(old="", new=""):
        (tmp_path / "rig.yaml").write_text(RIG.replace(old, new) if old else RIG, encoding="utf-8")
        return load_rig(tmp_path / "rig.yaml")

    return load


def test_housings_of_flat_lights_from_a_rig_file(rig_of):
    found = build_housings(rig_of())
    assert found.level == 1.0
    expected = [
        ref.Light(distance=330, elevation=60, azimuth=45, size=(60, 40)),
        ref.Light(distance=300, elevation=30, azimuth=90, size=(200, 20)),
        ref.Light(distance=400, elevation=50, azimuth=0, size=(300, 200)),
    ]
    np.testing.assert_allclose(found.rectangles, [rectangle(light, 10.0) for light in expected], atol=1e-9)


@pytest.mark.parametrize("level", ["5", "5.0"])
def test_housings_as_bright_as_the_box_are_none(rig_of, level):
    assert build_housings(rig_of("level: 1", f"level: {level}")) is None
    assert build_housings(rig_of("{level: 5, housings: {margin_mm: 10, level: 1}}", "{level: 5}")) is None


def test_lights_that_are_off_have_their_housing_too(rig_of, tmp_path):
    rig_of()
    shutil.copyfile(PARTS / "spout.stl", tmp_path / "plate.stl")
    (tmp_path / "part.yaml").write_text(PART, encoding="utf-8")
    one, everything = (
        build_scene(tmp_path / "rig.yaml", tmp_path / "part.yaml", lights=lights) for lights in (["panel"], None)
    )
    assert np.array_equal(one.housings.rectangles, everything.housings.rectangles)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (("margin_mm: 10, ", ""), 'environment.housings: missing key "margin_mm"'),
        (("margin_mm: 10", "margin_mm: -1"), "environment.housings.margin_mm: expected a length from 0 to 10000"),
        (("level: 1}", "level: -1}"), "environment.housings.level: expected a number from 0"),
        (("margin_mm: 10", "margin: 10"), 'environment.housings: unknown key "margin"'),
    ],
)
def test_wrong_housings_are_named_with_their_line(rig_of, wrong, says):
    with pytest.raises(InputError) as error:
        rig_of(*wrong)
    assert "rig.yaml:12: " in str(error.value)
    assert says in str(error.value)


def test_a_rig_without_flat_lights_has_no_housings(rig_of):
    flat = RIG[RIG.index("  - {name: panel") : RIG.index("environment")]
    with pytest.raises(InputError, match=r"environment.housings: no light of the rig has a rectangle for its housing"):
        rig_of(flat, "  - {name: dome, kind: dome, radius_mm: 150}\n")


@pytest.mark.parametrize(
    ("housings", "level", "says"),
    [
        ("{margin_mm: 200, level: 0}", "warning", "the housing of light1 stands in the camera's view and covers "),
        ("{margin_mm: 10, level: 5}", "warning", "they are as bright, so that the part shows none"),
        ("{margin_mm: 10, level: 0}", "ok", "2 housings of level 0, in surroundings of level 5"),
    ],
)
def test_check_says_what_housings_do(bench, housings, level, says):
    """One that is in the view hides the part behind it, as the images show."""
    bench.edit("rig.yaml", "\nstage:", f"\nenvironment: {{level: 5, housings: {housings}}}\nstage:")
    found = check_scene(load_rig(bench.rig), load_part(bench.part)).findings
    [first, *_] = [one for one in found if one.topic == "housings"]
    assert (first.level, says in first.text) == (level, True)
    assert "environment.housings" in first.where
    scene = build_scene(bench.rig, bench.part)
    assert (scene.camera.obstructions is not None) == ("stands in" in says)
    if "stands in" in says:
        free = replace(scene, camera=replace(scene.camera, obstructions=None))
        hidden, seen = (render_posture(own, scene.postures[0], caster=cast_rays_at(own)) for own in (scene, free))
        gone = seen.geometry.hit & ~hidden.geometry.hit
        assert gone.mean() > 0.1 * seen.geometry.hit.mean()
        assert hidden.lights[0].level[gone].max() == 0.0
