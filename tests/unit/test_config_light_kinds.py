"""Kinds of lights in a rig file: their channels, and what is told about wrong keys and impossible shapes."""

from __future__ import annotations

from pathlib import Path

import pytest

from lightopt.config import load_rig
from lightopt.core.errors import InputError

HEAD = """\
format: lightopt-rig/1
name: kinds
camera: {distance_mm: 550, elevation_deg: 90, resolution_px: [32, 24], pixel_size_um: 220, image_distance_mm: 55, \
sensor: {bit_depth: 8}}
lights:
  - {name: first, kind: bar, size_mm: [20, 5], distance_mm: 100}
"""
SHORT = {"DISPLAY": "kind: display, size_mm: [9, 9], distance_mm: 9", "LEDS": "kind: led_array, size_mm: [9, 9]"}
LINE = HEAD.count("\n") + 1


def load(folder: Path, light: str):
    for short, words in SHORT.items():
        light = light.replace(short, words)
    path = folder / "rig.yaml"
    path.write_text(f"{HEAD}  - {{name: x, {light}}}\n", encoding="utf-8")
    return load_rig(path)


@pytest.mark.parametrize(
    ("light", "names"),
    [
        ("kind: dome, radius_mm: 100, segments: 3", ["x-1", "x-2", "x-3"]),
        ("kind: dome, radius_mm: 100", ["x"]),
        ("kind: low_angle_ring, radius_mm: 90, height_mm: 9, segments: 2", ["x-1", "x-2"]),
        ("LEDS, rows: 2, columns: 2, led_mm: 4, distance_mm: 9", [f"x-{i}" for i in range(1, 5)]),
        ("DISPLAY, pattern: {period_mm: 4, phases: 3}", [f"x-{i}" for i in range(1, 7)]),
        ("DISPLAY, pattern: {kind: bars, period_mm: 4, shifts: 2, directions: [v]}", ["x-1", "x-2"]),
    ],
)
def test_channels_are_lights(light: str, names: list[str], tmp_path: Path) -> None:
    if not any(word in light for word in ("distance", "dome", "DISPLAY")):
        light += ", distance_mm: 0"
    lights = load(tmp_path, light).lights[1:]
    assert [one.name for one in lights] == names
    assert [one.channel for one in lights] == list(range(len(names)))
    assert {one.entry for one in lights} == {1}


@pytest.mark.parametrize(
    ("light", "key", "message"),
    [
        ("kind: bar, distance_mm: 9", "", 'missing key "size_mm": Size along azimuth'),
        ("kind: ring, outer_radius_mm: 9, distance_mm: 9", "", 'missing key "inner_radius_mm"'),
        ("kind: low_angle_ring, radius_mm: 9, distance_mm: 9", "", 'missing key "height_mm"'),
        ("kind: dome", "", 'missing key "radius_mm"'),
        ("kind: tunnel, radius_mm: 9, distance_mm: 9", "", 'missing key "length_mm"'),
        ("kind: spot, distance_mm: 9", "", 'missing key "half_angle_deg"'),
        ("LEDS, rows: 2, columns: 2, distance_mm: 9", "", 'missing key "led_mm"'),
        ("kind: bar, size_mm: [9, 9]", "", 'missing key "distance_mm"'),
        ("kind: bar, size_mm: [9, 9], distance_mm: 9, points: 4", "points", "kind bar has no such key"),
        ("kind: dome, radius_mm: 9, falloff: none", "falloff", "kind dome has no such key"),
        ("kind: spot, half_angle_deg: 3, distance_mm: 9, pose: {}", "pose", "kind spot has no such key"),
        ("kind: lamp, distance_mm: 9", "kind", 'or backlight, found "lamp"'),
        ("kind: lamp", "kind", 'or backlight, found "lamp"'),
        (
            "distance_mm: 9, elevation_deg: 9, azimuth_deg: 9, segments: 2",
            "segments",
            "kind panel has no such key; it belongs to ring, low_angle_ring, dome",
        ),
        (
            "distance_mm: 0, elevation_deg: 9, azimuth_deg: 9",
            "distance_mm",
            "a light of kind panel cannot stand at the origin",
        ),
        ("LEDS, rows: 20, columns: 20, led_mm: 1, distance_mm: 9", "rows", "at most 256 LEDs"),
        ("LEDS, rows: 1, columns: 3, led_mm: 4, distance_mm: 9", "led_mm", "the LEDs overlap"),
        (
            "kind: ring, inner_radius_mm: 9, outer_radius_mm: 9, distance_mm: 9",
            "inner_radius_mm",
            "less than outer_radius_mm",
        ),
        (
            "kind: ring, inner_radius_mm: 4, outer_radius_mm: 9, distance_mm: 0",
            "distance_mm",
            "kind ring cannot stand at the origin",
        ),
        ("kind: spot, half_angle_deg: 3, distance_mm: 0", "distance_mm", "kind spot cannot stand at the origin"),
        ("kind: spot, half_angle_deg: 60, distance_mm: 9", "half_angle_deg", "found 60"),
        ("kind: dome, radius_mm: 50, camera_hole_mm: 50", "camera_hole_mm", "expected less than 50"),
        (
            "kind: dome, radius_mm: 50, camera_hole_mm: 45, lower_elevation_deg: 70",
            "lower_elevation_deg",
            "expected less than 63.26",
        ),
        (
            "kind: flat_dome, size_mm: [50, 40], camera_hole_mm: 40, distance_mm: 9",
            "camera_hole_mm",
            "expected less than 40",
        ),
        (
            "kind: tunnel, radius_mm: 50, length_mm: 9, slot_mm: 100, distance_mm: 9",
            "slot_mm",
            "less than the tunnel's diameter",
        ),
        ("kind: dome, radius_mm: 0", "radius_mm", "a length between 0.001"),
        ("kind: tunnel, radius_mm: -1, length_mm: 9, distance_mm: 9", "radius_mm", "found -1"),
        ("kind: led_array, size_mm: [-9, 9], distance_mm: 9, rows: 2, columns: 2", "size_mm", "two lengths"),
        ("kind: led_array, size_mm: [9, 9], distance_mm: 9, led_mm: 1, columns: 999", "columns", "256 LEDs"),
        ("kind: dome, radius_mm: 50, leak: 1.5", "leak", "expected a number from 0 to 1, found 1.5"),
        ("kind: dome, radius_mm: 50, segments: 0", "segments", "expected a whole number from 1 to 256, found 0"),
        (
            "kind: coaxial, size_mm: [9, 9], distance_mm: 9, reflection: -1",
            "reflection",
            "expected a number from 0 to 1, found -1",
        ),
        ("DISPLAY, pattern: {period_mm: 4, phases: 2}", "pattern.phases", "fewer give no phase, found 2"),
        ("DISPLAY, pattern: {kind: bars, period_mm: 4, phases: 4}", "pattern.phases", "kind bars has no such key"),
        ("DISPLAY, pattern: {period_mm: 4, duty: 0.3}", "pattern.duty", "kind sine has no such key"),
        (
            "DISPLAY, pattern: {kind: bars, period_mm: 4, duty: 1}",
            "pattern.duty",
            "expected a number between 0 and 1, found 1",
        ),
        ("DISPLAY, pattern: {period_mm: 0}", "pattern.period_mm", "found 0"),
        ("DISPLAY, pattern: {period_mm: 4, directions: [w]}", "pattern.directions[0]", "expected u or v"),
        ("DISPLAY, pattern: {period_mm: 4, directions: []}", "pattern.directions", "found"),
        ("DISPLAY, pattern: {phases: 4}", "pattern", 'missing key "period_mm"'),
        ("DISPLAY, pattern: {period_mm: 4, period_deg: 90}", "pattern.period_deg", "a display has period_mm"),
        ("DISPLAY, pattern: {kind: bitmap}", "pattern", 'missing key "files"'),
        ("DISPLAY, pattern: {kind: bitmap, files: [a.jpg]}", "pattern.files", "a file ending in .png"),
        ("DISPLAY, pattern: {kind: bitmap, files: [a.png]}", "pattern.files", "no such file"),
        ("DISPLAY, pattern: {kind: bitmap, files: [a.png], phases: 4}", "pattern.phases", "bitmap has no such key"),
        ("kind: dome, radius_mm: 9, pattern: {period_mm: 4}", "pattern", 'missing key "period_deg"'),
        ("kind: dome, radius_mm: 9, pattern: {period_deg: 100}", "pattern.period_deg", "found 3.6 of them"),
        ("kind: dome, radius_mm: 9, pattern: {kind: bars, period_mm: 4}", "pattern.kind", "stripes of kind sine only"),
        ("kind: dome, radius_mm: 9, segments: 4, pattern: {period_deg: 90}", "segments", "no segments and no leak"),
        ("kind: backlight, distance_mm: 9", "", 'missing key "size_mm"'),
        ("kind: backlight, size_mm: [9, 9], distance_mm: 9, elevation_deg: -91", "elevation_deg", "found -91"),
        ("kind: bar, size_mm: [9, 9], distance_mm: 9, elevation_deg: -9", "elevation_deg", "found -9"),
        ("distance_mm: 9, elevation_deg: -9, azimuth_deg: 9", "elevation_deg", "found -9"),
    ],
)
def test_a_wrong_light_is_told_with_its_line(light: str, key: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        load(tmp_path, light)
    found = [text for text in told.value.messages if message in text]
    assert len(found) == 1, told.value.messages
    assert f"rig.yaml:{LINE}: lights[1]" in found[0]
    assert f"lights[1].{key}" in found[0] if key else True


def test_a_panel_needs_light_source(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'missing key "light_source"') as told:
        load(tmp_path, "distance_mm: 9, elevation_deg: 9, azimuth_deg: 9")
    assert f":{LINE}: lights[1]" in str(told.value)
