"""The opened devices: dark on every way out, whatever else fails."""

from __future__ import annotations

import signal
import sys
import time

import pytest
from capture_doubles import Camera, Lights, Stage, World, broken

from lightopt.config import load_part, load_rig
from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.capture import CaptureOptions, Devices, hold_light, make_plan, snap, wiring_of
from lightopt.rig.simulated import BenchTruth
from lightopt.scene import build_scene


@pytest.fixture
def world():
    return World()


@pytest.fixture
def rig(bench):
    return load_rig(bench.rig)


@pytest.fixture
def opened(bench, rig, world):
    """Opens the doubles of the small rig; `channel` is what its first light has besides."""

    def opened(channel=None, **options):
        wiring = wiring_of(rig)
        wiring.hardware.lights["light1"] = wiring.light("light1").model_copy(update=channel or {})
        scene = build_scene(rig, load_part(bench.part))
        return Devices(
            wiring=wiring,
            controllers={name: Lights(world, name, c.channels) for name, c in wiring.hardware.controllers.items()},
            stage=Stage(world),
            camera=Camera(world, wiring, scene, BenchTruth()),
            **options,
        )

    return opened


# --- closing


def test_all_is_closed_even_if_one_cannot_be(opened, world):
    closed = []

    def full():
        raise OSError("No space left on device")

    devices = opened(closing=(full, lambda: closed.append("bench")))
    devices.camera.close = full
    with pytest.raises(HardwareError) as raised, devices:
        devices.light_on("light1")
    assert raised.value.messages == (
        "closing a device failed: OSError: No space left on device",
        "closing a device failed: OSError: No space left on device",
        "all lights are off",
    )
    assert not world.lit
    assert closed == ["bench"]
    assert {event[1] for event in world.did("close")} == {"stage", "bench1"}


def test_what_could_not_be_closed_does_not_hide_what_failed(opened, world):
    def full():
        raise OSError("No space left on device")

    world.trouble = broken("grab", error=HardwareError("no frame"))
    with pytest.raises(HardwareError, match="no frame") as raised, opened(closing=(full,)) as devices:
        devices.camera.grab(timeout_s=1.0)
    assert "all lights are off" in raised.value.messages
    assert raised.value.messages[-1] == "closing a device failed: OSError: No space left on device"


def test_what_burns_goes_dark_first(opened, world):
    with opened({"channel": 4}) as devices:
        devices.light_on("light1")
        before = len(world.log)
    assert world.log[before] == ("level", "bench1", 4, 0)
    assert len(world.did("level")) == 9


# --- how long a light may burn


def test_a_light_goes_dark_at_its_time_while_the_camera_hangs(opened, world):
    dark_while_hanging = []

    def hang(event):
        if event[0] == "grab":
            time.sleep(0.5)
            dark_while_hanging.append(not world.lit)

    world.trouble = hang
    with pytest.raises(HardwareError, match=r"light1 was on for its max_on_s of 0\.1 s"):
        grab_and_go(opened({"max_on_s": 0.1}))
    assert dark_while_hanging == [True]


def grab_and_go(devices):
    with devices:
        devices.camera.set_exposure(1000.0)
        devices.light_on("light1")
        devices.camera.grab(timeout_s=1.0)
        devices.light_off("light1")


def test_a_light_that_does_not_go_dark_in_time_is_tried_again(opened, world, monkeypatch):
    monkeypatch.setattr("lightopt.rig.capture._safe_devices._RETRY_S", 0.05)
    world.trouble = broken("level", number=6, error=HardwareError("no reply"))  # four at the start, one on

    with opened({"max_on_s": 0.1}) as devices:
        devices.light_on("light1")
        time.sleep(0.12)
        assert world.lit
        time.sleep(0.3)
        assert not world.lit
        with pytest.raises(HardwareError, match="was on for its max_on_s"):
            devices.check_watchdog("light1")


def test_each_lighting_has_its_own_time(opened, world):
    with opened({"max_on_s": 0.3}) as devices:
        for _ in range(4):
            devices.light_on("light1")
            time.sleep(0.12)
            assert world.lit
            assert 0 < devices.remaining_on_s("light1") < 0.2
            devices.light_off("light1")
        assert devices.remaining_on_s("light1") is None


def test_no_level_above_the_channel_s(opened, world):
    with opened({"max_level": 220}) as devices:
        devices.light_on("light1", 220)
        with pytest.raises(InputError, match="light1: level 221 is above its max_level 220; nothing was sent"):
            devices.light_on("light1", 221)
    assert ("level", "bench1", 1, 221) not in world.log


# --- signals at bad moments


posix = pytest.mark.skipif(sys.platform == "win32", reason="signals are those of POSIX")


@posix
def test_a_second_signal_before_the_first_is_caught(opened, world):
    """It comes while the first unwinds, before anything is shielded."""

    def run():
        with opened() as devices:
            devices.light_on("light1")
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                signal.raise_signal(signal.SIGTERM)

    with pytest.raises(KeyboardInterrupt, match="SIGINT"):
        run()
    assert not world.lit
    assert {event[0] for event in world.log[-3:]} == {"close"}
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


@posix
@pytest.mark.parametrize("line", range(12))
def test_a_signal_while_the_devices_are_left(opened, world, line):
    """At the first instruction of leaving, and at each line after it."""
    lines = []

    def watch(frame, event, argument):
        if frame.f_code is Devices.__exit__.__code__:
            lines.append(event)
            if len(lines) == line + 1:
                signal.raise_signal(signal.SIGINT)
            return watch
        return None

    ended = None
    try:
        with opened() as devices:
            devices.light_on("light1")
            sys.settrace(watch)
    except KeyboardInterrupt as error:
        ended = error
    finally:
        sys.settrace(None)
    assert (ended is not None) == (line < len(lines))
    assert not world.lit
    assert {event[0] for event in world.log[-3:]} == {"close"}


def test_a_program_that_ends_without_leaving_is_dark(opened, world):
    devices = opened()
    devices.__enter__()
    devices.light_on("light1")
    devices._last_resort()
    assert not world.lit
    devices.__exit__(None, None, None)
    number = len(world.log)
    devices._last_resort()
    assert len(world.log) == number


def test_a_lamp_at_the_bench_is_off_before_its_time(opened, world):
    waited = []

    def wait(seconds):
        waited.append(seconds)
        time.sleep(seconds)

    with opened({"max_on_s": 0.3}) as devices:
        assert hold_light(devices, "light1", 200, seconds=None, wait=wait) == 200
    assert 0.2 < waited[0] < 0.28


def test_a_frame_that_hangs_under_a_lamp_at_the_bench(opened, world, bench):
    def hang(event):
        if event[0] == "grab":
            time.sleep(0.5)
            assert not world.lit

    world.trouble = hang
    path = bench.folder / "frame.png"
    with pytest.raises(HardwareError, match="light1 was on for its max_on_s of"), opened({"max_on_s": 0.3}) as devices:
        snap(devices, path, light="light1", exposure=1.0)
    assert not path.exists()


def test_an_exposure_that_the_camera_cannot_have(opened, world, rig, bench):
    from lightopt.rig.capture._acquisition import AcquisitionEngine

    part = load_part(bench.part)
    plan = make_plan(rig, part)
    sensor = build_scene(rig, part).sensor
    with opened() as devices:
        devices.camera.exposure_range_us = (10.0, 9000.0)
        with pytest.raises(InputError, match=r"an exposure of 10000 µs is outside the camera's 10 to 9000 µs"):
            AcquisitionEngine(devices, plan, sensor=sensor)


def test_exposures_between_the_steps_of_the_camera_are_refused_in_the_dark(opened, world, rig, bench):
    from lightopt.rig.capture._acquisition import AcquisitionEngine

    part = load_part(bench.part)
    sensor = build_scene(rig, part).sensor

    def shooter(devices, *exposures):
        plan = make_plan(rig, part, CaptureOptions(exposures=exposures))
        AcquisitionEngine(devices, plan, sensor=sensor).close()

    with opened() as devices:
        devices.camera.set_exposure = lambda requested: 20.0 * round(requested / 20)
        with pytest.raises(InputError) as raised:
            shooter(devices, 1.0, 1 / 16, 1 / 64)
        assert len(raised.value.messages) == 2
        assert "exposure 0.0625 (625 µs): the camera holds 620 µs instead, which is exposure 0.062" in str(raised.value)
        assert not world.lit
        assert not any(event[0] in ("grab", "move") or (event[0] == "level" and event[3]) for event in world.log)
        shooter(devices, 1.0, 0.062, 0.016)  # what the message names
