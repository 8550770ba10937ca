"""Deflectometry end to end: a known surface recovered through rendered 12-bit images with noise.

Rationale: phases, places, rays and normals each have their sign and frame; only the whole chain shows that they agree.
Expected: slopes within 5 % of the surface's own, phase noise within 10 % of √(2/N)·σ_I/B.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from lightopt.config import load_part, load_rig
from lightopt.geometry import box_mesh, sphere_mesh, stl_bytes
from lightopt.images import read_image_set
from lightopt.rendering import RenderOptions, cast_rays_at, render_image_set, trace_pixels
from lightopt.scene import build_scene
from lightopt.series._derived import derive_images, slope_map

RIG = """\
format: lightopt-rig/1
name: deflectometry
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [160, 120]
  pixel_size_um: 44
  image_distance_mm: 55
  sensor: {bit_depth: 12, read_noise_levels: 4}
lights:
  - name: lcd
    kind: display
    size_mm: [400, 300]
    distance_mm: 300
    elevation_deg: 60
    azimuth_deg: 270
    pattern: {period_mm: 25, second_period_mm: 450, phases: 4}
"""
PART = """\
format: lightopt-part/1
name: mirror
mesh: {{file: mirror.stl, units: mm, crease_angle_deg: 40}}
placement: {{anchor: rest_on_table, translate_mm: [0, 0, {low}]}}
postures: [{{elevation_deg: {tilt}, rotation_deg: 0}}]
reflectance: {{R_d: 2, R_s: {R_s}, sigma_rad: {sigma}}}
"""
DENT = "defects:\n  - {name: dent, kind: dent, at_mm: [2, 3, 0], size_mm: 16, slope_deg: 0.1}\n"
READ_NOISE = 4.0


def derived(folder, mesh, *, noise=1, sigma=0.005, **part):
    """Derived images of a part, and the good part's surface that its pixels see."""
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text(RIG, encoding="utf-8")
    (folder / "mirror.stl").write_bytes(stl_bytes(mesh))
    # as bright for any σ
    text = PART.format(sigma=sigma, R_s=5.0 / sigma**2, **{key: part[key] for key in ("tilt", "low")})
    (folder / "part.yaml").write_text(text + part.get("defects", ""), encoding="utf-8")
    rig, file = load_rig(folder / "rig.yaml"), load_part(folder / "part.yaml")
    done = render_image_set(rig, file, folder / f"set{noise}", options=RenderOptions(noise=noise, patch_budget=500))
    images = next(iter(derive_images(rig, file, read_image_set(done.folder))))
    assert images.saturated == 0
    scene = build_scene(rig, file, defects=False)
    pixels = trace_pixels(scene, scene.postures[0], cast_rays_at(scene))
    return images.channels, pixels, scene


def test_a_sphere_is_recovered(tmp_path):
    radius = 80.0
    channels, pixels, _ = derived(tmp_path, sphere_mesh(radius), tilt=0, low=-2.0 * radius)
    at, surface = (pixels.row, pixels.column), pixels.surface
    flat = np.broadcast_to([0.0, 0.0, 1.0], surface.normals.shape)
    places = channels["u.place_mm"][at], channels["v.place_mm"][at]
    view = pixels.view
    found = slope_map(surface.points, flat, *places, camera=view.camera.position, display=view.lights[0])
    # of the sphere itself, whose top is at the origin
    true = [np.degrees(np.arctan2(surface.points[:, i], surface.points[:, 2] + radius)) for i in (0, 1)]
    seen = pixels.clean & np.isfinite(found[0]) & (np.hypot(places[0] / 170, places[1] / 120) < 1)
    assert seen.sum() > 1500
    for mine, own in zip(found, true, strict=True):
        assert np.ptp(own[seen]) > 8.0
        assert np.abs(mine - own)[seen].max() <= 0.05 * np.abs(own[seen]).max()
        assert np.sqrt(np.mean((mine - own)[seen] ** 2)) < 0.02
    # against its own model there is nothing
    assert abs(np.median(channels["slope.x_deg"][at][seen])) < 1e-3


@pytest.mark.parametrize(
    "sigma", [pytest.param(0.003, marks=pytest.mark.nightly), pytest.param(0.005, marks=pytest.mark.nightly), 0.01]
)
def test_a_dent_of_a_tenth_of_a_degree_is_recovered(tmp_path, sigma):
    plate = box_mesh(np.array([[-25.0, -25.0, -5.0], [25.0, 25.0, 0.0]]))
    channels, pixels, _ = derived(tmp_path, plate, sigma=sigma, tilt=15, low=-5, defects=DENT)
    at = pixels.row, pixels.column
    x, y = (pixels.surface.points[:, i] - c for i, c in ((0, 2.0), (1, 3.0)))
    rho = np.hypot(x, y) / 8.0
    # a cosine bowl of 16 mm; the normal leans to its middle
    slope = np.where(rho < 1.0, 0.1 * np.sin(math.pi * rho), 0.0) / np.maximum(8.0 * rho, 1e-9)
    inside = pixels.clean & (rho < 1.0)
    assert inside.sum() > 900
    for name, own in (("slope.x_deg", -slope * x), ("slope.y_deg", -slope * y)):
        found = channels[name][at]
        assert np.sqrt(np.mean((found - own)[inside] ** 2)) < 0.05 * 0.1
        gain = np.sum((found * own)[inside]) / np.sum(own[inside] ** 2)
        assert gain == pytest.approx(1.0, abs=0.05)
        # the noise is what the phase's says
        outside = pixels.clean & (rho > 1.2) & np.isfinite(found)
        noise = channels[f"{'uv'['xy'.index(name[6])]}.phase_noise"][at][outside]
        slope_noise = math.degrees(np.sqrt(np.mean(noise**2)) * 25.0 / (4.0 * math.pi * 300.0))  # σ_φ·P/(4πd)
        assert np.std(found[outside]) == pytest.approx(slope_noise, rel=0.1)


def test_phase_noise_is_as_predicted(tmp_path):
    plate = box_mesh(np.array([[-25.0, -25.0, -5.0], [25.0, 25.0, 0.0]]))
    sets = [derived(tmp_path, plate, noise=seed, tilt=15, low=-5) for seed in (1, 2)]
    (first, pixels, scene), (second, _, _) = sets
    at = pixels.row[pixels.clean], pixels.column[pixels.clean]
    for direction in "uv":
        step = np.angle(np.exp(1j * (first[f"{direction}.phase"] - second[f"{direction}.phase"])))[at]
        level = scene.sensor.max_level / scene.reflectance.full_scale  # sensor levels of a grey level
        amplitude = level * (first[f"{direction}.modulation"] * first[f"{direction}.mean"])[at]
        predicted = math.sqrt(2.0 / 4.0) * math.sqrt(READ_NOISE**2 + 1.0 / 12.0) / amplitude
        np.testing.assert_allclose(first[f"{direction}.phase_noise"][at], predicted, rtol=1e-6)
        assert np.std(step) == pytest.approx(math.sqrt(2.0 * np.mean(predicted**2)), rel=0.1)
