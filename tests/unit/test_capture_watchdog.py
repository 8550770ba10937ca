# ruff: noqa: PT012 - what fails is the way out of the `with` statement itself
"""The watch over burning lights, and every way out, with drivers that fail in ways that nobody foresaw."""

from __future__ import annotations

import signal
import threading
import time

import pytest
import serial
from capture_doubles import Lights, Stage, World

from lightopt.config import load_lights, load_rig
from lightopt.core.errors import HardwareError, InputError, error_text
from lightopt.rig.capture import Devices, _lights_off, _safe_devices, switch_off, wiring_of
from lightopt.rig.capture._lights_off import open_lights
from lightopt.rig.capture._safe_devices import LightWatchdog

LONGEST_S = 0.05


class MuteError(Exception):
    """One that cannot be turned into text."""

    def __str__(self):
        raise RuntimeError("no words")


UNFORESEEN = [
    ValueError("could not parse the reply"),
    OSError(5, "Input/output error"),
    serial.SerialException("device reports readiness to read but returned no data"),
    RuntimeError("the SDK is not initialised"),
    MuteError(),
]
ANY = [*UNFORESEEN, InputError("no such channel"), KeyboardInterrupt("SIGINT"), SystemExit(1)]


def of(errors):
    return pytest.mark.parametrize("error", errors, ids=lambda error: type(error).__name__)


@pytest.fixture(autouse=True)
def soon_again(monkeypatch):
    monkeypatch.setattr(_safe_devices, "_RETRY_S", 0.01)


@pytest.fixture
def world():
    return World()


@pytest.fixture
def opened(bench, world):
    """Devices of the small rig; light1 may burn for `LONGEST_S`."""
    wiring = wiring_of(load_rig(bench.rig))
    wiring.hardware.lights["light1"] = wiring.light("light1").model_copy(update={"max_on_s": LONGEST_S})
    controllers = {name: Lights(world, name, c.channels) for name, c in wiring.hardware.controllers.items()}
    return Devices(wiring=wiring, controllers=controllers, stage=Stage(world))


def until(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end, "not within a minute"
        time.sleep(0.002)


def failing(error, times):
    """Trouble each of the first times that a channel is darkened."""
    left = [times]

    def trouble(event):
        if event[0] == "level" and event[3] == 0 and left[0] > 0:
            left[0] -= 1
            raise error

    return trouble


# --- the watch


@of(ANY)
def test_a_light_goes_dark_whatever_its_driver_raised_at_first(error):
    tried = []

    def darken(light):
        tried.append(light)
        if len(tried) < 4:
            raise error

    watch = LightWatchdog(darken)
    watch.start("light1", LONGEST_S)
    until(lambda: len(tried) == 4)
    until(lambda: watch.remaining_s("light1") is None)
    assert "was switched off" in watch.pop_problem("light1")
    time.sleep(0.05)
    assert len(tried) == 4, "a light that is dark is left alone"


@of(ANY)
def test_what_the_driver_says_is_reported_as_long_as_the_light_burns(error):
    def darken(_light):
        raise error

    watch = LightWatchdog(darken)
    watch.start("light1", LONGEST_S)
    reported = []
    until(lambda: reported or reported.extend(filter(None, [watch.pop_problem("light1")])))
    assert reported[0].startswith(f"light1 is on for longer than its max_on_s of {LONGEST_S:g} s: ")
    assert error_text(error) in reported[0]
    watch.stop_all()


def test_no_light_waits_for_one_whose_driver_hangs():
    hangs, dark = threading.Event(), []

    def darken(light):
        if light == "light1":
            hangs.wait(60.0)
        dark.append(light)

    watch = LightWatchdog(darken)
    watch.start("light1", LONGEST_S)
    watch.start("light2", 2 * LONGEST_S)
    until(lambda: dark == ["light2"])
    assert watch.remaining_s("light1") is not None
    hangs.set()
    until(lambda: watch.remaining_s("light1") is None)


def test_a_light_that_is_out_in_time_is_not_touched():
    tried = []
    watch = LightWatchdog(tried.append)
    watch.start("light1", LONGEST_S)
    watch.stop("light1")
    time.sleep(2 * LONGEST_S)
    assert (tried, watch.pop_problem("light1")) == ([], None)


def test_a_light_that_no_thread_can_watch_is_not_lit(opened, world, monkeypatch):
    def none_left(_self):
        raise RuntimeError("can't start new thread")

    with pytest.raises(RuntimeError, match="new thread"), opened as devices:
        monkeypatch.setattr(threading.Thread, "start", none_left)
        devices.light_on("light1")
    assert not [event for event in world.did("level") if event[3] > 0]


def test_a_light_whose_time_is_up_before_it_is_lit_does_not_stay_on(opened, world):
    def slow(event):
        if event[0] == "level" and event[3] > 0:
            until(lambda: opened.remaining_on_s("light1") is None)

    with pytest.raises(HardwareError, match="was switched off"), opened as devices:
        world.trouble = slow
        try:
            devices.light_on("light1")
        finally:
            assert not world.lit


# --- ways out


@of(UNFORESEEN)
def test_the_way_out_ends_dark_whatever_the_driver_raised(opened, world, error):
    with opened as devices:
        devices.light_on("light3")
        assert world.lit
        world.trouble = failing(error, 2)
    assert not world.lit
    assert {event[1] for event in world.did("close")} == {"stage", "bench1"}


@of(UNFORESEEN)
def test_a_driver_that_never_darkens_is_reported_and_all_is_closed(opened, world, error):
    with pytest.raises(HardwareError, match=r"lights that may still be on: .*light3") as raised, opened as devices:
        devices.light_on("light3")
        world.trouble = failing(error, 10_000)
    assert any(error_text(error) in message for message in raised.value.messages)
    assert {event[1] for event in world.did("close")} == {"stage", "bench1"}


@of(UNFORESEEN)
def test_ctrl_c_while_a_driver_fails_ends_dark(opened, world, error):
    """The watch is failing at its light when Ctrl-C comes to the main thread."""
    with pytest.raises((KeyboardInterrupt, HardwareError)), opened as devices:
        devices.light_on("light1")
        world.trouble = failing(error, 3)
        until(lambda: len([event for event in world.did("level") if event[2:] == (1, 0)]) > 1)
        signal.raise_signal(signal.SIGINT)
    assert not world.lit
    assert {event[1] for event in world.did("close")} == {"stage", "bench1"}


@pytest.mark.parametrize("method", ["stop", "state"])
def test_a_stage_that_fails_in_its_own_way_keeps_nothing_open(opened, world, method):
    def fail(*_):
        raise ValueError("could not parse")

    def lost(event):
        if event[0] == "move":
            raise OSError("gone")

    setattr(opened.stage, method, fail)
    with pytest.raises(OSError, match="gone"), opened as devices:
        devices.light_on("light3")
        world.trouble = lost
        devices.move_to(devices.stage.world.posture)
    assert not world.lit
    assert {event[1] for event in world.did("close")} == {"stage", "bench1"}


@of(UNFORESEEN)
def test_controllers_that_open_go_dark_and_the_others_are_named(bench, world, monkeypatch, error):
    """Of two controllers one fails in a way of its own as it opens."""
    wiring = wiring_of(load_rig(bench.rig))
    (name,) = wiring.hardware.controllers
    wiring.hardware.controllers["other"] = wiring.hardware.controllers[name].model_copy()
    world.levels["other", 2] = 200

    def open_controller(_wiring, which, *, port, log):
        if which == name:
            raise error
        return Lights(world, which, 4)

    monkeypatch.setattr(_lights_off, "open_controller", open_controller)
    found = open_lights(wiring, wiring.hardware.controllers, ports={}, log=None, darken=True, opened=lambda _: None)
    assert not world.lit
    assert set(found.controllers) == {"other"}
    assert set(found.may_be_on) == {"light1", "light3"}
    assert error_text(error) in str(found.error())


def test_switching_off_tells_what_may_burn_whatever_the_driver_raised(bench, monkeypatch):
    def open_controller(_wiring, _name, *, port, log):
        raise ValueError("could not parse")

    monkeypatch.setattr(_lights_off, "open_controller", open_controller)
    with pytest.raises(HardwareError, match="could not parse") as raised:
        switch_off(load_lights(bench.rig))
    assert "lights that may still be on: light1, light3" in raised.value.messages
