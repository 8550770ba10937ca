"""Lights that an earlier run left on, while other devices of the rig are out of order."""

from __future__ import annotations

import pytest
from fault_cases import make_rig
from faulty_bench import set_fault, trace

from lightopt.config import RigConfig, load_lights, load_rig
from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.capture import connect_devices, switch_off, wiring_of
from lightopt.rig.simulated import BenchProcess

LIT = {"kind": "ccs", "options": {"channels": 2, "levels": {"1": 200, "2": 90}}}
HARDWARE = """\
hardware:
  controllers:
    left: {{driver: ccs, port: "{left}", channels: 2, timeout_s: 0.5}}
    right: {{driver: {driver}, port: "{right}", channels: 2, timeout_s: 0.5{template}}}
  lights:
    light1: {{controller: left, channel: 1, level: 200}}
    light3: {{controller: right, channel: 2, level: 150}}
  stage:
    driver: shot
    port: "{stage}"
    rotation: {{axis: "2", steps_per_deg: 100, speed_deg_per_s: 500}}
    timeout_s: 0.5
  camera: {{driver: virtual}}
"""


@pytest.fixture
def bench():
    with BenchProcess({"left": LIT, "right": LIT, "stage": {"kind": "grbl", "options": {}}}) as process:
        yield process


@pytest.fixture
def rig_on(tmp_path):
    """Writes the small rig with these ports."""

    def rig_on(ports, driver="ccs", template="") -> RigConfig:
        path, _ = make_rig(tmp_path)
        text = path.read_text(encoding="utf-8").partition("hardware:")[0]
        path.write_text(text + HARDWARE.format(**ports, driver=driver, template=template), encoding="utf-8")
        return load_rig(path)

    return rig_on


def dark(bench, *names):
    return [not any(bench.levels(name).values()) for name in names]


def edited(rig, *pairs):
    """The rig's file after some words were replaced, each by the one after it."""
    path = rig.source.path
    text = path.read_text(encoding="utf-8")
    for old, new in zip(pairs[::2], pairs[1::2], strict=True):
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    return path


def off(rig):
    return switch_off(load_lights(rig.source.path))


def test_all_goes_dark_without_stage_and_camera(bench, rig_on):
    rig = rig_on({**bench.ports, "stage": "/dev/nowhere"})
    assert dark(bench, "left", "right") == [False, False]
    done = off(rig)
    assert (done.controllers, done.unverified) == (("left", "right"), ())
    assert dark(bench, "left", "right") == [True, True]


@pytest.mark.parametrize(("broken", "whole", "light"), [("left", "right", "light1"), ("right", "left", "light3")])
@pytest.mark.parametrize("how", ["mute", "no port"])
def test_one_controller_is_darkened_without_the_other(bench, rig_on, broken, whole, light, how):
    ports = dict(bench.ports)
    if how == "mute":
        set_fault(bench, broken, "drop", count=None)
    else:
        ports[broken] = "/dev/nowhere"
    with pytest.raises(HardwareError) as raised:
        off(rig_on(ports))
    assert dark(bench, whole) == [True]
    assert broken in raised.value.messages[0]
    assert raised.value.messages[-1] == f"lights that may still be on: {light}"


def test_a_channel_that_does_not_obey_is_named_and_the_others_are_dark(bench, rig_on):
    set_fault(bench, "right", "deaf", channel=2)
    with pytest.raises(HardwareError, match="channel 2: not switched off") as raised:
        off(rig_on(bench.ports))
    assert raised.value.messages[-1] == "lights that may still be on: light3"
    assert bench.levels("right")[1] == 0
    assert dark(bench, "left") == [True]


def test_what_cannot_be_read_back_is_only_sent(bench, rig_on):
    blind = ', template: {set: "W{channel}{level:03d}\\r\\n"}'
    assert off(rig_on(bench.ports, driver="template", template=blind)).unverified == ("right",)


def test_a_stage_that_does_not_answer_leaves_nothing_burning(bench, rig_on):
    """As after kill -9 with a Grbl in alarm, which answers nothing."""
    set_fault(bench, "stage", "drop", count=None)
    rig = rig_on(bench.ports)
    rig.hardware.stage.__dict__["driver"] = "grbl"
    rig.hardware.stage.rotation.__dict__["axis"] = "X"
    with pytest.raises(HardwareError, match="no Grbl answers") as raised:
        connect_devices(rig, wiring_of(rig), camera=False)
    assert raised.value.messages[-1] == "all lights are off"
    assert dark(bench, "left", "right") == [True, True]


def test_a_mute_controller_does_not_keep_the_other_burning(bench, rig_on):
    set_fault(bench, "left", "drop", count=None)
    rig = rig_on(bench.ports)
    with pytest.raises(HardwareError, match="lights that may still be on: light1"):
        connect_devices(rig, wiring_of(rig), camera=False)
    assert dark(bench, "right") == [True]


def test_a_mere_look_switches_nothing(bench, rig_on):
    rig = rig_on(bench.ports)
    with connect_devices(rig, wiring_of(rig), camera=False, touch_lights=False):
        pass
    assert dark(bench, "left", "right") == [False, False]


def test_nothing_waits_for_a_mute_controller(bench, rig_on):
    """Opening the mute one alone takes three times its timeout."""
    set_fault(bench, "left", "drop", count=None)
    rig = rig_on(bench.ports)
    slower = edited(rig, "channels: 2, timeout_s: 0.5", "channels: 2, timeout_s: 3.0")
    started = bench.state()["time"]
    with pytest.raises(HardwareError, match="lights that may still be on: light1") as raised:
        switch_off(load_lights(slower))
    assert raised.value.messages[-2] == "controllers switched off: right"
    dark_at = max(t for t, name, _, level in trace(bench) if name == "right" and level == 0)
    assert dark_at - started < 3.0


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ("points: ", "points: 6, zzz: ", "expected a square"),
        ("name:", "nmae:", "unknown key"),
        ("camera:", "camera: [", "expected"),
        ("level: 200", "level: bright", "lights.light1.level"),
        ("driver: shot", "driver: shoot", "hardware.stage.driver"),
        ("channels: 2", "channels: 2, chanels: 2", "unknown key"),
    ],
)
def test_a_file_that_is_wrong_elsewhere_darkens_all_the_same(bench, rig_on, cli, old, new, reported):
    path = edited(rig_on(bench.ports), old, new)
    ran = cli("bench", "off", path)
    assert ran.status == 0, ran.err
    assert dark(bench, "left", "right") == [True, True]
    assert ran.out.endswith(" are off (left, right)\n")
    assert all(line.startswith("warning: ") for line in ran.err.splitlines())
    assert reported in ran.err


def test_a_controller_that_the_file_has_wrong_is_named_and_the_others_are_dark(bench, rig_on, cli):
    path = edited(rig_on(bench.ports), "left: {driver: ccs", "left: {driver: css")
    ran = cli("bench", "off", path)
    assert (ran.status, ran.out) == (2, "")
    assert dark(bench, "left", "right") == [False, True]
    assert "not switched off, because of errors in the file: controller left; correct them" in ran.err
    assert "controllers switched off: right" in ran.err
    assert "lights that may still be on: light1" in ran.err
    assert "warning: " in ran.err


@pytest.mark.parametrize(
    ("pairs", "burn"),
    [
        (("left: {driver: ccs", "left: {driver: css", "right: {driver: ccs", "right: {driver: css"), True),
        (("hardware:", "hadware:"), False),
    ],
)
def test_where_no_controller_can_be_read_it_says_what_to_do(bench, rig_on, pairs, burn):
    with pytest.raises(InputError, match="switch the controllers off by hand") as raised:
        load_lights(edited(rig_on(bench.ports), *pairs))
    assert ("lights that may be on: light1, light3" in raised.value.messages[-1]) == burn


def test_status_asks_every_device_although_some_are_silent(bench, rig_on, cli):
    set_fault(bench, "left", "drop", count=None)
    set_fault(bench, "stage", "drop", count=None)
    ran = cli("bench", "status", rig_on(bench.ports).source.path)
    assert ran.status == 3
    rows = {line.split("  ")[0]: line for line in ran.out.splitlines()[1:]}
    assert list(rows) == ["controller left", "controller right", "light light1", "light light3", "stage"]
    assert "no reply" in rows["controller left"]
    assert "status 00" in rows["controller right"] or "read_back yes" in rows["controller right"]
    assert rows["light light1"].endswith("its controller does not answer")
    assert rows["light light3"].endswith("right channel 2: on at level 90")
    assert "no reply" in rows["stage"]
    failed = [line.partition(":")[2].partition(":")[0].strip() for line in ran.err.splitlines() if "error" in line]
    assert failed == ["controller left", "stage"]
    assert dark(bench, "left", "right") == [False, False]


@pytest.mark.parametrize("command", [("status",), ("light", "light1", "--seconds", "0.1"), ("off",)])
def test_an_address_at_which_nothing_answers_is_a_device_that_failed(bench, rig_on, cli, command):
    path = rig_on({**bench.ports, "left": "socket://127.0.0.1:1"}).source.path
    ran = cli("bench", command[0], path, *command[1:])
    assert (ran.status, "cannot be reached" in ran.err) == (3, True)
