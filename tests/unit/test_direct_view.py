"""A backlight that the camera sees, with the part before it; pictures of a rig file; stripes that are too fine."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ball_on_table import PART, world

from lightopt import build_scene, load_part, load_rig, render
from lightopt.config import copied_text, input_hashes
from lightopt.core.errors import InputError
from lightopt.images import write_png
from lightopt.preflight import check_scene

BACK = "{name: back, kind: backlight, size_mm: [50, 50], distance_mm: 30, direct_level: 180"
LCD = "{name: lcd, kind: display, size_mm: [300, 200], distance_mm: 300, elevation_deg: 60, azimuth_deg: 90"


def levels(folder: Path, *lights: str) -> tuple[np.ndarray, np.ndarray]:
    (images,) = render(build_scene(*world(folder, *lights)))
    return images.lights[0].level, images.geometry.hit


def test_a_part_is_a_silhouette_before_a_backlight(tmp_path):
    level, hit = levels(tmp_path, BACK + "}")
    # 50 mm at 580 mm from the camera, in pixels of 0.088 mm at an image distance of 55 mm
    side = 50.0 / 580.0 * 55.0 / 0.088
    # the ball's rim mirrors the backlight, too
    assert level.sum() / 180.0 == pytest.approx(side**2 - hit.sum(), rel=0.03)
    inside = np.hypot(*(np.indices(hit.shape) - np.array([29.5, 39.5])[:, None, None])) < 20.0
    assert not level[inside].any()
    np.testing.assert_allclose(level[3:6, 16:20], 180.0)
    assert level[2:, :12].max() == 0.0


def test_bars_of_a_backlight_are_where_the_pattern_has_them(tmp_path):
    bars = ", pattern: {kind: bars, period_mm: 20, shifts: 2, directions: [u]}}"
    first, hit = levels(tmp_path, BACK + bars)
    (images,) = render(build_scene(*world(tmp_path, BACK + bars)))
    second = images.lights[1].level
    np.testing.assert_allclose((first + second)[3:6, 16:64], 180.0)
    middle = hit.shape[1] // 2
    assert first[4, middle] == 180.0
    assert second[4, middle] == 0.0


def test_a_light_before_a_backlight_hides_it(tmp_path):
    bar = "{name: bar, kind: bar, size_mm: [10, 10], distance_mm: 275, elevation_deg: 90}"
    level, _ = levels(tmp_path, BACK + "}", bar)
    free, _ = levels(tmp_path, BACK + "}")
    assert (free - level).sum() == 0.0  # the part is behind it
    wide = bar.replace("[10, 10]", "[60, 60]")
    level, _ = levels(tmp_path, BACK + "}", wide)
    assert not level.any()


def test_a_backlight_of_gain_0_is_dark(tmp_path):
    level, _ = levels(tmp_path, BACK + ", gain: 0}")
    assert not level.any()


def test_a_backlight_seen_directly_is_alone_in_an_image_of_a_programme(tmp_path):
    """Or with channels of its own, whose levels add up."""
    bars = ", pattern: {kind: bars, period_mm: 20, shifts: 2, directions: [u]}}"
    world(tmp_path, BACK + bars, "{name: bar, kind: bar, size_mm: [9, 9], distance_mm: 200, elevation_deg: 30}")
    rig, text = tmp_path / "rig.yaml", (tmp_path / "rig.yaml").read_text()
    rig.write_text(text + "programme:\n  - {name: both, lights: {back-1: 0.5, back-2: 0.25}}\n")
    (images,) = render(build_scene(rig, tmp_path / "part.yaml"))
    level = images.lights[0].level
    np.testing.assert_allclose(level[4, [39, 40]], 90.0)
    np.testing.assert_allclose(level[4, 28:31], 45.0)
    plain = text.replace(bars, "}")
    rig.write_text(plain + "programme:\n  - {name: both, lights: {back: 0.5, bar: 1}}\n")
    with pytest.raises(InputError, match='"back" has a direct_level, and images show it without other lights'):
        load_rig(rig)


def test_pictures_are_read_from_beside_the_rig(tmp_path):
    for name, row in (("top", 0), ("bottom", 1)):
        levels_8 = np.zeros((2, 3), np.uint8)
        levels_8[row] = 255
        write_png(tmp_path / f"{name}.png", levels_8, metadata={})
    rig, part = world(tmp_path, LCD + ", pattern: {kind: bitmap, files: [top.png, bottom.png]}}")
    (images,) = render(build_scene(rig, part))
    (whole,) = render(build_scene(*world(tmp_path, LCD + "}")))
    total = whole.lights[0].level
    np.testing.assert_allclose(images.lights[0].level + images.lights[1].level, total, atol=1e-3 * total.max())
    # the upper half of the display is the nearer to straight above: it is mirrored nearer to the middle
    rows = np.arange(60)[:, None]
    upper, lower = (float((rows * one.level).sum() / one.level.sum()) for one in images.lights)
    assert upper > lower
    assert {"picture top.png", "picture bottom.png"} <= set(input_hashes(rig, part))
    (tmp_path / "copy").mkdir()
    assert copied_text(rig, tmp_path) == rig.source.text  # nothing moved, nothing changed
    assert "../top.png" in copied_text(rig, tmp_path / "copy")
    (tmp_path / "copy" / "rig.yaml").write_text(copied_text(rig, tmp_path / "copy"))
    assert load_rig(tmp_path / "copy" / "rig.yaml").lights[1].name == "lcd-2"


@pytest.mark.parametrize(("period", "level"), [(200, "ok"), (2, "warning")])
def test_stripes_finer_than_two_pixels_are_warned_of(period, level, tmp_path):
    rig, _ = world(tmp_path, LCD + f", pattern: {{period_mm: {period}}}}}")
    (tmp_path / "part.yaml").write_text(PART.replace("sigma_rad: 0.01", "sigma_rad: 0.0003"))
    found = [f for f in check_scene(rig, load_part(tmp_path / "part.yaml")).findings if f.topic == "stripes"]
    assert [f.level for f in found] == [level]
    assert (found[0].values["least_px"] < 2.0) == (level == "warning")


def test_the_period_in_the_image_is_that_of_a_mirror_ball(tmp_path):
    """On a ball of radius R the mirrored ray turns by 2/R per mm: du ≈ (2d/R) dx, here at the normal that mirrors."""
    rig, _ = world(tmp_path, LCD + ", pattern: {period_mm: 40, directions: [u]}}")
    (tmp_path / "part.yaml").write_text(PART.replace("sigma_rad: 0.01", "sigma_rad: 0.0003"))
    (found,) = [f for f in check_scene(rig, load_part(tmp_path / "part.yaml")).findings if f.topic == "stripes"]
    footprint = 0.088 * 540 / 55
    about = 40.0 / (2.0 * 290.0 / 20.0 * footprint)
    assert found.values["least_px"] == pytest.approx(about, rel=0.35)
