"""The simulated firmware of the stages, against the protocols' tables and what was recorded from a real Grbl."""

from __future__ import annotations

import re
from typing import Any

import pytest
from faulty_bench import FaultyShot, FaultyZaber, faulty
from grbl_recordings import BANNER, GREETING, HOLD, LOCKED, MOTION, SOFT_LIMIT, Recording

from lightopt.rig.simulated._firmware import SimulatedAxis
from lightopt.rig.simulated._stage_grbl import GrblFirmware
from lightopt.rig.simulated._stage_sigmakoki import GscFirmware, ShotFirmware
from lightopt.rig.simulated._stage_zaber import ZaberFirmware


def masked(report: bytes) -> bytes:
    """A report of a moving axis without its numbers."""
    return re.sub(rb"<(Run|Hold:1)\|MPos:-?\d+\.\d{3},0\.000,0\.000\|FS:\d+,0", rb"<\1|MPos|FS", report)


@pytest.mark.parametrize(
    "recording", [GREETING, SOFT_LIMIT, HOLD, MOTION], ids=["greeting", "soft limit", "hold", "motion"]
)
def test_grbl_answers_as_the_real_one_did(recording: Recording) -> None:
    settings, dialogue = recording
    grbl = GrblFirmware(settings=settings)
    now = 0.0
    assert grbl.poll(now).startswith(BANNER)
    grbl.feed(b"$X\n", now)
    for number, (pause, sent, answered) in enumerate(dialogue):
        now += pause
        got = grbl.feed(sent, now)
        assert masked(got) == masked(answered), f"step {number}: {sent!r} at {now:g} s"


def test_grbl_starts_locked_with_homing_enabled_and_homes_into_negative_space() -> None:
    grbl = GrblFirmware(settings={"22": 1, "20": 1}, axes={"X": {"stands": -30}}, home_speed=10.0)
    assert grbl.poll(0.0) == BANNER + LOCKED
    assert grbl.feed(b"?", 0.0).startswith(b"<Alarm|MPos:0.000,")
    assert grbl.feed(b"G1X-1F100\n", 0.0) == b"error:9\r\n"
    assert grbl.feed(b"$H\n", 1.0) == b""
    assert grbl.feed(b"?", 2.0) == b""  # no report while it seeks the switches
    assert grbl.poll(5.0).startswith(b"ok\r\n<Idle|MPos:-1.000,-1.000,-1.000|")
    assert grbl.positions(5.0) == {"X": -1.0, "Y": -1.0, "Z": -1.0}


def test_grbl_homing_without_it_enabled() -> None:
    assert GrblFirmware().feed(b"$H\n", 0.0).endswith(b"error:5\r\n")


def test_grbl_begins_a_move_when_the_one_before_is_done() -> None:
    grbl = GrblFirmware()
    grbl.poll(0.0)
    assert grbl.feed(b"G1X-10F600\nG1Y-10F600\n", 0.0) == b"ok\r\n"
    assert grbl.feed(b"?", 0.5).startswith(b"<Run|MPos:-4.167,0.000,")  # $110 allows 500 mm/min
    assert grbl.feed(b"?", 1.5).startswith(b"ok\r\n<Idle|MPos:-10.000,0.000,")
    assert grbl.feed(b"?", 1.6).startswith(b"<Run|MPos:-10.000,-0.833,")
    assert grbl.feed(b"?", 2.9).startswith(b"<Idle|MPos:-10.000,-10.000,")


def test_grbl_hold() -> None:
    grbl = GrblFirmware()
    grbl.feed(b"G1X-10F300\n", 0.0)
    grbl.feed(b"!", 1.0)
    assert grbl.feed(b"?", 1.01).startswith(b"<Hold:1|")
    assert grbl.feed(b"?", 2.0).startswith(b"<Hold:0|MPos:-5.000,")


def test_grbl_reset_in_hold_keeps_the_position_and_does_not_lock() -> None:
    grbl = GrblFirmware(settings={"22": 1})
    grbl.poll(0.0)
    grbl.feed(b"$X\nG1X-10F300\n", 0.0)
    grbl.feed(b"!", 1.0)
    assert grbl.feed(b"\x18", 2.0) == BANNER
    assert grbl.feed(b"?", 2.0).startswith(b"<Idle|MPos:-5.000,")


def test_grbl_hard_limit() -> None:
    grbl = GrblFirmware(axes={"X": {"low": -4.0}})
    grbl.poll(0.0)
    grbl.feed(b"G1X-10F300\n", 0.0)
    assert grbl.poll(1.0) == b"ALARM:1\r\n[MSG:Reset to continue]\r\n"
    assert grbl.feed(b"?$X\n", 2.0) == b""
    assert grbl.feed(b"\x18", 3.0) == BANNER + LOCKED
    assert grbl.positions(3.0)["X"] == -4.0


@pytest.mark.parametrize(
    ("line", "code"), [(b"G1X1", 22), (b"G1X", 2), (b"#", 1), (b"$foo", 3), (b"M3", 20), (b"X1F1", 20)]
)
def test_grbl_errors(line: bytes, code: int) -> None:
    grbl = GrblFirmware()
    grbl.poll(0.0)
    assert grbl.feed(line + b"\n", 0.0) == b"error:%d\r\n" % code


def answers(firmware: Any, now: float, *lines: bytes) -> list[bytes]:
    return [firmware.feed(line + b"\r\n", now) for line in lines]


def slow_shot(kind: Any = ShotFirmware, **options: Any) -> Any:
    """A SHOT at 1000 pulses/s."""
    shot = kind(**options)
    assert answers(shot, 0.0, b"D:1S100F1000R100", b"D:2S100F1000R100") == [b"OK\r\n"] * 2
    return shot


def test_shot_by_its_table() -> None:
    shot = ShotFirmware(axes={"1": {"stands": 300}, "2": {"stands": -20}})
    assert answers(shot, 0.0, b"Q:") == [b"         0,         0,K,K,R\r\n"]
    assert answers(shot, 0.0, b"D:1S100F1000R100", b"A:1+P9000", b"G:") == [b"OK\r\n"] * 3
    # moving: only stop and status
    assert answers(shot, 1.0, b"A:2+P5", b"G:", b"H:W") == [b"NG\r\n"] * 3
    assert answers(shot, 1.0, b"Q:") == [b"      1000,         0,X,K,B\r\n"]
    assert answers(shot, 2.0, b"L:E", b"Q:") == [b"OK\r\n", b"      2000,         0,K,K,R\r\n"]
    assert answers(shot, 2.0, b"H:W") == [b"OK\r\n"]
    assert answers(shot, 9.0, b"Q:") == [b"         0,         0,K,K,R\r\n"]
    assert shot.positions(9.0) == {"1": 0.0, "2": 0.0}
    assert answers(shot, 9.0, b"A:W+P1800-P2000", b"G:") == [b"OK\r\n"] * 2
    assert answers(shot, 19.0, b"Q:") == [b"      1800,     -2000,K,K,R\r\n"]
    assert answers(shot, 19.0, b"M:1+P500", b"G:") == [b"OK\r\n"] * 2
    assert answers(shot, 29.0, b"Q:") == [b"      2300,     -2000,K,K,R\r\n"]
    assert answers(shot, 29.0, b"?:V") == [b"V1.30\r\n"]


@pytest.mark.parametrize(
    "line", [b"G:", b"A:3+P1", b"A:1P1", b"A:W+P1", b"D:1S10F5R0", b"D:1S1F500001R0", b"X:1", b"FOO", b"L:9", b""]
)
def test_shot_refuses(line: bytes) -> None:
    assert answers(ShotFirmware(), 0.0, line) == [b"NG\r\n"]


def test_shot_stops_at_a_switch() -> None:
    shot = slow_shot(axes={"1": {"high": 500}, "2": {}})
    answers(shot, 0.0, b"A:1+P9000", b"G:")
    assert answers(shot, 0.4, b"Q:") == [b"       400,         0,K,K,B\r\n"]
    assert answers(shot, 1.0, b"Q:") == [b"       500,         0,K,L,R\r\n"]
    answers(shot, 1.0, b"A:1+P0", b"G:")
    assert answers(shot, 3.0, b"Q:") == [b"         0,         0,K,K,R\r\n"]


def test_gsc_is_silent_but_to_questions() -> None:
    gsc = GscFirmware(axes={"1": {"stands": 700}, "2": {}})
    answers(gsc, 0.0, b"D:2S100F1000R200S100F1000R200")
    assert answers(gsc, 0.0, b"M:1+P500", b"G", b"Q:") == [b"", b"", b"         0,         0,K,K,B\r\n"]
    assert answers(gsc, 1.0, b"Q:", b"?:V") == [b"       500,         0,K,K,R\r\n", b"V2.00\r\n"]
    for wrong in (b"A:1+P5", b"G:", b"M:1+P16777215", b"H:1", b"D:1S1F201R0S1F1R0", b"D:2S100F1000R200"):
        assert answers(gsc, 1.0, wrong, b"Q:") == [b"", b"       500,         0,X,K,R\r\n"]
    for right in (b"M:W-P16777214+P1", b"D:2S100F1000R200S100F1000R200", b"L:W"):
        assert answers(gsc, 1.0, right, b"Q:") == [b"", b"       500,         0,K,K,R\r\n"]


def test_gsc_stops_the_search_for_the_origin() -> None:
    gsc = GscFirmware(home_speed=100, axes={"1": {"stands": 1000}, "2": {"stands": 1000}})
    answers(gsc, 0.0, b"H:W-+")
    assert answers(gsc, 1.0, b"Q:")[0].endswith(b",B\r\n")
    answers(gsc, 1.0, b"L:W")
    assert answers(gsc, 1.0, b"Q:") == [b"-      100,-      100,K,K,R\r\n"]
    answers(gsc, 1.0, b"H:1-")
    assert answers(gsc, 20.0, b"Q:") == [b"         0,-      100,K,K,R\r\n"]


def checked(body: bytes) -> bytes:
    return b"@" + body + b":%02X\r\n" % (-sum(body) & 0xFF)


def test_zaber_by_its_table() -> None:
    zaber = ZaberFirmware(axes={"1": {"stands": 500}}, limits={"1": (0, 9000)}, home_speed=500)
    dialogue = [
        (0.0, b"/1 1 get pos", b"01 1 OK IDLE WR 0"),
        (0.0, b"/1 1 home", b"01 1 OK BUSY WR 0"),
        (0.5, b"/1 1 01 home:34", b"01 1 01 OK BUSY WR 0"),
        (9.0, b"/1 1 03:FB", b"01 1 03 OK IDLE -- 0"),
        (9.0, b"/1 1 00 get pos:2C", b"01 1 00 OK IDLE -- 0"),
        (9.0, b"/1 0", b"01 0 OK IDLE -- 0"),
        (9.0, b"/1 1 07 move abs 9001", b"01 1 07 RJ IDLE -- BADDATA"),
        (9.0, b"/1 1 07 fly", b"01 1 07 RJ IDLE -- BADCOMMAND"),
        (9.0, b"/1 5 get pos", b"01 0 RJ IDLE -- BADAXIS"),
        (9.0, b"/1 1 set maxspeed 1638", b"01 1 OK IDLE -- 0"),
        (9.0, b"/1 1 set maxspeed 0", b"01 1 RJ IDLE -- BADDATA"),
        (9.0, b"/1 1 move abs 1000", b"01 1 OK BUSY -- 0"),
        (9.5, b"/1 1 get pos", b"01 1 OK BUSY -- 500"),
        (9.5, b"/1 0 stop", b"01 0 OK IDLE -- 0"),
        (9.5, b"/1 0 get pos", b"01 0 OK IDLE -- 500"),
        (9.5, b"/1 0 warnings", b"01 0 OK IDLE -- 00"),
    ]
    for now, sent, answered in dialogue:
        assert zaber.feed(sent + b"\n", now) == checked(answered)
    assert zaber.feed(b"/1 1 00 get pos:2D\n", 9.0) == b""  # a wrong checksum is not answered
    assert zaber.feed(b"/2 1 get pos\n", 9.0) == b""  # nor what is for another device


def test_zaber_flags_a_stall_until_it_is_cleared() -> None:
    zaber: Any = FaultyZaber(axes={"1": {}})
    zaber.feed(b"/1 1 home\n", 0.0)
    zaber.inject("stall", {"share": 0.25}, 0.0)
    zaber.feed(b"/1 1 move abs 4000\n", 0.0)
    assert zaber.feed(b"/1 1 get pos\n", 9.0) == checked(b"01 1 OK IDLE FS 1000")
    assert zaber.feed(b"/1 1 warnings\n", 9.0) == checked(b"01 1 OK IDLE FS 01 FS")
    assert zaber.feed(b"/1 1 warnings clear\n", 9.0) == checked(b"01 1 OK IDLE -- 01 FS")


def test_lost_steps_are_reported_by_the_place_alone() -> None:
    shot = slow_shot(FaultyShot)
    shot.inject("lost_step", {"axis": "1", "steps": 30}, 0.0)
    answers(shot, 0.0, b"A:W+P100+P100", b"G:")
    assert answers(shot, 2.0, b"Q:") == [b"       100,       100,K,K,R\r\n"]
    assert shot.positions(2.0) == {"1": 70.0, "2": 100.0}


@pytest.mark.parametrize("kind", ["shot", "gsc", "grbl", "zaber"])
def test_power_cycle_forgets_the_origin(kind: str) -> None:
    axis = "X" if kind == "grbl" else "1"
    firmware: Any = faulty(kind, {"axes": {axis: {"stands": -50}}})
    firmware.poll(0.0)
    firmware.inject("power_cycle", {}, 1.0)
    assert firmware.positions(1.0)[axis] == -50
    if kind == "grbl":
        assert firmware.poll(1.0) == BANNER


@pytest.mark.parametrize("kind", ["shot", "gsc", "grbl", "zaber"])
def test_faults_and_options_that_are_not_known(kind: str) -> None:
    firmware: Any = faulty(kind, {})
    with pytest.raises(ValueError, match='no fault called "rust"; there is stall, limit, lost_step'):
        firmware.inject("rust", {}, 0.0)
    with pytest.raises(ValueError, match='no axis called "9"'):
        firmware.inject("stall", {"axis": "9"}, 0.0)
    with pytest.raises(ValueError, match="stall"):
        firmware.inject("stall", {"colour": 1}, 0.0)
    with pytest.raises(ValueError, match="found"):
        faulty(kind, {"axes": {"Q": {}}})
    with pytest.raises(ValueError, match=f"firmware {kind}"):
        faulty(kind, {"colour": 1})


def test_travel_at_constant_speed() -> None:
    axis = SimulatedAxis(stands=10.0)
    axis.move(100.0, 50.0, 1.0)
    assert [axis.count(now) for now in (0.0, 1.0, 2.0, 3.0, 9.0)] == [0.0, 0.0, 50.0, 100.0, 100.0]
    assert [axis.real(9.0), axis.moving(9.0)] == [110.0, False]
    axis.home(100.0, 10.0)
    assert (axis.moving(11.0), axis.homed) == (True, False)
    assert (axis.count(11.1), axis.real(11.1), axis.homed) == (0.0, 0.0, True)


def test_travel_that_stalls_and_says_that_it_moves() -> None:
    shot = slow_shot(FaultyShot)
    shot.inject("stall", {"busy": True, "share": 0.5, "axis": "1"}, 0.0)
    answers(shot, 0.0, b"A:1+P1000", b"G:")
    assert answers(shot, 99.0, b"Q:") == [b"       500,         0,K,K,B\r\n"]
    assert answers(shot, 99.0, b"L:E", b"Q:") == [b"OK\r\n", b"       500,         0,K,K,R\r\n"]
