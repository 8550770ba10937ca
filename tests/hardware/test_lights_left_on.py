"""Lights that an earlier run left on, while other devices of the rig are out of order."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from lightopt.capture import connect_devices, switch_off, wiring_of
from lightopt.config import RigConfig, load_rig
from lightopt.errors import HardwareError
from lightopt.virtualbench import BenchProcess

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks._fault_cases import make_rig

LIT = {"kind": "ccs", "options": {"channels": 2, "levels": {"1": 200, "2": 90}}}
HARDWARE = """\
hardware:
  controllers:
    left: {{driver: ccs, port: "{left}", channels: 2, timeout_s: 0.1}}
    right: {{driver: {driver}, port: "{right}", channels: 2, timeout_s: 0.1{template}}}
  lights:
    light1: {{controller: left, channel: 1, level: 200}}
    light3: {{controller: right, channel: 2, level: 150}}
  stage:
    driver: shot
    port: "{stage}"
    rotation: {{axis: "2", steps_per_deg: 100, speed_deg_per_s: 500}}
    timeout_s: 0.1
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


def off(rig):
    return switch_off(rig, wiring_of(rig))


def test_all_goes_dark_without_stage_and_camera(bench, rig_on):
    rig = rig_on({**bench.ports, "stage": "/dev/nowhere"})
    assert dark(bench, "left", "right") == [False, False]
    assert off(rig) == ()
    assert dark(bench, "left", "right") == [True, True]


@pytest.mark.parametrize(
    ("broken", "whole", "light"), [("left", "right", "light1"), ("right", "left", "light3")]
)
@pytest.mark.parametrize("how", ["mute", "no port"])
def test_one_controller_is_darkened_without_the_other(bench, rig_on, broken, whole, light, how):
    ports = dict(bench.ports)
    if how == "mute":
        bench.set_fault(broken, "drop", count=None)
    else:
        ports[broken] = "/dev/nowhere"
    with pytest.raises(HardwareError) as raised:
        off(rig_on(ports))
    assert dark(bench, whole) == [True]
    assert broken in raised.value.messages[0]
    assert raised.value.messages[-1] == f"lights that may still burn: {light}"


def test_a_channel_that_does_not_obey_is_named_and_the_others_are_dark(bench, rig_on):
    bench.set_fault("right", "deaf", channel=2)
    with pytest.raises(HardwareError, match="channel 2: not switched off") as raised:
        off(rig_on(bench.ports))
    assert raised.value.messages[-1] == "lights that may still burn: light3"
    assert bench.levels("right")[1] == 0
    assert dark(bench, "left") == [True]


def test_what_cannot_be_read_back_was_only_told(bench, rig_on):
    blind = ', template: {set: "W{channel}{level:03d}\\r\\n"}'
    assert off(rig_on(bench.ports, driver="template", template=blind)) == ("right",)


def test_a_stage_that_does_not_answer_leaves_nothing_burning(bench, rig_on):
    """As after kill -9 with a Grbl in alarm, which answers nothing."""
    bench.set_fault("stage", "drop", count=None)
    rig = rig_on(bench.ports)
    rig.hardware.stage.__dict__["driver"] = "grbl"
    rig.hardware.stage.rotation.__dict__["axis"] = "X"
    with pytest.raises(HardwareError, match="no Grbl answers") as raised:
        connect_devices(rig, wiring_of(rig), camera=False)
    assert raised.value.messages[-1] == "all lights are off"
    assert dark(bench, "left", "right") == [True, True]


def test_a_mute_controller_does_not_keep_the_other_burning(bench, rig_on):
    bench.set_fault("left", "drop", count=None)
    rig = rig_on(bench.ports)
    with pytest.raises(HardwareError, match="lights that may still burn: light1"):
        connect_devices(rig, wiring_of(rig), camera=False)
    assert dark(bench, "right") == [True]


def test_a_mere_look_switches_nothing(bench, rig_on):
    rig = rig_on(bench.ports)
    with connect_devices(rig, wiring_of(rig), camera=False, touch_lights=False):
        pass
    assert dark(bench, "left", "right") == [False, False]


def test_nothing_waits_for_a_mute_controller(bench, rig_on):
    """Opening the mute one alone takes three times its timeout."""
    bench.set_fault("left", "drop", count=None)
    rig = rig_on(bench.ports)
    rig.hardware.controllers["left"].__dict__["timeout_s"] = 1.0
    started = bench.state()["time"]
    with pytest.raises(HardwareError, match="lights that may still burn: light1"):
        off(rig)
    dark_at = max(t for t, name, _, level in bench.trace() if name == "right" and level == 0)
    assert dark_at - started < 1.0
