"""The inverse pattern: its response matrix, its picture and its command against the renderer.

Rationale: the matrix is made from light near the mirrored place and by blocks; the renderer knows neither.
Expected: a single pixel of the display as the renderer has it, and a flat reflection through an asymmetric picture,
which a picture that is turned or mirrored would not give.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lightopt.config import load_part, load_rig
from lightopt.geometry import sphere_mesh, stl_bytes
from lightopt.images import read_metadata, read_png
from lightopt.lights import picture_light
from lightopt.rendering import cast_rays_at, render_posture
from lightopt.scene import build_scene
from lightopt.series import _inverse_pattern as inverse, display_of, inverse_pattern, tilt_residuals

RIG = """\
format: lightopt-rig/1
name: inverse
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [80, 60]
  pixel_size_um: 44
  image_distance_mm: 55
  sensor: {bit_depth: 12, read_noise_levels: 4}
lights:
  - {name: lamp, kind: bar, size_mm: [100, 20], distance_mm: 300, elevation_deg: 30}
  - {name: lcd, kind: display, size_mm: [400, 300], distance_mm: 300, elevation_deg: 60, pattern: {period_mm: 40}}
"""
PART = """\
format: lightopt-part/1
name: mirror
mesh: {file: mirror.stl, units: mm, crease_angle_deg: 40}
placement: {anchor: rest_on_table, translate_mm: [0, 0, -160]}
postures: [{elevation_deg: 3, rotation_deg: 20}]
reflectance: {R_d: 10, R_s: 200000, sigma_rad: 0.005}
defects:
  - {name: dent, kind: dent, at_mm: [-6, -16.4, 78.1], size_mm: 5, slope_deg: 0.3}
  - {name: stain, kind: stain, at_mm: [-6, -16.4, 78.1], size_mm: 5, R_d_factor: 0.5}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("inverse")
    (path / "rig.yaml").write_text(RIG, encoding="utf-8")
    (path / "part.yaml").write_text(PART, encoding="utf-8")
    (path / "mirror.stl").write_bytes(stl_bytes(sphere_mesh(80.0)))
    return path


@pytest.fixture(scope="module")
def found(folder):
    rig = load_rig(folder / "rig.yaml")
    scene = build_scene(rig, load_part(folder / "part.yaml"))
    display = display_of(rig, scene, "lcd")
    return scene, display, inverse_pattern(scene, display, pixels=(32, 24), period_px=16.0)


def rendered(scene, light):
    scene = replace(scene, lights=(light,), defects=())
    return render_posture(scene, scene.postures[0], caster=cast_rays_at(scene)).lights[0].level


def test_the_response_is_the_renderers(found):
    scene, display, _ = found
    scene = replace(scene, defects=())
    seen = inverse._seen(scene)
    own = inverse._in_part_frame(seen, scene, display)
    response = inverse._responses(seen.surface, own, (6, 8), scene).toarray()
    diffuse, blocks = inverse._diffuse_responses(seen.surface, own, (6, 8), scene)
    for i, j in zip(*np.unravel_index(np.argsort(response.sum(axis=0))[-9::4], (6, 8)), strict=True):
        one = np.zeros((6, 8))
        one[i, j] = 1.0
        wanted = rendered(scene, picture_light(display, one))[seen.row, seen.column]
        mine = response @ one.ravel() + diffuse @ (blocks @ one.ravel())
        assert wanted.max() > 40
        np.testing.assert_allclose(mine, wanted, atol=0.02 + 1e-3 * wanted.max())


def test_the_reflection_is_the_target(found):
    scene, display, pattern = found
    assert len(pattern.row) > 400
    assert pattern.picture.min() >= 0.0
    assert pattern.picture.max() <= 1.0
    level = rendered(scene, picture_light(display, pattern.picture))[pattern.row, pattern.column]
    off = (level - pattern.target) / pattern.target.mean()
    assert math.sqrt(np.mean(off**2)) == pytest.approx(pattern.residual, rel=0.05)
    assert pattern.residual < 0.03
    # turned or mirrored it does not fit
    for turned in (pattern.picture[::-1], pattern.picture[:, ::-1]):
        level = rendered(scene, picture_light(display, turned))[pattern.row, pattern.column]
        assert np.std(level / pattern.target) > 2.0 * pattern.residual


def test_a_tilt_shows(found):
    scene, _, pattern = found
    small, large = tilt_residuals(scene, pattern, [math.radians(0.03), math.radians(0.3)])
    assert pattern.residual < small < 0.5 * large


def test_the_command(cli, folder):
    out = folder / "picture.png"
    command = ("inverse-pattern", folder / "rig.yaml", folder / "part.yaml", "--light", "lcd", "-o", out)
    ran = cli(*command, "--pixels", "16x12")
    assert ran.status == 0, ran.err
    assert read_png(out).shape == (12, 16)
    assert read_metadata(out)["light"] == "lcd"
    assert "0.1°" in ran.out
    assert "dent" in ran.out
    assert "stain" not in ran.out
    for options, message in (
        (("--pixels", "16"), "expected columns and rows such as 64x48"),
        (("--pixels", "16x12", "--light", "lamp"), 'no display "lamp" in'),
        (("--period-px", "1"), "expected 0, or at least 2 pixels"),
        (("--posture", "60,0", "--pixels", "4x4"), "pixels of the part reflect the display"),
    ):
        ran = cli(*command, *options, "--force")
        assert ran.status == 2
        assert message in ran.err
