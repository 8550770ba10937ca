"""Defects in images against what the reflection model says by hand.

Expected: inside a defect the level of Lambert and Torrance–Sparrow with the tilted normal and the changed coefficients,
outside it the level of the good part to the last bit; labels exactly on the outline; narrow defects by their share of a
pixel; shadows those of the undisturbed surface, for point lights and for the converged panel.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import reference as ref
from worlds import box, levels, merged, plane, scene_from_mesh, sphere

import lightopt.rendering._images as blocks
from lightopt import render
from lightopt.defects import DefectShape, PlacedDefect, tangent_direction
from lightopt.optics import Reflectance

CAMERA = ref.Camera(width=120, height=90, pixel_um=10)  # 0.1 mm a pixel
FOOTPRINT = 0.1
COEFFICIENTS = {"R_d": 45.0, "R_s": 900.0, "sigma": 0.05}
X, Y, Z = np.eye(3)


def defect(kind, size, *, slope=0.0, at=(0.0, 0.0, 0.0), angle=0.0, normal=Z, **factors):
    shape = DefectShape(kind=kind, length=size[0], width=size[1], slope=math.radians(slope), **factors)
    along = tangent_direction(np.asarray(normal, float), math.radians(angle), x_axis=X, y_axis=Y)
    return PlacedDefect(
        name=kind, shape=shape, position=np.array(at, float), normal=np.asarray(normal, float), along=along
    )


def both(scene, *defects, **options):
    """Images without and with defects."""
    good = next(iter(render(scene, threads=2, **options)))
    bad = next(iter(render(replace(scene, defects=defects), threads=2, **options)))
    return good, bad


def by_hand(geometry, normals, light, *, R_d, R_s, sigma):
    """Equations 2 and 3 for one point light, at every pixel."""
    p = geometry.points.astype(float)
    to_light = light.distance * light.axis - p
    to_light /= np.linalg.norm(to_light, axis=-1, keepdims=True)
    view = CAMERA.position - p
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    half = to_light + view
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    delta = np.arctan2(np.linalg.norm(np.cross(normals, half), axis=-1), np.sum(normals * half, axis=-1))
    diffuse = R_d * np.maximum(0, np.sum(normals * to_light, axis=-1))
    specular = R_s / np.sum(normals * view, axis=-1) * np.exp(-(delta**2) / (2 * sigma**2))
    return diffuse, specular


@pytest.mark.parametrize("azimuth", [0, 200])
def test_a_dent_on_a_plane_is_shaded_with_the_tilted_normal(azimuth):
    light = ref.Light(k=1, elevation=78, azimuth=azimuth)
    scene = scene_from_mesh(CAMERA, [light], plane(), reflectance=COEFFICIENTS)
    good, bad = both(scene, defect("dent", (4.0, 4.0), slope=8))
    label = bad.geometry.defect
    x, y = bad.geometry.points[..., 0].astype(float), bad.geometry.points[..., 1].astype(float)
    r = np.hypot(x, y)
    # a cosine bowl of radius 2, whose slope is steepest, tan 8°, at r = 1
    rise = math.tan(math.radians(8)) * np.sin(np.pi * r / 2) / np.maximum(r, 1e-12)
    normals = np.stack([-rise * x, -rise * y, np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    expected = sum(by_hand(bad.geometry, normals, light, **COEFFICIENTS))
    inside = r < 2
    np.testing.assert_array_equal(label >= 0, inside)
    np.testing.assert_allclose(bad.lights[0].level[inside], expected[inside], rtol=2e-5)
    assert np.ptp(bad.lights[0].level[inside]) > 400, "the dent is to be seen"
    np.testing.assert_array_equal(bad.lights[0].level[~inside], good.lights[0].level[~inside])
    for name in ("points", "normals", "distance"):
        np.testing.assert_array_equal(getattr(bad.geometry, name), getattr(good.geometry, name))
    assert good.geometry.defect is None


@pytest.mark.parametrize("points", [1, "auto"])
def test_a_stain_multiplies_the_diffuse_layer_by_its_factor(points):
    scene = scene_from_mesh(CAMERA, [ref.Light(k=1)], plane(), points=points, reflectance=COEFFICIENTS)
    good, bad = both(scene, defect("stain", (4.0, 2.0), angle=30, R_d_factor=0.6), layers=True)
    inside = bad.geometry.defect == 0
    ratio = bad.lights[0].diffuse / good.lights[0].diffuse
    np.testing.assert_allclose(ratio[inside], 0.6, rtol=1e-6)
    assert (ratio[~inside] == 1).all()
    np.testing.assert_array_equal(bad.lights[0].specular, good.lights[0].specular)


def test_a_haze_widens_the_lobe_and_keeps_what_it_reflects():
    light = ref.Light(k=1, elevation=89, azimuth=0)
    scene = scene_from_mesh(CAMERA, [light], plane(), reflectance=COEFFICIENTS)
    good, bad = both(scene, defect("haze", (30.0, 30.0), sigma_factor=1.5), layers=True)
    normals = np.broadcast_to(Z, good.geometry.points.shape)
    _, expected = by_hand(good.geometry, normals, light, R_d=45, R_s=900 / 1.5**2, sigma=0.05 * 1.5)
    np.testing.assert_allclose(bad.lights[0].specular, expected, rtol=2e-5, atol=1e-9)
    np.testing.assert_array_equal(bad.lights[0].diffuse, good.lights[0].diffuse)
    assert bad.lights[0].specular.max() < 0.5 * good.lights[0].specular.max()


@pytest.mark.parametrize("sigma", [0.003, 0.05, 0.1])
def test_a_haze_reflects_as_much_light_as_the_surface_it_is_on(sigma):
    """R_s times the integral of the lobe over the half vectors, before and after σ is doubled."""
    delta = np.linspace(0, np.pi / 2, 400_001)
    one = Reflectance(R_d=0, R_s=1, sigma=sigma)
    sums = [
        r.R_s * np.sum(np.exp(-(delta**2) / (2 * r.sigma**2)) * np.sin(delta)) * delta[1]
        for r in (one, one.changed(sigma_factor=2))
    ]
    assert sums[1] == pytest.approx(sums[0], rel=0.02)


@pytest.mark.parametrize(("azimuth", "side"), [(0, -1), (180, 1)])
def test_the_highlight_of_a_scratch_is_on_the_facet_that_mirrors_the_light(azimuth, side):
    """Light 12° off the view needs a normal tilted by 6° towards it: the far wall of a groove of 6°."""
    light = ref.Light(k=1, elevation=78, azimuth=azimuth)
    sharp = {"R_d": 45.0, "R_s": 900.0, "sigma": 0.01}
    scene = scene_from_mesh(CAMERA, [light], plane(), reflectance=sharp)
    good, bad = both(scene, defect("scratch", (6.0, 2.0), slope=6, angle=90), layers=True)
    assert good.lights[0].specular.max() < 1e-3
    specular = bad.lights[0].specular
    x, y = bad.geometry.points[..., 0], bad.geometry.points[..., 1]
    rho = side * x  # half the width is 1 mm
    wall = (rho > 0.2) & (rho < 0.8) & (np.abs(y) < 1.5)
    assert specular[wall].min() > 0.75 * 900
    assert specular[(rho < -0.05) & (np.abs(y) < 1.5)].max() < 1e-3
    assert specular[np.abs(x) > 1.01].max() < 1e-3


@pytest.mark.parametrize("kind", ["scratch", "blister"])
def test_the_label_is_exactly_where_the_outline_is(kind):
    some = defect(kind, (5.0, 3.0), slope=3, at=(0.4, -0.3, 0.0), angle=25)
    scene = scene_from_mesh(CAMERA, [ref.Light(k=1)], plane(), reflectance=COEFFICIENTS)
    _, bad = both(scene, defect("stain", (1.0, 1.0), at=(4.0, 3.0, 0.0), R_d_factor=0.5), some)
    p = bad.geometry.points.astype(float) - some.position
    c, s = math.cos(math.radians(25)), math.sin(math.radians(25))
    x, y = c * p[..., 0] + s * p[..., 1], -s * p[..., 0] + c * p[..., 1]
    if kind == "scratch":
        expected = np.hypot(np.maximum(np.abs(x) - 1.0, 0), y) < 1.5
        area = 2.0 * 3.0 + math.pi * 1.5**2
    else:
        expected = (x / 2.5) ** 2 + (y / 1.5) ** 2 < 1
        area = math.pi * 2.5 * 1.5
    label = bad.geometry.defect
    np.testing.assert_array_equal(label == 1, expected)
    assert set(np.unique(label)) == {-1, 0, 1}
    assert (label == 1).sum() * FOOTPRINT**2 == pytest.approx(area, rel=0.01)


def test_a_defect_narrower_than_a_pixel_shows_with_its_fill_factor():
    """The light that a stain 0.3 pixel wide takes away is its area's, with 8 × 8 rays a pixel; with one it is not."""
    stain = defect("stain", (6.0, 0.03), at=(0.05, 0.05, 0.0), angle=90, R_d_factor=0.2)
    scene = scene_from_mesh(CAMERA, [ref.Light(k=1, elevation=80)], plane(), reflectance={**COEFFICIENTS, "R_s": 0.0})
    lost = {}
    for n in (1, 8):
        good, bad = both(scene, stain, supersample=n)
        share = 1 - bad.lights[0].level.astype(float) / good.lights[0].level
        lost[n] = share.sum() * FOOTPRINT**2 / (1 - 0.2)
    assert lost[8] == pytest.approx(stain.shape.area, rel=0.1)
    assert abs(lost[1] - stain.shape.area) > 0.5 * stain.shape.area


@pytest.mark.parametrize("points", [16, "auto"])
def test_shadows_are_those_of_the_undisturbed_surface(points):
    """A stain across the edge of a shadow keeps its factor in umbra, penumbra and light."""
    world = merged(plane(), box((2.0, -5.0, 1.0), (6.0, 5.0, 3.0)))
    camera = ref.Camera(width=80, height=60, pixel_um=20)
    scene = scene_from_mesh(
        camera, [ref.Light(k=4, elevation=45, azimuth=0)], world, points=points, reflectance=COEFFICIENTS
    )
    stain = defect("stain", (7.0, 7.0), at=(-1.8, 0.0, 0.0), R_d_factor=0.5)
    good, bad = both(scene, stain, layers=True)
    inside = bad.geometry.defect == 0
    before, after = good.lights[0].diffuse[inside], bad.lights[0].diffuse[inside]
    assert (before == 0).any()
    assert before.max() > 30
    assert np.count_nonzero((before > 1) & (before < 0.95 * before.max())) > 20, "there is a penumbra"
    np.testing.assert_allclose(after, 0.5 * before, rtol=1e-6, atol=0.05 if points == "auto" else 0)


def test_point_lights_and_the_converged_panel_show_the_same_scratch():
    camera = ref.Camera(width=60, height=45, pixel_um=20)
    scene = {
        points: scene_from_mesh(
            camera, [ref.Light(k=1, elevation=75)], sphere(20.0, centre=(0, 0, -20.0)), points=points
        )
        for points in (1024, "auto")
    }
    some = defect("scratch", (6.0, 1.5), slope=8, angle=40)
    one, other = (levels(replace(s, defects=(some,))) for s in scene.values())
    assert np.ptp(one) > 1000
    np.testing.assert_allclose(other, one, rtol=0.01, atol=0.5)


def test_a_dent_across_the_edge_of_a_shadow_is_the_same_with_many_point_lights():
    """Tilted normals in the penumbra: 48 × 48 points are 0.33 level off at the shadow's edge without the dent, too."""
    world = merged(plane(), box((2.0, -5.0, 1.0), (6.0, 5.0, 3.0)))
    camera = ref.Camera(width=60, height=45, pixel_um=20)
    dent = defect("dent", (6.0, 6.0), slope=25, at=(-1.2, 0.0, 0.0))
    one, other = (
        levels(
            replace(
                scene_from_mesh(
                    camera,
                    [ref.Light(elevation=45, azimuth=0)],
                    world,
                    points=points,
                    reflectance={**COEFFICIENTS, "R_s": 60.0, "sigma": 0.2},
                ),
                defects=(dent,),
            )
        )
        for points in (2304, "auto")
    )
    assert np.ptp(one) > 50
    error = np.abs(one - other)
    assert np.percentile(error, 99) < 0.4
    assert error.max() < 0.6


def test_the_back_of_a_face_has_no_defects():
    upside_down = plane()
    upside_down = replace(upside_down, faces=upside_down.faces[:, ::-1])
    scene = scene_from_mesh(CAMERA, [ref.Light(k=1)], upside_down, reflectance=COEFFICIENTS)
    image = next(iter(render(replace(scene, defects=(defect("dent", (4.0, 4.0), slope=8, normal=-Z),)))))
    assert image.back_faces > 0
    assert (image.geometry.defect == -1).all()
    assert not image.lights[0].level.any()


@pytest.mark.parametrize("points", [4, "auto"])
def test_the_images_do_not_depend_on_threads(points, monkeypatch):
    monkeypatch.setattr(blocks, "BLOCK_SAMPLES", 500)
    world = merged(sphere(10.0, centre=(0, 0, -10.0)), sphere(1.0, centre=(1.5, 0.0, 1.5)))
    scene = scene_from_mesh(
        ref.Camera(width=60, height=45, pixel_um=30), [ref.Light(elevation=50)], world, points=points
    )
    some = defect("dent", (4.0, 4.0), slope=6), defect("haze", (3.0, 3.0), at=(-2, 0, -0.2), sigma_factor=2)
    one = next(iter(render(replace(scene, defects=some), threads=1)))
    assert {0, 1} <= set(np.unique(one.geometry.defect))
    for threads in (2, 3):
        again = next(iter(render(replace(scene, defects=some), threads=threads)))
        np.testing.assert_array_equal(again.lights[0].level, one.lights[0].level)
        np.testing.assert_array_equal(again.geometry.defect, one.geometry.defect)


def test_no_shadows_still_shows_defects():
    scene = scene_from_mesh(CAMERA, [ref.Light(k=1)], plane(), points="auto", reflectance=COEFFICIENTS)
    shaded = both(scene, defect("dent", (4.0, 4.0), slope=8))[1]
    open_ = both(scene, defect("dent", (4.0, 4.0), slope=8), shadows=False)[1]
    np.testing.assert_allclose(open_.lights[0].level, shaded.lights[0].level, rtol=1e-6)
