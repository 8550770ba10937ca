"""Displays as light controllers: simulated screens, commands that are run, the window's program with another library.

The stand-in for pygame writes what is on its monitors to a file; everything else of the window's program is as it is.
"""

from __future__ import annotations

import json
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_bench import set_fault, unplug

from lightopt import build_scene, load_part, load_rig, render
from lightopt.config import PictureConfig
from lightopt.core.errors import HardwareError, InputError
from lightopt.images import read_image_set, read_png
from lightopt.rig.capture import CaptureOptions, capture, check_devices, connect_devices, wiring_of
from lightopt.rig.devices import LIGHT_DRIVERS, LightController, LightSettings, _light_display, all_off, check_display
from lightopt.rig.devices._device import LinkLostError, RefusedError
from lightopt.rig.simulated import BenchProcess

SIZE = (8, 6)
LEFT = np.array([[1.0] * 4 + [0.0] * 4] * 6)
RAMP = np.tile(np.linspace(0.0, 1.0, 6)[:, None], (1, 8))
PICTURE = PictureConfig(resolution_px=SIZE, gamma=1.0, settle_ms=0.0)
PICTURES = {1: lambda: LEFT, 2: lambda: RAMP}


def opened(driver: str, **settings: Any) -> LightController:
    usual = {"port": "", "picture": PICTURE, "pictures": PICTURES}
    return LIGHT_DRIVERS[driver](LightSettings("lcd", **{**usual, **settings}), None)


def life(controller: LightController, shown: Callable[[], np.ndarray]) -> None:
    """What every display does: sums of lit channels, black without; no level is above the screen's."""
    all_off({"lcd": controller})
    assert (shown() == 0).all()
    assert controller.identify()["read_back"] == "no"
    assert controller.set_level(1, 255) is None
    np.testing.assert_array_equal(shown(), np.round(255 * LEFT))
    controller.set_level(1, 102)
    controller.set_level(2, 153)
    np.testing.assert_array_equal(shown(), np.round(255 * (0.4 * LEFT + 0.6 * RAMP)))
    with pytest.raises(InputError, match=r"lcd \(.*channels 1, 2 together need 1.2 times the full radiance"):
        controller.set_level(1, 153)
    with pytest.raises(InputError, match="no light of the rig is on channel 3; nothing was shown"):
        controller.set_level(3, 1)
    controller.set_level(1, 0)
    np.testing.assert_array_equal(shown(), np.round(255 * 0.6 * RAMP))
    all_off({"lcd": controller})
    assert (shown() == 0).all()


# ---- simulated


@pytest.fixture(scope="module")
def bench() -> Iterator[BenchProcess]:
    names = ("screen", "command", "drop", "other", "pulled")
    options = {"resolution_px": SIZE, "gamma": 1.0}
    with BenchProcess({name: {"kind": "screen", "tcp": True, "options": options} for name in names}) as process:
        yield process


@pytest.mark.parametrize("driver", ["screen", "command"])
def test_life_of_a_simulated_screen(bench, driver):
    controller = opened(driver, port=bench.ports[driver])
    identity = controller.identify()
    assert (identity["driver"], identity["port"]) == (driver, bench.ports[driver])
    life(controller, lambda: np.round(255.0 * np.array(bench.state()["pictures"][driver])))
    controller.set_level(1, 255)
    controller.close()
    controller.close()
    assert np.array(bench.state()["pictures"][driver]).max() == 1.0  # closing changes no light


def test_a_lost_reply_is_sent_again_and_a_refusal_is_not(bench):
    controller = opened("screen", port=bench.ports["drop"], timeout_s=0.5)
    set_fault(bench, "drop", "drop", count=1)
    controller.set_level(1, 255)
    assert sum(event.retry for event in controller.events) >= 1  # more where the computer is busy
    controller.close()
    wrong = PictureConfig(resolution_px=(6, 8), turn_deg=90, settle_ms=0.0)
    controller = opened("screen", port=bench.ports["other"], picture=wrong)
    with pytest.raises(RefusedError, match=r'refuses the picture; sent "SHOW 6 8 .*the screen has 8 x 6 pixels'):
        controller.set_level(1, 255)
    controller.close()


def test_a_screen_that_is_gone_may_still_shine(bench):
    controller = opened("screen", port=bench.ports["pulled"])
    controller.set_level(1, 255)
    unplug(bench, "pulled")
    with pytest.raises(LinkLostError, match="the device is gone"):
        controller.set_level(1, 0)
    with pytest.raises(HardwareError, match="may still be lit"):
        all_off({"lcd": controller})
    controller.close()


# ---- a command


SCRIPT = """\
import pathlib, shutil, sys, time
mode = pathlib.Path("mode.txt").read_text()
if mode == "hang":
    pathlib.Path("hangs.txt").touch()
    time.sleep(60)
if mode == "fail":
    sys.exit("no projector\\n" + "x" * 5)
shutil.copy(sys.argv[1], "shown.png")
"""


@pytest.fixture
def script(tmp_path) -> Callable[[str], None]:
    (tmp_path / "show.py").write_text(SCRIPT, encoding="utf-8")
    (tmp_path / "mode.txt").write_text("copy", encoding="utf-8")
    return lambda mode: (tmp_path / "mode.txt").write_text(mode, encoding="utf-8") and None


def commanded(folder: Path, **settings: Any) -> LightController:
    return opened("command", command=(sys.executable, "show.py", "{file}"), folder=folder, timeout_s=20.0, **settings)


def test_life_of_a_command(tmp_path, script):
    controller = commanded(tmp_path)
    life(controller, lambda: read_png(tmp_path / "shown.png"))
    pictures = Path(controller._link._pictures.name)
    assert len(list(pictures.iterdir())) == 2
    controller.close()
    assert not pictures.exists()


def test_a_command_that_fails_says_why_and_darkening_is_tried_again(tmp_path, script):
    controller = commanded(tmp_path)
    controller.set_level(1, 255)
    script("fail")
    with pytest.raises(
        HardwareError, match=r"(?s)\(command\) on .*: .* failed with exit status 1; .*no projector.xxxxx"
    ):
        controller.set_level(1, 0)
    with pytest.raises(HardwareError, match="channels 1, 2, 3, 4: not switched off, may still be lit"):
        all_off({"lcd": controller})
    script("copy")
    controller.set_level(2, 0)  # of any channel: what was switched off is not shown again
    assert (read_png(tmp_path / "shown.png") == 0).all()
    controller.close()


def test_a_command_that_hangs_is_ended(tmp_path, script):
    script("hang")
    controller = opened("command", command=(sys.executable, "show.py", "{file}"), folder=tmp_path, timeout_s=0.3)
    with pytest.raises(HardwareError, match=r"did not end within 0.3 s \(timeout_s\) and was ended; it printed no err"):
        controller.set_level(1, 255)
    controller.close()


def test_darkening_does_not_wait_for_a_command(tmp_path, script):
    script("hang")
    controller, caught = commanded(tmp_path), []

    def light() -> None:
        try:
            controller.set_level(1, 255)
        except HardwareError as error:
            caught.append(str(error))

    thread = threading.Thread(target=light)
    thread.start()
    until = time.monotonic() + 60.0
    while not (tmp_path / "hangs.txt").exists() and time.monotonic() < until:
        time.sleep(0.01)
    script("copy")
    controller.set_level(1, 0)
    thread.join()
    assert "no longer waited for, because a light had to be switched off" in caught[0]
    assert (read_png(tmp_path / "shown.png") == 0).all()
    controller.close()


# ---- the window's program


STAND_IN = """\
import json, os
SIZES = [(1280, 1024), (8, 6)]
class error(Exception): pass
FULLSCREEN = 1
class Surface:
    def __init__(self, size): self.size, self.levels = size, b""
    def get_size(self): return self.size
    def set_palette(self, colours): assert colours == [(k, k, k) for k in range(256)]
    def blit(self, other, place): self.levels = other.levels
class display:
    window = None
    def init(): pass
    def get_driver(): return os.environ["STAND_IN_DRIVER"]
    def get_desktop_sizes(): return SIZES
    def set_mode(size, flags, display):
        assert flags == FULLSCREEN and display == 1
        globals()["display"].window = Surface(size)
        return globals()["display"].window
    def flip(): _tell({"levels": list(display.window.levels)})
class image:
    def frombuffer(data, size, kind):
        assert kind == "P"
        made = Surface(size)
        made.levels = data
        return made
class mouse:
    def set_visible(visible): assert not visible
class event:
    def get(): return []
def quit(): _tell({"closed": True})
def _tell(what):
    with open(os.environ["STAND_IN_FILE"], "a") as file: file.write(json.dumps(what) + "\\n")
"""


@pytest.fixture
def window(tmp_path, monkeypatch) -> Callable[[], list[dict[str, Any]]]:
    """What the stand-in was made to do so far."""
    (tmp_path / "pygame.py").write_text(STAND_IN, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("STAND_IN_FILE", str(tmp_path / "window.jsonl"))
    monkeypatch.setenv("STAND_IN_DRIVER", "x11")
    return lambda: [json.loads(line) for line in (tmp_path / "window.jsonl").read_text().splitlines()]


def test_life_of_a_window(window):
    controller = opened("screen", monitor=2, timeout_s=20.0)
    assert window() == [{"levels": [0] * 48}]  # black before anything is asked of it
    assert controller.identify()["port"] == "monitor 2"
    life(controller, lambda: np.array(window()[-1]["levels"]).reshape(6, 8))
    controller.set_level(1, 255)
    controller.close()
    # black, then closed
    assert window()[-2:] == [{"levels": [0] * 48}, {"closed": True}]


def test_a_window_ends_with_its_program(window):
    controller = opened("screen", monitor=2, timeout_s=20.0)
    controller.set_level(1, 255)
    controller._link.close()  # as when the program is killed
    assert controller._process._process.wait(20) == 0
    assert window()[-1] == {"closed": True}
    controller.close()


@pytest.mark.parametrize(
    ("monitor", "size", "driver", "says"),
    [
        (3, SIZE, "x11", r"lcd \(screen\) on monitor 3: no monitor 3; there is 1 \(1280 × 1024\), 2 \(8 × 6\)"),
        (1, SIZE, "x11", r"monitor 1 has 1280 × 1024 pixels, and resolution_px is 8 × 6; set the monitor"),
        (2, SIZE, "offscreen", "no desktop can be reached; run this in a session with a desktop"),
    ],
)
def test_a_monitor_that_is_not_as_described(window, monkeypatch, monitor, size, driver, says):
    monkeypatch.setenv("STAND_IN_DRIVER", driver)
    with pytest.raises(InputError, match=says):
        opened("screen", monitor=monitor)


def test_a_window_that_does_not_start(tmp_path, window):
    (tmp_path / "pygame.py").write_text("raise RuntimeError('no graphics')", encoding="utf-8")
    with pytest.raises(HardwareError, match=r"process did not start; its output: RuntimeError: no graphics"):
        opened("screen", monitor=2)


def test_without_the_library(monkeypatch):
    monkeypatch.setattr(_light_display, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"needs pygame-ce; install it: pip install 'lightopt\[screen\]'"):
        check_display(None, Path())


# ---- captures


RIG = """\
format: lightopt-rig/1
name: display
camera:
  distance_mm: 550
  elevation_deg: 90
  resolution_px: [40, 30]
  pixel_size_um: 200
  image_distance_mm: 55
  exposure_us: 1000
  sensor: {bit_depth: 12}
lights:
  - {name: lcd, kind: display, size_mm: [400, 300], distance_mm: 300, elevation_deg: 50, azimuth_deg: 90, gain: 0.35,
     pattern: {period_mm: 150, phases: 3}}
programme:
  - {name: first, lights: {lcd-1: 1}}
  - {name: second, lights: {lcd-2: 0.5}}
  - {name: both, lights: {lcd-3: 0.4, lcd-5: 0.6}}
hardware:
  controllers:
    lcd: {driver: screen, port: virtual, channels: 6, top_level: 200, picture: {resolution_px: [80, 60], settle_ms: 0}}
  lights:
    lcd-1: {controller: lcd, channel: 1, level: 200}
    lcd-2: {controller: lcd, channel: 2, level: 200}
    lcd-3: {controller: lcd, channel: 3, level: 200}
    lcd-4: {controller: lcd, channel: 4, level: 200}
    lcd-5: {controller: lcd, channel: 5, level: 200}
    lcd-6: {controller: lcd, channel: 6, level: 200}
  camera: {driver: virtual}
  timing: {light_ms: 0}
"""
PART = """\
format: lightopt-part/1
name: knob
mesh: {file: MESH, units: mm}
placement: {anchor: rest_on_table}
postures: [{elevation_deg: 0, rotation_deg: 0}]
reflectance: {R_d: 45, R_s: 5000, sigma_rad: 0.1}
"""
MESH = Path(__file__).parents[2] / "configs" / "parts" / "cover-knob.stl"


@pytest.fixture
def files(tmp_path) -> Path:
    (tmp_path / "rig.yaml").write_text(RIG, encoding="utf-8")
    (tmp_path / "part.yaml").write_text(PART.replace("MESH", MESH.as_posix()), encoding="utf-8")
    return tmp_path


def rendered(folder: Path) -> dict[str, np.ndarray]:
    (images,) = render(build_scene(load_rig(folder / "rig.yaml"), load_part(folder / "part.yaml")))
    return {image.light: image.level for image in images.lights}


def test_a_display_is_captured_as_it_is_rendered(files):
    rig, part = load_rig(files / "rig.yaml"), load_part(files / "part.yaml")
    capture(rig, part, files / "out", options=CaptureOptions())
    wanted, found = rendered(files), read_image_set(files / "out")
    assert len(found.images) == 3
    for entry in found.images:
        level, ideal = found.load(entry).levels, wanted[entry.light]
        assert 40.0 < ideal.max() < 250.0
        # levels of 255/4095, and what 8 bits of the screen round
        np.testing.assert_allclose(level, ideal, atol=0.004 * ideal.max() + 0.1)


@pytest.mark.parametrize(
    ("old", "new", "instead"),
    [
        ("settle_ms: 0", "turn_deg: 180", {"first": "first", "second": "third"}),
        ("settle_ms: 0", "mirrored: true", {"first": "first", "second": "third"}),
        ("settle_ms: 0", "gamma: 1", {}),
    ],
)
def test_a_screen_that_is_not_as_described_is_seen(files, old, new, instead):
    """The true screen hangs upside down, is mirrored, or responds otherwise: frames are those of what it shows."""
    (files / "true.yaml").write_text(RIG.replace(old, new), encoding="utf-8")
    third = RIG.replace("lcd-3: 0.4, lcd-5: 0.6", "lcd-3: 0.5").replace("name: both", "name: third")
    (files / "rig.yaml").write_text(f"{third}virtual_bench: {{rig: true.yaml}}\n", encoding="utf-8")
    rig, part = load_rig(files / "rig.yaml"), load_part(files / "part.yaml")
    wanted, wiring = rendered(files), wiring_of(rig)
    with connect_devices(rig, wiring, part=part) as devices:
        devices.camera.set_exposure(1000.0)
        for image in ("first", "second"):
            for name, level in wiring.levels(image).items():
                devices.light_on(name, level)
            seen = devices.grab(1000.0, image).levels * (255.0 / 4095.0)
            devices.light_off(image)
            if instead:
                ideal = wanted[instead[image]]
                np.testing.assert_allclose(seen, ideal, atol=0.004 * ideal.max() + 0.1)
            else:
                # levels meant for gamma 2.2 are brighter on a linear screen, but where the picture is black or white
                assert (seen > wanted[image] - 0.2).all()
                assert seen.sum() > 1.05 * wanted[image].sum()


@pytest.mark.parametrize(
    ("device", "row"),
    [
        ("driver: screen, monitor: 2", "screen   monitor 2  not tried"),
        ('driver: command, command: [tool, "{file}"]', "command  tool       not tried"),
    ],
)
def test_displays_are_listed_and_not_opened(cli, files, device, row):
    text = RIG.replace("driver: screen, port: virtual", device)
    (files / "rig.yaml").write_text(text, encoding="utf-8")
    ran = cli("bench", "devices", files / "rig.yaml")
    assert ran.status == 0
    assert re.search(r"controller lcd\s+" + re.sub(" +", r"\\s+", row), ran.out)


def test_a_program_that_is_not_there_is_found_before_anything_is_opened(files):
    text = RIG.replace("driver: screen, port: virtual", 'driver: command, command: [no-such-tool, "{file}"]')
    (files / "rig.yaml").write_text(text, encoding="utf-8")
    rig = load_rig(files / "rig.yaml")
    with pytest.raises(InputError, match=r"rig.yaml:\d+: hardware.*lcd: no program no-such-tool on the PATH"):
        check_devices(rig, wiring_of(rig))
