"""Cast shadows, horizons and back faces against geometry worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from worlds import PARTS, box, levels, merged, plane, scene_from_files, scene_from_mesh, sphere

from lightopt import render
from lightopt.geometry import TriangleMesh

MATTE = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.05}


def passes_through_box(start, end, low, high):
    """Whether segments between points (N, 3) and one point meet a box, by its six planes."""
    step = end - start
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / step, (high - start) / step
    enter = np.fmin(a, b).max(axis=1)
    leave = np.fmax(a, b).min(axis=1)
    return (enter < leave) & (leave > 0) & (enter < 1)


@pytest.mark.parametrize("bottom", [0.0, 5.0], ids=["standing", "floating"])
@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize(("elevation", "azimuth"), [(60, 45), (30, 190), (25, 270)])
@pytest.mark.parametrize("camera_elevation", [90, 55])
def test_shadow_of_a_box_on_a_plane(bottom, k, elevation, azimuth, camera_elevation):
    """Every pixel of the plane is lit by exactly the points that the box, by hand, does not hide from it."""
    low, high = np.array([-8.0, -5.0, bottom]), np.array([4.0, 7.0, bottom + 9])
    camera = ref.Camera(width=160, height=120, pixel_um=44, elevation=camera_elevation)
    light = ref.Light(distance=200, elevation=elevation, azimuth=azimuth, k=k)
    scene = scene_from_mesh(camera, [light], merged(plane(60), box(low, high)), reflectance=MATTE)
    image = levels(scene)
    rays = camera.directions(camera.pixel_centres())
    points = camera.position - rays * (camera.position[2] / rays[:, 2])[:, None]
    on_plane = ~passes_through_box(np.broadcast_to(camera.position, points.shape), points, low - 1e-3, high + 1e-3)
    expected, certain = np.zeros(len(points)), on_plane.copy()
    shaded = np.zeros(len(points), dtype=bool)
    for source in light.points()[0]:
        to_light = source - points
        lambert = 100 / k**2 * to_light[:, 2] / np.linalg.norm(to_light, axis=1)
        hidden = [passes_through_box(points, source, low - g, high + g) for g in (-1e-4, 0.0, 1e-4)]
        certain &= hidden[0] == hidden[2]
        expected += np.where(hidden[1], 0, lambert)
        shaded |= hidden[1]
    assert np.count_nonzero(shaded & on_plane) > 300
    # the shadow's edge passes within a tenth of a micrometre of hardly any pixel's centre
    assert np.count_nonzero(on_plane & ~certain) <= 5
    np.testing.assert_allclose(image.ravel()[certain], expected[certain], rtol=1e-6, atol=1e-6)


def test_shadows_only_take_light_away(tmp_path):
    camera = ref.Camera(width=160, height=120, pixel_um=44)
    for points in (None, "auto"):
        scene = scene_from_files(
            tmp_path, camera, [ref.Light(elevation=35, azimuth=80)], PARTS / "spout.stl", points=points
        )
        with_shadows = levels(scene)
        without = levels(scene, shadows=False)
        # a part of the panel's light, integrated by another rule than the whole of it, may be off by a rounding
        assert (with_shadows <= without * (1 + 1e-3) + 0.05).all()
        if points is None:
            assert (with_shadows <= without).all()
        assert np.count_nonzero(with_shadows < without - 5) > 300
        assert np.count_nonzero((with_shadows == without) & (without > 0)) > 3000


def test_a_convex_smooth_part_has_no_speckle_of_shadows():
    camera = ref.Camera(width=200, height=200, pixel_um=25)
    light = ref.Light(elevation=40, azimuth=200, k=2)
    scene = scene_from_mesh(camera, [light], sphere(20, rows=60))
    images = next(iter(render(scene, threads=2)))
    clear = levels(scene, shadows=False)
    normals = images.geometry.normals.astype(float)
    to_light = light.points()[0][:, None, None] - images.geometry.points
    to_light /= np.linalg.norm(to_light, axis=3, keepdims=True)
    # facets of 3° have the sun set up to 3° early
    lit = images.geometry.hit & (np.einsum("ijk,pijk->pij", normals, to_light) > np.sin(np.deg2rad(4))).all(axis=0)
    assert np.count_nonzero(lit) > 5000
    assert np.array_equal(images.lights[0].level[lit], clear[lit].astype(np.float32))


def test_the_shadow_side_of_a_box_is_black():
    """Faces turned away are dark by Lambert's law, with or without shadows, however wide the lobe."""
    camera = ref.Camera(width=120, height=90, pixel_um=40, elevation=50, azimuth=270)
    light = ref.Light(elevation=20, azimuth=90, k=2)  # behind the box as the camera sees it
    wide = {"R_d": 45.0, "R_s": 12500.0, "sigma": 1.0}
    scene = scene_from_mesh(camera, [light], box([-8, -8, 0], [8, 8, 16]), reflectance=wide)
    front = next(iter(render(scene, threads=1))).geometry.normals[..., 1] < -0.9
    assert np.count_nonzero(front) > 500
    for shadows in (True, False):
        assert not levels(scene, shadows=shadows)[front].any()


def test_back_faces_are_black_and_counted():
    camera = ref.Camera(width=40, height=30, pixel_um=100)
    up = plane(10)
    down = TriangleMesh(up.vertices, up.faces[:, ::-1], None)
    lit, unlit = (next(iter(render(scene_from_mesh(camera, [ref.Light()], mesh), threads=1))) for mesh in (up, down))
    assert lit.back_faces == 0
    assert lit.lights[0].level.max() > 0
    assert unlit.back_faces == np.count_nonzero(unlit.geometry.hit) == np.count_nonzero(lit.geometry.hit) > 0
    assert not unlit.lights[0].level.any()


def test_a_back_face_casts_a_shadow_like_a_front_face():
    camera = ref.Camera(width=80, height=60, pixel_um=80)
    light = ref.Light(elevation=50, azimuth=90, k=1)
    roof = TriangleMesh(plane(6).vertices + np.array([0, 0, 12.0]), plane(6).faces, None)
    turned = TriangleMesh(roof.vertices, roof.faces[:, ::-1], None)
    one, two = (
        levels(scene_from_mesh(camera, [light], merged(plane(25), lid), reflectance=MATTE)) for lid in (roof, turned)
    )
    seen = next(iter(render(scene_from_mesh(camera, [light], merged(plane(25), roof)), threads=1))).geometry
    ground = seen.hit & (np.abs(seen.points[..., 2]) < 1e-3)
    assert np.count_nonzero(one[ground] == 0) > 50
    assert np.array_equal(one[ground], two[ground])


def test_the_table_and_the_panels_cast_no_shadow():
    """A panel between another panel and the part, and one below the table's plane, change nothing."""
    camera = ref.Camera(width=40, height=30, pixel_um=100)
    far = ref.Light(distance=400, elevation=50, azimuth=0, k=1)
    near = ref.Light(distance=100, elevation=50, azimuth=0, size=(200, 200), k=1)
    mesh = box([-5, -5, -20], [5, 5, 5])
    alone = levels(scene_from_mesh(camera, [far], mesh))
    assert np.array_equal(levels(scene_from_mesh(camera, [far, near], mesh)), alone)
    below = ref.Light(distance=400, elevation=-10, azimuth=180, k=1)
    camera = ref.Camera(width=40, height=30, pixel_um=100, elevation=20, azimuth=180)
    assert levels(scene_from_mesh(camera, [below], mesh)).max() > 1, "the side of the box, from under the table"
