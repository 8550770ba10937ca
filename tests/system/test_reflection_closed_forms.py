"""Equations (1)–(4) on planes and spheres, against formulas evaluated by hand at the pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
import reference as ref
from worlds import PAPER, PARTS, levels, plane, scene_from_files, scene_from_mesh, sphere

from lightopt import render

CAMERA = ref.Camera(width=24, height=18, pixel_um=200)
MATTE = {"R_d": 100.0, "R_s": 0.0, "sigma": 0.05}


def tilted_level(camera, light, normal, *, R_d, R_s, sigma):
    """Levels (H, W) of an endless plane through the origin under one point light, by hand; also N·L and N·V."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    # plan view at `distance`: pixel (column, row) looks along (x, y, -1) in units of the image distance
    scale = camera.pixel_um * 1e-3 / camera.image_distance
    rays = np.stack(
        [(columns + 0.5 - camera.width / 2) * scale, -(rows + 0.5 - camera.height / 2) * scale, -np.ones(rows.shape)],
        axis=2,
    )
    eye = np.array([0, 0, camera.distance])
    points = eye - rays * ((eye @ normal) / (rays @ normal))[..., None]
    e, a = math.radians(light.elevation), math.radians(light.azimuth)
    source = light.distance * np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    L = source - points
    r = np.linalg.norm(L, axis=2)
    L = L / r[..., None]
    V = eye - points
    V = V / np.linalg.norm(V, axis=2)[..., None]
    H = L + V
    H = H / np.linalg.norm(H, axis=2)[..., None]
    n_l, n_v = L @ normal, V @ normal
    delta = 2 * np.arcsin(np.linalg.norm(H - normal, axis=2) / 2)
    level = R_d * np.maximum(0, n_l)
    level = level + np.where(n_l > 0, R_s / n_v * np.exp(-(delta**2) / (2 * sigma**2)), 0)
    return level, n_l, r


def normal_of(tilt, azimuth):
    """Of the plane through the origin that `worlds.plane` makes: turned by `tilt` about the axis at `azimuth`."""
    t, a = math.radians(tilt), math.radians(azimuth)
    return np.array([math.sin(t) * math.sin(a), -math.sin(t) * math.cos(a), math.cos(t)])


@pytest.mark.parametrize("tilt", [0, 10, 30, 45, 60, 75, 85])
@pytest.mark.parametrize("azimuth", [0, 70, 135, 200, 315])
def test_tilted_planes(tilt, azimuth):
    light = ref.Light(elevation=55, azimuth=30, k=1)
    normal = normal_of(tilt, azimuth)
    expected, _, _ = tilted_level(CAMERA, light, normal, **PAPER)
    mesh = plane(2000, tilt=tilt, azimuth=azimuth)
    image = levels(scene_from_mesh(CAMERA, [light], mesh))
    # R_s is 12500, so that 1e-4 of the level asks 1e-4·σ²/δ of the angle
    np.testing.assert_allclose(image, expected, rtol=1e-6, atol=1e-6)


def test_a_plane_that_mirrors_the_light_into_the_camera_is_at_its_brightest():
    """Halfway between camera (90°) and light (50°) the normal stands at 70°: δ = 0, and I_s = R_s / cosθ_o."""
    camera = ref.Camera(width=1, height=1, pixel_um=10)
    light = ref.Light(distance=1e7, elevation=50, azimuth=90, k=1)
    mesh = plane(100, tilt=-20, azimuth=0)
    image = levels(scene_from_mesh(camera, [light], mesh, reflectance={"R_d": 0.0, "R_s": 500.0, "sigma": 0.003}))
    assert image[0, 0] == pytest.approx(500 / math.cos(math.radians(20)), rel=1e-6)


def test_a_lobe_of_half_its_peak():
    """At δ = σ·√(2 ln 2) the lobe is at half: a flat plane, light tilted by 2δ from the zenith, far away."""
    sigma = 0.0475
    delta = sigma * math.sqrt(2 * math.log(2))
    camera = ref.Camera(width=1, height=1, pixel_um=1, distance=1000)
    light = ref.Light(distance=1e8, elevation=90 - math.degrees(2 * delta), azimuth=0, k=1)
    image = levels(scene_from_mesh(camera, [light], plane(10), reflectance={"R_d": 0.0, "R_s": 800.0, "sigma": sigma}))
    assert image[0, 0] == pytest.approx(400, rel=1e-5)


def test_grazing_view_is_clamped():
    """cosθ_o is never less than 0.01: a plane seen at 89.9° is R_s / 0.01 and not R_s / 0.0017."""
    camera = ref.Camera(width=1, height=1, pixel_um=1)
    # light and camera from the same place, so that δ = θ_o; a lobe so wide that its fall-off is a number to compute
    light = ref.Light(distance=550, elevation=90, azimuth=270, k=1)
    image = levels(
        scene_from_mesh(camera, [light], plane(100, tilt=89.9), reflectance={"R_d": 0.0, "R_s": 1.0, "sigma": 0.2}),
        shadows=False,
    )
    theta = math.radians(89.9)
    assert image[0, 0] == pytest.approx(math.exp(-(theta**2) / (2 * 0.04)) / 0.01, rel=1e-4)


def test_light_below_the_horizon_gives_nothing():
    steep = plane(200, tilt=70, azimuth=0)  # leans to -Y
    behind = ref.Light(elevation=20, azimuth=90, k=2)
    wide = {"R_d": 45.0, "R_s": 12500.0, "sigma": 1.5}
    scene = scene_from_mesh(CAMERA, [behind], steep, reflectance=wide)
    assert not levels(scene).any()
    assert not levels(scene, shadows=False).any()


def test_inverse_square_falloff():
    """(distance of the panel's centre / r)²: 1 at the origin, and by the formula everywhere else."""
    flat = np.array([0.0, 0, 1])
    light = ref.Light(distance=120, elevation=40, azimuth=20, k=1, falloff="inverse_square")
    expected, _, r = tilted_level(CAMERA, light, flat, **PAPER)
    image = levels(scene_from_mesh(CAMERA, [light], plane(2000)))
    np.testing.assert_allclose(image, expected * (120 / r) ** 2, rtol=1e-6)
    assert image.max() / image.min() > 1.5, "the falloff must be seen to matter"


@pytest.mark.parametrize("exponent", [1.0, 2.5])
def test_emission_follows_the_cosine_to_the_panels_axis(exponent):
    flat = np.array([0.0, 0, 1])
    light = ref.Light(distance=60, elevation=40, azimuth=20, k=1, emission=exponent)
    expected, _, r = tilted_level(CAMERA, light, flat, **MATTE)
    # N·L = height / r, and the angle to the axis by the law of cosines in the triangle origin, panel, point
    rows, columns = np.mgrid[0:18, 0:24]
    mm = 0.2 * 10
    x, y = (columns + 0.5 - 12) * mm, (rows + 0.5 - 9) * mm
    cosine = (60**2 + r**2 - (x**2 + y**2)) / (2 * 60 * r)
    image = levels(scene_from_mesh(CAMERA, [light], plane(2000), reflectance=MATTE))
    np.testing.assert_allclose(image, expected * np.maximum(0, cosine) ** exponent, rtol=1e-5)
    assert (cosine**exponent).min() < 0.97


def test_gain_scales_and_normalisation_divides_by_m():
    mesh = sphere(20, rows=24)
    base = levels(scene_from_mesh(CAMERA, [ref.Light(k=3)], mesh))
    gained = levels(scene_from_mesh(CAMERA, [ref.Light(k=3, gain=2.5)], mesh))
    summed = levels(scene_from_mesh(CAMERA, [ref.Light(k=3, normalisation="sum")], mesh))
    assert base.max() > 100
    np.testing.assert_allclose(gained, 2.5 * base, rtol=1e-6)
    np.testing.assert_allclose(summed, 9 * base, rtol=1e-6)


@pytest.mark.parametrize("k", [2, 3, 4])
def test_m_points_are_the_mean_of_m_renders_of_one(tmp_path, k):
    """A panel of k² points equals k² tiny one-point panels at its cell centres, shadows and all."""
    camera = ref.Camera(width=100, height=80, pixel_um=60)
    panel = ref.Light(distance=330, elevation=40, azimuth=200, size=(80, 50), k=k)
    together = levels(scene_from_files(tmp_path, camera, [panel], PARTS / "spout.stl"))
    singles = []
    for p in panel.points()[0]:
        # a point at p is the centre of a panel at p's own distance, elevation and azimuth
        distance = np.linalg.norm(p)
        singles.append(
            ref.Light(
                distance=distance,
                elevation=math.degrees(math.asin(p[2] / distance)),
                azimuth=math.degrees(math.atan2(p[1], p[0])) % 360,
                size=(1, 1),
                k=1,
            )
        )
    scene = scene_from_files(tmp_path, camera, singles, PARTS / "spout.stl")
    images = [x.level.astype(float) for x in next(iter(render(scene, threads=2))).lights]
    mean = np.mean(images, axis=0)
    assert np.count_nonzero(np.ptp(images, axis=0) > 5) > 100, "the points must see different things"
    # a shadow ray that grazes an edge may go either way when the point moves by a rounding error
    off = np.abs(together - mean) > 1e-5 * np.maximum(mean, 1)
    assert np.count_nonzero(off) <= 1e-3 * np.count_nonzero(mean)


# --- the highlight on a sphere


def sphere_highlight(radius, light, camera, *, R_s, sigma):
    """Mirror point (column, row) of a sphere at the origin, and the levels of the pixels around it, without a renderer.

    The camera looks down the Z axis. The sphere's own equation gives point and normal at every pixel's centre.
    Returns the mirror point, the rows and columns of the pixels that see the sphere there, and their levels.
    """
    source, eye = light.points()[0][0], np.array([0, 0, camera.distance])
    # where the normal is the bisector: a fixed point, since light and camera are far away
    N = np.array([0, 0, 1.0])
    for _ in range(200):
        L, V = source - radius * N, eye - radius * N
        N = L / np.linalg.norm(L) + V / np.linalg.norm(V)
        N /= np.linalg.norm(N)
    p = radius * N
    spot = p[:2] / (camera.distance - p[2]) * camera.focal_px
    mirror = np.array([camera.width / 2 + spot[0], camera.height / 2 - spot[1]])
    reach = 90
    columns, rows = (
        c.ravel() for c in np.meshgrid(*[np.arange(int(middle) - reach, int(middle) + reach) for middle in mirror])
    )
    x = (columns + 0.5 - camera.width / 2) / camera.focal_px
    y = -(rows + 0.5 - camera.height / 2) / camera.focal_px
    rays = np.stack([x, y, -np.ones(x.shape)], axis=1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = rays @ eye
    inside = along**2 - eye @ eye + radius**2
    met = inside > 0
    rays, along, inside, rows, columns = (a[met] for a in (rays, along, inside, rows, columns))
    points = eye + (-along - np.sqrt(inside))[:, None] * rays
    L, V = source - points, eye - points
    L, V = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (L, V))
    H = L + V
    H /= np.linalg.norm(H, axis=1, keepdims=True)
    delta = 2 * np.arcsin(np.linalg.norm(H - points / radius, axis=1) / 2)
    cosine = np.einsum("ij,ij->i", points / radius, V)
    level = R_s / np.maximum(cosine, 0.01) * np.exp(-(delta**2) / (2 * sigma**2))
    return mirror, rows, columns, level


@pytest.mark.parametrize(("elevation", "azimuth"), [(75, 20), (60, 130), (40, 290)])
@pytest.mark.parametrize(("sigma", "pixel_um"), [(0.0475, 12), (0.01, 6)])
def test_highlight_of_a_sphere(elevation, azimuth, sigma, pixel_um):
    """A highlight is where the normal bisects light and view, and saturates the area that the formulas say."""
    radius, R_s = 22.0, 12500.0
    size = int(4800 / pixel_um)
    camera = ref.Camera(width=size, height=size, pixel_um=pixel_um)
    light = ref.Light(elevation=elevation, azimuth=azimuth, k=1)
    mesh = sphere(radius, rows=160)
    shine = {"R_d": 0.0, "R_s": R_s, "sigma": sigma}
    mirror, rows, columns, level = sphere_highlight(radius, light, camera, R_s=R_s, sigma=sigma)
    image = levels(scene_from_mesh(camera, [light], mesh, reflectance=shine))
    top = np.argwhere(image >= 0.9 * image.max()).mean(axis=0) + 0.5
    np.testing.assert_allclose(top[::-1], mirror, atol=1.0)
    expected = np.zeros(image.shape, dtype=bool)
    expected[rows, columns] = level >= 255
    found, area = image >= 255, np.count_nonzero(expected)
    assert area > 250
    assert abs(np.count_nonzero(found) - area) <= 0.01 * area
    assert np.count_nonzero(found & expected) >= 0.98 * np.count_nonzero(found | expected)
