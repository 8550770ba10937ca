"""Displays among the controllers of a rig file, and what does not fit them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from lightopt.config import copied_text, load_rig
from lightopt.core.errors import InputError
from lightopt.rig.capture import wiring_of

RIG = """\
format: lightopt-rig/1
name: displays
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [40, 30]
  pixel_size_um: 100
  image_distance_mm: 55
  sensor: {bit_depth: 8}
lights:
  - {name: lcd, kind: display, size_mm: [400, 300], distance_mm: 300, elevation_deg: 60, pattern: {period_mm: 60}}
  - {name: white, kind: display, size_mm: [100, 100], distance_mm: 300, elevation_deg: 30}
  - {name: bar, kind: bar, size_mm: [100, 20], distance_mm: 300, elevation_deg: 30}
hardware:
  controllers:
    monitor: {driver: screen, monitor: 2, channels: 8, picture: {resolution_px: [64, 48], turn_deg: 0}}
    shown: {driver: command, command: [tool, show.txt, "{file}"], top_level: 200, picture: {resolution_px: [10, 10]}}
    lamps: {driver: ccs, port: virtual}
  lights:
    lcd-1: {controller: monitor, channel: 1, level: 255}
    lcd-2: {controller: monitor, channel: 2, level: 255}
    lcd-3: {controller: monitor, channel: 3, level: 255}
    lcd-4: {controller: monitor, channel: 4, level: 255}
    lcd-5: {controller: monitor, channel: 5, level: 255}
    lcd-6: {controller: monitor, channel: 6, level: 255}
    lcd-7: {controller: monitor, channel: 7, level: 255}
    lcd-8: {controller: monitor, channel: 8, level: 255}
    white: {controller: shown, channel: 1, level: 200}
    bar: {controller: lamps, channel: 1, level: 255}
  camera: {driver: virtual}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "rig.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_a_display_can_say(tmp_path):
    hardware = load_rig(write(tmp_path, RIG)).hardware
    assert hardware is not None
    monitor, shown = hardware.controllers["monitor"], hardware.controllers["shown"]
    assert (monitor.port, monitor.monitor, monitor.command) == (None, 2, None)
    assert (shown.port, shown.monitor, shown.command) == (None, None, ("tool", "show.txt", "{file}"))
    assert monitor.picture is not None
    assert (monitor.picture.gamma, monitor.picture.settle_ms, monitor.picture.mirrored) == (2.2, 50, False)


BAD = [
    ("monitor: 2, ", "", "controllers.monitor", 'missing key "monitor": .*number of the monitor'),
    ("monitor: 2", "monitor: 0", "controllers.monitor.monitor", "number of a monitor, from 1 to 16, found 0"),
    ("monitor: 2", "monitor: 2, port: COM3", "controllers.monitor.port", "driver screen has no such key"),
    ("monitor: 2", "monitor: 2, baud: 9600", "controllers.monitor.baud", "driver screen has no such key"),
    (
        "monitor: 2",
        'monitor: 2, command: ["{file}"]',
        "controllers.monitor.command",
        "driver screen has no such key; it belongs to command",
    ),
    (", picture: {resolution_px: [10, 10]}", "", "controllers.shown", 'missing key "picture"'),
    ('command: [tool, show.txt, "{file}"], ', "", "controllers.shown", 'missing key "command"'),
    (', "{file}"]', "]", "controllers.shown.command", 'no entry has the field {file}.*add "{file}"'),
    ("turn_deg: 0", "turn_deg: 45", "controllers.monitor.picture.turn_deg", "expected 0, 90, 180 or 270, found 45"),
    ("turn_deg: 0", "gamma: 0", "controllers.monitor.picture.gamma", "from 0.5 to 5"),
    ("turn_deg: 0", "turn_deg: 90", "controllers.monitor.picture.resolution_px", "4.688 × 8.333 mm; expected square"),
    ("[64, 48]", "[64, 40]", "controllers.monitor.picture.resolution_px", "400 × 300 mm of lcd .* 6.25 × 7.5 mm"),
    ("[64, 48]", "[64]", "controllers.monitor.picture.resolution_px", "expected .width, height."),
    ("shown, channel: 1", "monitor, channel: 1", "lights.white", "monitor is the display lcd; each display needs its"),
    ("lamps, channel: 1", "shown, channel: 2", "lights.bar.controller", "shown is a display, and this light is a bar"),
    ("{driver: ccs, port: virtual}", "{driver: ccs}", "controllers.lamps", 'missing key "port": Serial port'),
    ("port: virtual}", "port: virtual, channels: 65}", "controllers.lamps.channels", "at most 64, the most that ccs"),
]


@pytest.mark.parametrize(("old", "new", "keys", "says"), BAD, ids=[f"{new}-{keys}"[:50] for _, new, keys, _ in BAD])
def test_what_does_not_fit(tmp_path, old, new, keys, says):
    assert RIG.count(old) == 1
    with pytest.raises(InputError) as caught:
        load_rig(write(tmp_path, RIG.replace(old, new)))
    text = next(m for m in caught.value.messages if f"hardware.{keys}" in m)
    assert re.search(rf"rig.yaml:\d+: hardware\.{re.escape(keys)}.*: .*{says}", text), text


def test_two_displays_on_one_monitor(tmp_path):
    text = RIG.replace('command: [tool, show.txt, "{file}"]', "monitor: 2").replace("driver: command", "driver: screen")
    with pytest.raises(InputError, match=r'monitor "2" is already that of controllers.monitor'):
        load_rig(write(tmp_path, text))


def test_files_of_a_command_are_found_from_a_copy(tmp_path):
    (tmp_path / "show.txt").touch()
    out = tmp_path / "out"
    out.mkdir()
    assert 'command: [tool, "../show.txt", "{file}"]' in copied_text(load_rig(write(tmp_path, RIG)), out)


def test_a_programme_is_within_the_radiance_of_the_screen(tmp_path):
    programme = "programme:\n  - {name: both, lights: {lcd-1: 1, lcd-6: WEIGHT}}\nhardware:"
    # 1 + 0.2, less what a pixel of 6 mm blurs
    text = RIG.replace("hardware:", programme.replace("WEIGHT", "0.2"), 1)
    with pytest.raises(InputError, match=r"rig.yaml:\d+: programme\[0\].lights: .* need 1.19 times .*display monitor"):
        wiring_of(load_rig(write(tmp_path, text)))
    text = text.replace("lcd-1: 1,", "lcd-1: 0.8,")
    assert wiring_of(load_rig(write(tmp_path, text))).levels("both") == {"lcd-1": 204, "lcd-6": 51}
