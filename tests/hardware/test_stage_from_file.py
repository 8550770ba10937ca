"""Every word of the rig file about the stage, from the file to the bytes on the wire."""

from __future__ import annotations

import time

import pytest
from scripted import ScriptedPort

from lightopt.config import AxisConfig, StageDeviceConfig, load_part, load_rig
from lightopt.core.errors import HardwareError
from lightopt.core.transforms import Posture
from lightopt.rig.capture import CaptureOptions, connect_devices, make_plan, wiring_of
from lightopt.rig.devices._serial_ports import Port

HARDWARE = """\
hardware:
  controllers:
    blind: {{driver: template, port: COM8, channels: 2, template: {{set: "{{channel}}={{level}};"}}}}
  lights:
    light1: {{controller: blind, channel: 1, level: 200}}
    light3: {{controller: blind, channel: 2, level: 150}}
  stage:
    driver: {driver}
    port: COM9
    {stage}
  camera: {{driver: virtual}}
  timing: {{light_ms: 5, stage_ms: 5}}
"""
GSC = """\
elevation: {axis: "2", steps_per_deg: -40, zero: 100, home_sense: 1, speed_deg_per_s: 50}
    rotation: {axis: "1", steps_per_deg: 20, zero: -60, home_sense: -1, speed_deg_per_s: 200}"""
AT = b"%10d,%10d,K,K,%s\r\n"
DARK = [(b"1=0;", b""), (b"2=0;", b"")]


@pytest.fixture
def wired(tmp_path, monkeypatch):
    """The small rig with a stage, and scripts that the two ports play."""

    from fault_cases import make_rig

    def wired(dialogue, stage=GSC, driver="gsc", lights=DARK):
        path, part = make_rig(tmp_path)
        text = path.read_text(encoding="utf-8").partition("hardware:")[0]
        path.write_text(text + HARDWARE.format(driver=driver, stage=stage), encoding="utf-8")
        ports = {"COM8": ScriptedPort([*lights, *DARK]), "COM9": ScriptedPort(dialogue)}

        def open_url(port, **settings):
            ports[port].opened_with = settings
            return ports[port]

        monkeypatch.setattr("serial.serial_for_url", open_url)
        there = tuple(Port(name, "") for name in ports)
        monkeypatch.setattr("lightopt.rig.devices._serial_ports.serial_ports", lambda: there)
        return load_rig(path), load_part(part), ports["COM9"]

    return wired


def opened(rig, **options):
    return connect_devices(rig, wiring_of(rig), camera=False, **options)


def at(first, second, state=b"R"):
    return AT % (first, second, state)


HOME = [
    (b"Q:\r\n", at(-500, 20)),
    (b"H:W-+\r\n", b""),
    (b"Q:\r\n", at(-500, 20, b"B")),
    (b"Q:\r\n", at(-400, 10, b"B")),
    (b"Q:\r\n", at(0, 0)),
]
MOVE = [
    (b"Q:\r\n", at(0, 0)),
    (b"Q:\r\n", at(0, 0)),
    (b"D:2S400F4000R200S200F2000R200\r\n", b""),
    (b"Q:\r\n", at(0, 0)),
    (b"Q:\r\n", at(0, 0)),
    (b"M:W+P1740-P300\r\n", b""),  # 90° are 20 · 90 - 60, and 10° are -40 · 10 + 100
    (b"Q:\r\n", at(0, 0)),
    (b"G:\r\n", b""),
    (b"Q:\r\n", at(900, -100, b"B")),
    (b"Q:\r\n", at(1740, -300)),
]


def test_axis_steps_zero_sense_and_speed_reach_the_wire(wired):
    rig, _, script = wired([*HOME, *MOVE], stage=f"{GSC}\n    baud: 19200")
    with opened(rig) as devices:
        devices.home()
        assert devices.move_to(Posture(10.0, 90.0)).posture == Posture(10.0, 90.0)
    assert script.ended()
    assert script.opened_with["baudrate"] == 19200


def test_the_longest_time_of_homing_is_the_file_s(wired, monkeypatch):
    still = [(b"Q:\r\n", at(0, 0)), (b"H:W-+\r\n", b"")]
    seeking = [(b"Q:\r\n", at(-5, 5, b"B"))] * 500
    rig, _, _ = wired([*still, *seeking], stage=f"{GSC}\n    home_timeout_s: 0.2")
    with opened(rig) as devices:
        monkeypatch.setattr(devices.stage, "stop", lambda: devices.stage._dialogue.read())
        begun = time.monotonic()
        with pytest.raises(HardwareError, match=r"has not found its origin after 0\.2 s"):
            devices.home()
        assert time.monotonic() - begun < 60


def test_the_longest_wait_for_a_reply_is_the_file_s(wired):
    rig, _, _ = wired([(b"Q:\r\n", b"")] * 3, stage=f"{GSC}\n    timeout_s: 0.07")
    with pytest.raises(HardwareError, match=r"no reply after 0\.07 s"), opened(rig) as devices:
        devices.stage.state()


def test_no_word_of_the_file_is_left_without_a_test_here():
    assert set(AxisConfig.model_fields) == {"axis", "steps_per_deg", "zero", "home_sense", "speed_deg_per_s"}
    assert set(StageDeviceConfig.model_fields) == {
        *("driver", "port", "baud", "elevation", "rotation"),
        *("timeout_s", "home_timeout_s", "assume_referenced"),
    }


# --- a stage that cannot say that it was homed


def test_a_stage_that_cannot_say_that_it_was_homed_is_not_moved(wired):
    rig, _, script = wired([(b"Q:\r\n", at(0, 0))])
    with (
        pytest.raises(HardwareError, match=r"option 'home'.*lightopt bench home RIG.*assume_referenced"),
        opened(rig) as devices,
    ):
        devices.move_to(Posture(10.0, 90.0))
    assert script.ended()


def test_one_that_somebody_vouches_for_is_moved(wired):
    rig, _, script = wired([(b"Q:\r\n", at(0, 0)), *MOVE], stage=f"{GSC}\n    assume_referenced: true")
    with opened(rig) as devices:
        devices.move_to(Posture(10.0, 90.0))
    assert script.ended()


@pytest.mark.parametrize("home", [False, True])
def test_a_capture_is_refused_before_anything_is_lit(wired, home):
    rig, part, script = wired([] if home else [(b"Q:\r\n", at(0, 0))])
    plan = make_plan(rig, part, CaptureOptions(home=home))
    if home:
        with opened(rig, plan=plan):
            pass
    else:
        with pytest.raises(HardwareError, match="so it was not moved; home it") as raised:
            opened(rig, plan=plan)
        assert raised.value.messages[-1] == "all lights are off"
    assert script.ended()


def test_one_that_says_that_it_is_not_homed_is_not_vouched_for(wired):
    from lightopt.rig.devices._stage_zaber import frame

    said = b"@01 1 %02d OK IDLE WR 0\r\n"
    turn = 'rotation: {axis: "1", steps_per_deg: 20}\n    assume_referenced: true'
    rig, _, script = wired([(frame(1, 1, 1, "get pos"), said % 1)], stage=turn, driver="zaber")
    with pytest.raises(HardwareError, match="the stage has no reference position"), opened(rig) as devices:
        devices.move_to(Posture(0.0, 90.0))
    assert script.ended()
