"""Every byte between the stage drivers and their devices, in dialogues written down from the protocols."""

from __future__ import annotations

import pytest
from grbl_recordings import BANNER
from scripted import Dialogue, play

from lightopt.core.errors import HardwareError, InputError
from lightopt.core.transforms import Posture
from lightopt.rig.devices import Axis, open_stage
from lightopt.rig.devices._stage import Stage
from lightopt.rig.devices._stage_zaber import frame

TILT = (-45.0, 45.0)
TURN = (0.0, 360.0)


def stage(driver: str, axes: list[Axis]) -> Stage:
    return open_stage(driver, port="COM9", axes=axes, timeout_s=0.05)


def pulses(*, rotation: float = -50.0) -> list[Axis]:
    """100 pulses per degree of tilt, the turn counted backwards."""
    return [
        Axis("elevation", "1", TILT, steps_per_deg=100, speed_deg_per_s=50),
        Axis("rotation", "2", TURN, steps_per_deg=rotation, speed_deg_per_s=100),
    ]


SHOT_MOVE: Dialogue = [
    (b"Q:\r\n", b"          0,          0,K,K,R\r\n"),
    (b"D:1S500F5000R200\r\n", b"OK\r\n"),
    (b"D:2S500F5000R200\r\n", b"OK\r\n"),
    (b"A:W+P1800-P2000\r\n", b"OK\r\n"),
    (b"G:\r\n", b"OK\r\n"),
    (b"Q:\r\n", b"        900,      -1000,K,K,B\r\n"),
    (b"Q:\r\n", b"       1800,-      2000,K,K,R\r\n"),
]


def test_shot_moves_both_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(monkeypatch, SHOT_MOVE)
    state = stage("shot", pulses()).move_to(Posture(18.0, 40.0))
    assert (state.posture, state.moving, state.alarm) == (Posture(18.0, 40.0), False, None)
    assert script.ended()
    assert script.opened_with["baudrate"] == 9600
    assert script.opened_with["rtscts"] is True
    assert script.opened_with["exclusive"] is True


def test_shot_moves_only_the_axis_that_is_not_there_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            *SHOT_MOVE,
            (b"Q:\r\n", b"       1800,      -2000,K,K,R\r\n"),
            (b"A:2-P9000\r\n", b"OK\r\n"),
            (b"G:\r\n", b"OK\r\n"),
            (b"Q:\r\n", b"       1800,      -9000,K,K,R\r\n"),
        ],
    )
    shot = stage("shot", pulses())
    shot.move_to(Posture(18.0, 40.0))
    assert shot.move_to(Posture(18.0, 180.0)).posture == Posture(18.0, 180.0)
    assert script.ended()


def test_shot_is_there_already(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(monkeypatch, [(b"Q:\r\n", b"          0,          0,K,K,R\r\n")])
    assert stage("shot", pulses()).move_to(Posture(0.0, 0.0)).posture == Posture(0.0, 0.0)
    assert script.ended()


def test_shot_homes(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            (b"Q:\r\n", b"        100,        -20,K,K,R\r\n"),
            (b"H:W\r\n", b"OK\r\n"),
            (b"Q:\r\n", b"         50,        -10,K,K,B\r\n"),
            (b"Q:\r\n", b"          0,          0,K,K,R\r\n"),
            (b"Q:\r\n", b"          0,          0,K,K,R\r\n"),
        ],
    )
    shot = stage("shot", pulses())
    shot.home()
    assert shot.state().referenced is True
    assert script.ended()


def test_shot_that_was_just_switched_on_is_not_taken_for_homed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It counts 0 where it stands, and may say that it is ready for a moment after the command."""
    at_0 = b"          0,          0,K,K,"
    script = play(
        monkeypatch,
        [
            (b"Q:\r\n", at_0 + b"R\r\n"),
            (b"H:W\r\n", b"OK\r\n"),
            (b"Q:\r\n", at_0 + b"R\r\n"),
            (b"Q:\r\n", b"        -90,          0,K,K,B\r\n"),
            (b"Q:\r\n", at_0 + b"R\r\n"),
        ],
    )
    stage("shot", pulses()).home()
    assert script.ended()


def test_shot_says_its_version_and_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            (b"?:V\r\n", b"V1.30\r\n"),
            (b"L:E\r\n", b"OK\r\n"),
            (b"Q:\r\n", b"          3,          0,K,K,B\r\n"),
            (b"Q:\r\n", b"          4,          0,K,K,R\r\n"),
        ],
    )
    shot = stage("shot", pulses())
    assert shot.identify() == {"driver": "shot", "port": "COM9", "version": "V1.30"}
    shot.stop()
    assert script.ended()


def test_shot_says_no_and_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            *SHOT_MOVE[:4],
            (b"G:\r\n", b"NG\r\n"),
            (b"L:E\r\n", b"OK\r\n"),
            (b"Q:\r\n", b"          0,          0,K,K,R\r\n"),
        ],
    )
    with pytest.raises(HardwareError) as failed:
        stage("shot", pulses()).move_to(Posture(18.0, 40.0))
    text = str(failed.value)
    assert "stage (shot) on COM9: refused (NG)" in text
    assert 'sent "G:\\r\\n", got "NG\\r\\n"' in text
    assert "lightopt bench home" in text
    assert script.ended()


def test_shot_never_sends_go_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its reply is lost; whether it was taken shows in the position."""
    script = play(monkeypatch, [*SHOT_MOVE[:4], (b"G:\r\n", b""), (b"Q:\r\n", b"       1800,      -2000,K,K,R\r\n")])
    shot = stage("shot", pulses())
    assert shot.move_to(Posture(18.0, 40.0)).posture == Posture(18.0, 40.0)
    assert any("not sent again" in event.what for event in shot.events)
    assert not any(event.retry for event in shot.events)
    assert script.ended()


def test_gsc_goes_from_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    here = b"        100,-        20,K,K,R\r\n"
    script = play(
        monkeypatch,
        [
            (b"Q:\r\n", here),
            (b"Q:\r\n", here),
            (b"D:2S500F5000R200S500F5000R200\r\n", b""),
            (b"Q:\r\n", here),
            (b"Q:\r\n", here),
            (b"M:W+P1700-P1980\r\n", b""),
            (b"Q:\r\n", here),
            (b"G:\r\n", b""),
            (b"Q:\r\n", b"        100,-        20,K,K,B\r\n"),
            (b"Q:\r\n", b"       1800,-      2000,K,K,R\r\n"),
        ],
    )
    assert stage("gsc", pulses()).move_to(Posture(18.0, 40.0)).posture == Posture(18.0, 40.0)
    assert script.ended()
    assert script.opened_with["rtscts"] is False


def test_gsc_homes_in_the_sense_that_is_configured(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            (b"Q:\r\n", b"-    1000,        20,K,K,R\r\n"),
            (b"H:W-+\r\n", b""),
            (b"Q:\r\n", b"-    1000,        20,K,K,B\r\n"),
            (b"Q:\r\n", b"-     500,        10,K,K,B\r\n"),
            (b"Q:\r\n", b"         0,         0,K,K,R\r\n"),
        ],
    )
    tilt, turn = pulses()
    other = Axis("rotation", "2", TURN, steps_per_deg=turn.steps_per_deg, home_sense=1)
    stage("gsc", [tilt, other]).home()
    assert script.ended()


def test_gsc_reads_in_ack1_that_it_was_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    here = b"         0,         0,K,K,R\r\n"
    refused = b"         0,         0,X,K,R\r\n"
    script = play(
        monkeypatch,
        [
            *[(b"Q:\r\n", here)] * 2,
            (b"D:2S500F5000R200S500F5000R200\r\n", b""),
            *[(b"Q:\r\n", here)] * 2,
            (b"M:W+P1800-P2000\r\n", b""),
            (b"Q:\r\n", refused),
            (b"L:E\r\n", b""),
            *[(b"Q:\r\n", here)] * 2,
        ],
    )
    with pytest.raises(HardwareError, match=r"refused \(ACK1 is X\).*\"M:W\+P1800-P2000"):
        stage("gsc", pulses()).move_to(Posture(18.0, 40.0))
    assert script.ended()


SETTINGS = (
    b"$10=1\r\n$13=0\r\n$20=1\r\n$22=1\r\n$100=250.000\r\n$101=100.000\r\n$102=250.000\r\n"
    b"$110=3000.000\r\n$111=6000.000\r\n$112=500.000\r\n$130=100.000\r\n$131=400.000\r\n$132=200.000\r\nok\r\n"
)


def degrees() -> list[Axis]:
    return [
        Axis("elevation", "X", TILT, zero=-50, speed_deg_per_s=30),
        Axis("rotation", "Y", TURN, zero=-380, speed_deg_per_s=40),
    ]


def report(state: str, x: float, y: float) -> bytes:
    return f"<{state}|MPos:{x:.3f},{y:.3f},0.000|FS:0,0>\r\n".encode()


def test_grbl_moves_in_machine_coordinates(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            (b"?", BANNER),
            (b"?", report("Idle", -50, -380)),
            (b"$$\n", SETTINGS),
            # 30 and 40 degrees in a second: 50 mm/s along the way
            (b"G90G94G21G53G1X-20.000Y-340.000F3000.0\n", b"ok\r\n"),
            (b"?", report("Idle", -50, -380)),
            (b"?", report("Run", -30, -350)),
            (b"?", report("Idle", -20, -340)),
        ],
    )
    state = stage("grbl", degrees()).move_to(Posture(30.0, 40.0))
    assert state.posture == Posture(30.0, 40.0)
    assert script.ended()
    assert script.opened_with["baudrate"] == 115200


def test_grbl_asks_no_more_after_a_soft_limit_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would not answer; and a reset would clear what a person should see."""
    script = play(
        monkeypatch,
        [
            (b"?", report("Idle", -50, -380)),
            (b"?", report("Idle", -50, -380)),
            (b"$$\n", SETTINGS),
            (b"G90G94G21G53G1X-20.000F1800.0\n", b"ALARM:2\r\n[MSG:Reset to continue]\r\n"),
        ],
    )
    grbl = stage("grbl", degrees())
    with pytest.raises(HardwareError, match=r"ALARM:2 \(soft limit"):
        grbl.move_to(Posture(30.0, 0.0))
    state = grbl.state()
    assert state.referenced is False
    assert "answers nothing until it is reset" in (state.alarm or "")
    with pytest.raises(HardwareError, match="was not moved: alarm: "):
        grbl.move_to(Posture(0.0, 0.0))
    with pytest.raises(HardwareError, match="must be reset before it can be homed"):
        grbl.home()
    assert script.ended()


def test_grbl_meets_a_switch_while_it_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The alarm has stopped it; it is not reset."""
    script = play(
        monkeypatch, [(b"?", report("Run", -3, -5)), (b"!", b""), (b"?", b"ALARM:1\r\n[MSG:Reset to continue]\r\n")]
    )
    grbl = stage("grbl", degrees())
    grbl.stop()
    assert "ALARM:1 (hard limit" in (grbl.state().alarm or "")
    assert script.ended()


def test_grbl_homes_where_homing_is_enabled(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            (b"?", report("Alarm", 0, 0)),
            (b"?", report("Alarm", 0, 0)),
            (b"$$\n", SETTINGS),
            (b"$H\n", b"ok\r\n"),
            (b"?", report("Idle", -1, -1)),
        ],
    )
    stage("grbl", degrees()).home()
    assert script.ended()


def test_grbl_is_reset_at_once_while_it_seeks_its_switches(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would neither report nor hold: asking first would let it run on for a second."""
    script = play(
        monkeypatch,
        [
            (b"?", report("Alarm", 0, 0)),
            (b"?", report("Alarm", 0, 0)),
            (b"$$\n", SETTINGS),
            (b"$H\n", b"error:"),  # cut short by Ctrl-C
            (b"\x18", b"ALARM:6\r\n" + BANNER),
            (b"?", report("Alarm", -3, -5)),
        ],
    )
    grbl = stage("grbl", degrees())
    link, read = grbl._link, grbl._link.read

    def interrupted(**options: object) -> bytes:
        if options.get("after") == b"$H\n":
            link.discard()
            raise KeyboardInterrupt
        return read(**options)  # type: ignore[arg-type]

    monkeypatch.setattr(link, "read", interrupted)
    with pytest.raises(KeyboardInterrupt):
        grbl.home()
    assert script.ended()
    assert grbl._lost is not None


def test_grbl_does_not_home_where_homing_is_not_enabled(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(
        monkeypatch,
        [
            (b"?", report("Idle", 0, 0)),
            (b"?", report("Idle", 0, 0)),
            (b"$$\n", SETTINGS.replace(b"$22=1", b"$22=0").replace(b"$20=1", b"$20=0")),
            # it is stopped after any failure, and stopping is a hold and a reset
            (b"!", b""),
            (b"?", report("Hold:0", 0, 0)),
            (b"\x18", BANNER),
            (b"?", report("Idle", 0, 0)),
        ],
    )
    with pytest.raises(HardwareError, match=r"homing is not enabled \(\$22=0\)"):
        stage("grbl", degrees()).home()
    assert script.ended()


def test_grbl_refuses_a_target_outside_its_travel_before_it_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    script = play(monkeypatch, [(b"?", report("Idle", -1, -1)), (b"?", report("Idle", -1, -1)), (b"$$\n", SETTINGS)])
    tilt, _ = degrees()
    turn = Axis("rotation", "Y", TURN, zero=0)
    with pytest.raises(InputError, match=r"rotation: Y10\.000 lies outside Grbl's travel -400 … 0 \(\$131"):
        stage("grbl", [tilt, turn]).move_to(Posture(0.0, 10.0))
    assert script.ended()


def test_grbl_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lightopt.rig.devices._stage_grbl._BANNER_S", 0.05)
    monkeypatch.setattr("lightopt.rig.devices._stage_grbl._LISTEN_S", 0.02)
    script = play(monkeypatch, [(b"?", b"")] * 99)
    with pytest.raises(HardwareError, match="no Grbl answers: wrong port or baud rate"):
        stage("grbl", degrees())
    assert not script.ended()


def microsteps() -> list[Axis]:
    return [Axis("rotation", "1", TURN, steps_per_deg=1000, speed_deg_per_s=100)]


def test_zaber_homes_and_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    with_checksum = b"01 1 01 OK IDLE WR 0"
    spoken = [
        (b"home", b"OK BUSY WR 0"),
        (b"get pos", b"OK BUSY WR -40"),
        (b"get pos", b"OK IDLE -- 0"),
        (b"get pos", b"OK IDLE -- 0"),
        (b"get limit.min", b"OK IDLE -- 0"),
        (b"get limit.max", b"OK IDLE -- 360000"),
        (b"get maxspeed", b"OK IDLE -- 153600"),
        (b"set maxspeed 163840", b"OK IDLE -- 0"),
        (b"move abs 82000", b"OK BUSY -- 0"),
        (b"get pos", b"OK BUSY -- 41000"),
        (b"get pos", b"OK IDLE -- 82000"),
    ]
    dialogue = [numbered(number, *words) for number, words in enumerate(spoken, start=2)]
    dialogue[3] = (dialogue[3][0], b"#01 1 a comment\r\n!01 1 IDLE --\r\n" + dialogue[3][1])
    script = play(
        monkeypatch, [(b"/1 1 01 get pos:2B\n", b"@" + with_checksum + b":" + lrc(with_checksum) + b"\r\n"), *dialogue]
    )
    zaber = stage("zaber", microsteps())
    zaber.home()
    assert zaber.move_to(Posture(0.0, 82.0)).posture == Posture(0.0, 82.0)
    assert script.ended()
    assert script.opened_with["baudrate"] == 115200


def test_zaber_frames_are_those_of_its_makers_library() -> None:
    assert frame(1, 1, 0, "get pos") == b"/1 1 00 get pos:2C\n"
    assert frame(1, 1, 1, "home") == b"/1 1 01 home:34\n"
    assert frame(1, 1, 3, "") == b"/1 1 03:FB\n"


def lrc(body: bytes) -> bytes:
    """The checksum once more, as the protocol's description has it."""
    total = 0
    for value in body:
        total = (total + value) & 0xFF
    return f"{(0x100 - total) & 0xFF:02X}".encode()


@pytest.mark.parametrize(
    ("reason", "words"),
    [("BADDATA", "the value is wrong or out of range"), ("PARKED", "the device is parked"), ("NEWER", "unknown")],
)
def test_zaber_says_why_it_rejects(monkeypatch: pytest.MonkeyPatch, reason: str, words: str) -> None:
    replies = [b"OK IDLE -- 0", b"OK IDLE -- 0", b"OK IDLE -- 360000", b"OK IDLE -- 163840"]
    commands = [b"get pos", b"get limit.min", b"get limit.max", b"get maxspeed", b"move abs 82000"]
    dialogue = [
        numbered(number, command, reply)
        for number, (command, reply) in enumerate(
            zip(commands, [*replies, b"RJ IDLE -- " + reason.encode()], strict=True), start=1
        )
    ]
    stop = b"1 0 06 stop"
    dialogue.append((b"/" + stop + b":" + lrc(stop) + b"\n", b"@01 0 06 OK IDLE -- 0\r\n"))
    dialogue.append(numbered(7, b"get pos", b"OK IDLE -- 0"))
    script = play(monkeypatch, dialogue)
    with pytest.raises(HardwareError, match=f"{reason} \\({words}"):
        stage("zaber", microsteps()).move_to(Posture(0.0, 82.0))
    assert script.ended()


def numbered(number: int, command: bytes, reply: bytes) -> tuple[bytes, bytes]:
    sent = b"1 1 %02d %s" % (number, command)
    return b"/" + sent + b":" + lrc(sent) + b"\n", b"@01 1 %02d %s\r\n" % (number, reply)


@pytest.mark.parametrize(
    ("warning", "alarm", "referenced"),
    [
        ("--", None, True),
        ("WR", None, False),
        ("WH", None, False),
        ("FS", "FS (stalled and stopped)", True),
        ("WL", "WL (a limit sensor ended a move", True),
        ("WV", None, True),
    ],
)
def test_zaber_warnings(monkeypatch: pytest.MonkeyPatch, warning: str, alarm: str | None, referenced: bool) -> None:
    play(monkeypatch, [numbered(1, b"get pos", b"OK IDLE %s 5" % warning.encode())])
    zaber = stage("zaber", microsteps())
    state = zaber.state()
    assert state.referenced is referenced
    assert (state.alarm is None) if alarm is None else (alarm in (state.alarm or ""))
    assert ("WV (the supply voltage" in "".join(e.what for e in zaber.events)) is (warning == "WV")


def test_zaber_passes_over_a_late_reply_and_asks_again_after_a_wrong_checksum(monkeypatch: pytest.MonkeyPatch) -> None:
    sent, _ = numbered(1, b"get pos", b"")
    again, _ = numbered(2, b"get pos", b"")
    play(
        monkeypatch,
        [(sent, b"@01 1 77 OK IDLE -- 999\r\n@01 1 01 OK IDLE -- 5:00\r\n"), (again, b"@01 1 02 OK IDLE -- 5000\r\n")],
    )
    zaber = stage("zaber", microsteps())
    assert zaber.state().posture == Posture(0.0, 5.0)
    assert [event.retry for event in zaber.events].count(True) == 1


@pytest.mark.parametrize("driver", ["shot", "gsc", "grbl", "zaber"])
def test_out_of_range_sends_nothing(monkeypatch: pytest.MonkeyPatch, driver: str) -> None:
    greeting = [(b"?", report("Idle", 0, 0))] if driver == "grbl" else []
    axes = degrees() if driver == "grbl" else pulses()
    script = play(monkeypatch, greeting)
    device = stage(driver, axes)
    for posture, words in (
        (Posture(45.1, 0.0), r"elevation: 45\.1° lies outside the rig's range -45° … 45°"),
        (Posture(0.0, -1.0), r"rotation: -1° lies outside the rig's range 0° … 360°"),
        (Posture(float("nan"), 0.0), "elevation: nan° lies outside"),
    ):
        with pytest.raises(InputError, match=words):
            device.move_to(posture)
    assert script.ended()


def test_an_axis_that_the_stage_lacks_stands_at_0(monkeypatch: pytest.MonkeyPatch) -> None:
    play(monkeypatch, [])
    with pytest.raises(InputError, match=r"elevation: 5° was requested, but hardware\.stage has no elevation axis"):
        stage("zaber", microsteps()).move_to(Posture(5.0, 10.0))


@pytest.mark.parametrize(
    ("driver", "axes", "words"),
    [
        ("shot", [Axis("rotation", "1", TURN, steps_per_deg=0.01, speed_deg_per_s=1)], "takes 1 to 500000"),
        ("gsc", [Axis("rotation", "1", TURN, steps_per_deg=400, speed_deg_per_s=90)], "takes 1 to 20000"),
        (
            "gsc",
            [
                Axis("elevation", "1", TILT, steps_per_deg=1, speed_deg_per_s=10),
                Axis("rotation", "2", TURN, steps_per_deg=400, speed_deg_per_s=10),
            ],
            "different ranges of the controller",
        ),
        ("zaber", [Axis("elevation", "1", TILT), Axis("rotation", "1/1", TURN)], "same axis"),
    ],
)
def test_axes_that_a_device_cannot_have(
    monkeypatch: pytest.MonkeyPatch, driver: str, axes: list[Axis], words: str
) -> None:
    play(monkeypatch, [])
    with pytest.raises(InputError, match=words):
        stage(driver, axes)
