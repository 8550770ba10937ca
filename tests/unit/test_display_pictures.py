"""Pictures of displays: the pattern's means, its directions as the renderer has them, and a screen's levels."""

from __future__ import annotations

import math
import zlib
from pathlib import Path

import numpy as np
import pytest

from lightopt.config import LightConfig, PictureConfig
from lightopt.config._light import expanded
from lightopt.images import write_png
from lightopt.lights import SurfaceLight, picture_light, place_light, plane_elements, surface_light
from lightopt.optics import Reflectance
from lightopt.rendering import SurfacePoints, light_of_channels
from lightopt.rig.devices._light_display import screen_levels
from lightopt.rig.simulated._firmware import SeenPicture
from lightopt.rig.simulated._light_screen import ScreenFirmware
from lightopt.rig.simulated._optics import as_channels
from lightopt.scene import display_picture
from lightopt.scene._lights import _pattern

SIZE = (160.0, 120.0)


def channels(**pattern: object) -> tuple[LightConfig, ...]:
    light = {"name": "lcd", "kind": "display", "size_mm": list(SIZE), "distance_mm": 300.0, "elevation_deg": 60.0}
    return expanded([LightConfig.model_validate(light | ({"pattern": pattern} if pattern else {}))])


PATTERNS = {
    "sine": {"period_mm": 47.0, "phases": 3},
    "two periods": {"period_mm": 20.0, "second_period_mm": 22.0},
    "bars": {"kind": "bars", "period_mm": 50.0, "shifts": 5, "duty": 0.3},
}


def on_a_fine_grid(light: LightConfig, count: int) -> np.ndarray:
    """Pattern in the middle of count × count places per mm, from its definition."""
    u, v = (0.5 * side - (np.arange(int(side * count)) + 0.5) / count for side in SIZE)
    picture = np.zeros((len(v), len(u)))
    for coefficient, axis, wave, phase, duty in _pattern(Path(), light).terms:
        at = (wave * (v[:, None] if axis else u[None, :])) + phase
        inside = np.abs(np.remainder(at + math.pi, 2.0 * math.pi) - math.pi) <= duty * math.pi
        picture = picture + coefficient * (inside if duty else np.cos(at))
    return picture


@pytest.mark.parametrize("pattern", PATTERNS.values(), ids=PATTERNS)
@pytest.mark.parametrize("pixels", [(16, 12), (10, 4)])
def test_pixels_have_the_mean_of_the_pattern(pattern, pixels):
    for light in channels(**pattern):
        picture = display_picture(light, pixels)
        fine = on_a_fine_grid(light, 10)
        assert picture.shape == pixels[::-1]
        assert picture.mean() == pytest.approx(fine.mean(), abs=2e-3)
        blocks = fine.reshape(pixels[1], -1, pixels[0], fine.shape[1] // pixels[0]).mean(axis=(1, 3))
        np.testing.assert_allclose(picture, blocks, atol=6e-3)
        assert picture.min() > -1e-12
        assert picture.max() < 1.0 + 1e-12


def test_stripes_move_to_the_left_and_upwards():
    """Step k of a sine is brightest at u = k/N of a period, and u points left, v up."""
    names = {light.name: display_picture(light, (160, 120)) for light in channels(period_mm=80.0, phases=4)}
    for step in range(4):
        # 1 mm per pixel, its middle at u = 0 left of column 80
        place = (20 * step + 39) % 80 - 39
        assert {int(names[f"lcd-{step + 1}"][0].argmax() - (80 - place)) % 80} <= {79, 0}
        assert {int(names[f"lcd-{step + 5}"][:, 0].argmax() - (60 - place)) % 80} <= {79, 0}


def test_a_picture_of_the_rig_is_shown_by_areas(tmp_path):
    """Of 4 × 2 pixels on 6 × 3: whole pixels, and means where two share one."""
    levels = np.arange(8, dtype=np.uint8).reshape(2, 4) * 30
    write_png(tmp_path / "a.png", levels, metadata={})
    (light,) = channels(kind="bitmap", files=[str(tmp_path / "a.png")])
    np.testing.assert_allclose(display_picture(light, (4, 2)), levels / 255.0, atol=1e-7)
    wide = np.repeat(np.repeat(levels / 255.0, 3, axis=0), 3, axis=1)
    expected = wide.reshape(3, 2, 6, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(display_picture(light, (6, 3)), expected, atol=1e-7)
    np.testing.assert_allclose(display_picture(light, (2, 1), folder=tmp_path).mean(), levels.mean() / 255.0, atol=1e-7)


def test_a_display_without_pattern_is_white():
    (light,) = channels()
    assert (display_picture(light, (4, 3)) == 1.0).all()


@pytest.mark.parametrize("channel", [1, 6])
def test_the_picture_shines_as_the_renderer_has_the_channel(channel):
    light = channels(period_mm=100.0)[channel]
    place = {"distance": 300.0, "elevation": math.radians(60.0), "azimuth": math.radians(20.0)}
    panel = place_light(**place, name="lcd", size=SIZE, points="auto", gain=1.0)
    elements = plane_elements(SIZE, (4, 4))
    own = surface_light(panel, kind="display", entry=0, elements=elements, pattern=_pattern(Path(), light))
    assert isinstance(own, SurfaceLight)
    shown = picture_light(own, display_picture(light, (40, 30)))
    rng = np.random.default_rng(1)
    points = rng.uniform(-30.0, 30.0, (20, 3)) * (1.0, 1.0, 0.1)
    normals = np.tile([0.0, 0.0, 1.0], (20, 1)) + rng.normal(0.0, 0.1, (20, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    views = np.tile([0.0, 0.0, 1.0], (20, 1))
    surface = SurfacePoints(points=points, normals=normals, facets=normals, views=views, front=np.ones(20, np.bool_))
    for one, other in zip(
        *(light_of_channels(surface, [which], Reflectance(R_d=45.0, R_s=1e3, sigma=0.05)) for which in (own, shown)),
        strict=True,
    ):
        np.testing.assert_allclose(other, one, rtol=0.01, atol=1e-3 * one.max())


MOUNTS = [(turn, mirrored) for turn in (0, 90, 180, 270) for mirrored in (False, True)]


@pytest.mark.parametrize(("turn", "mirrored"), MOUNTS)
def test_a_screen_shows_to_the_part_what_was_meant(turn, mirrored):
    size = (8, 6) if turn % 180 == 0 else (6, 8)
    settings = PictureConfig(resolution_px=size, gamma=1.8, turn_deg=turn, mirrored=mirrored)
    picture = np.random.default_rng(2).uniform(0.0, 1.0, (6, 8))
    levels = screen_levels(picture, settings)
    assert levels.shape == size[::-1]
    screen = ScreenFirmware(resolution_px=size, gamma=1.8, turn_deg=turn, mirrored=mirrored)
    data = zlib.compress(levels.tobytes())
    assert screen.feed(b"SHOW %d %d %d\r\n" % (*size, len(data)) + data, 0.0) == b"OK\r\n"
    assert screen.feed(b"SHOW %d %d 3\r\nabc" % size, 0.0) == b"NG the picture is damaged\r\n"
    seen = screen.picture()
    assert (np.abs(seen.radiance - picture) <= seen.rounding).all()


def test_where_the_upper_edge_goes():
    picture = np.zeros((2, 3))
    picture[0, 2] = 1.0  # top right as seen from the part
    levels = {
        (turn, mirrored): np.argwhere(
            screen_levels(picture, PictureConfig(resolution_px=(3, 2), gamma=1.0, turn_deg=turn, mirrored=mirrored))
        )[0].tolist()
        for turn, mirrored in MOUNTS
    }
    assert levels[0, False] == [0, 2]
    assert levels[0, True] == [0, 0]
    # the screen's upper edge is on the right: what is at the top is on its left
    assert levels[90, False] == [0, 0]
    assert levels[180, False] == [1, 0]
    assert levels[270, False] == [2, 1]


def test_levels_undo_the_response_of_the_screen():
    shares = np.array([[0.0, 0.5**2.2, 1.0]])
    assert screen_levels(shares, PictureConfig(resolution_px=(3, 1), gamma=2.2)).tolist() == [[0, 128, 255]]
    assert screen_levels(shares, PictureConfig(resolution_px=(3, 1), gamma=1.0)).tolist() == [[0, 55, 255]]


def test_sums_of_channels_are_found_in_a_picture_and_nothing_else():
    lights = channels(period_mm=47.0)
    pictures = [display_picture(light, (160, 120)) for light in lights]
    rounding = np.full((120, 160), 1e-3)
    for shares in ({0: 1.0}, {2: 0.25}, {1: 0.5, 6: 0.25}, {}):
        total = sum((share * pictures[k] for k, share in shares.items()), np.zeros((120, 160)))
        found = as_channels(SeenPicture(1, total, rounding), lights)
        assert found == pytest.approx({lights[k].name: share for k, share in shares.items()}, abs=1e-6)
    # turned upside down, step 1 of 4 is step 3
    assert as_channels(SeenPicture(1, pictures[1][::-1, ::-1], rounding), lights) == pytest.approx({"lcd-4": 1.0})
    assert as_channels(SeenPicture(1, pictures[1] ** 1.2, rounding), lights) is None
