"""CCS @ frames, byte for byte.

The frames in GOLDEN stand in public sources: makers' examples, drivers in use, the test of a real PD3-3024-3-EI.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from faulty_bench import FaultyCcs
from hypothesis import given, strategies as st
from scripted import scripted_link

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices import LIGHT_DRIVERS, LightSettings
from lightopt.rig.devices._device import RefusedError, ReplyError
from lightopt.rig.devices._light_ccs import CcsController
from lightopt.rig.simulated._light_ccs import CcsFirmware

LIGHTS = LightSettings("main", "COM7")

GOLDEN = {
    "intensity 255 of channel 1": b"@00F25582",
    "intensity 125 of channel 2": b"@01F1257F",
    "intensity 0 of channel 1": b"@00F00076",
    "on, channel 1": b"@00L11D",
    "off, channel 1": b"@00L01C",
    "on, channel 1, with unit": b"@00L1007D",
    "off, channel 1, with unit": b"@00L0007C",
    "intensity 255 of channel 1, with unit": b"@00F25500E2",
    "intensity 12 of channel 1, with unit": b"@00F01200D9",
    "mode S00 of channel 2": b"@01S0054",
    "mode S01 of channel 1": b"@00S0154",
    "settings of channel 2": b"@01MEE",
    "unit status": b"@00CE3",
}


def checked(body: bytes) -> bytes:
    return body + b"%02X\r\n" % (sum(body) % 256)


STATUS = (b"@00CE3\r\n", b"@00O004F\r\n")
SETTINGS = (b"@00MED\r\n", checked(b"@00OF000.S00.L0"))
OK1, OK2 = b"@00OEF\r\n", b"@01OF0\r\n"


@pytest.mark.parametrize("frame", GOLDEN.values(), ids=GOLDEN)
def test_the_firmware_knows_the_golden_frames(frame: bytes) -> None:
    reply = CcsFirmware().feed(frame + b"\r\n", 0.0)
    assert reply[:4] == frame[:3] + b"O"
    assert reply == checked(reply[:-4])


def test_the_firmware_takes_both_dialects_mixed() -> None:
    firmware = CcsFirmware(on=False)
    assert firmware.feed(b"@00F01200D9\r\n@00L11D\r\n", 0.0) == OK1 + OK1
    assert firmware.levels()[1] == 12 / 255


def test_lan_dialogue(monkeypatch: pytest.MonkeyPatch) -> None:
    link, port = scripted_link(
        monkeypatch,
        [
            STATUS,
            SETTINGS,
            (b"@00F25582\r\n", OK1),
            (b"@00L11D\r\n", OK1),
            (b"@00MED\r\n", checked(b"@00OF255.S00.L1")),
            (b"@01F1257F\r\n", OK2),
            (checked(b"@01L1"), OK2),
            (b"@01MEE\r\n", checked(b"@01OF125.S00.L1")),
            (b"@01MEE\r\n", checked(b"@01OF125.S00.L1")),
            (b"@00F00076\r\n", OK1),
            (b"@00L01C\r\n", OK1),
            (b"@00MED\r\n", checked(b"@00OF000.S00.L0")),
            (b"@00MED\r\n", checked(b"@00OF077.S00.L0")),
            STATUS,
        ],
    )
    controller = CcsController(link, LIGHTS)
    controller.set_level(1, 255)
    controller.set_level(2, 125)
    assert controller.read_level(2) == 125
    controller.set_level(1, 0)
    assert controller.read_level(1) == 0  # switched off, whatever the intensity
    assert controller.identify() == {"driver": "ccs", "port": "COM7", "status": "00", "read_back": "yes"}
    controller.close()
    assert (port.dialogue, port.closed, controller.events) == ([], True, [])


def test_serial_dialogue(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replies come with or without the unit number."""
    link, port = scripted_link(
        monkeypatch,
        [
            (checked(b"@00C00"), b"@00O004F\r\n"),
            (checked(b"@00M00"), checked(b"@00OF000.S00.L000")),
            (b"@00F25500E2\r\n", OK1),
            (b"@00L1007D\r\n", checked(b"@00O00")),
            (checked(b"@00M00"), checked(b"@00OF255.S00.L1")),
            (checked(b"@00F00000"), OK1),
            (b"@00L0007C\r\n", OK1),
            (checked(b"@00M00"), checked(b"@00OF000.S00.L0")),
        ],
    )
    controller = CcsController(link, replace(LIGHTS, dialect="serial"))
    controller.set_level(1, 255)
    controller.set_level(1, 0)
    assert port.dialogue == []


def test_four_digits_where_the_levels_have_them(monkeypatch: pytest.MonkeyPatch) -> None:
    link, port = scripted_link(
        monkeypatch,
        [
            STATUS,
            (b"@00MED\r\n", checked(b"@00OF0000.S00.L0")),
            (checked(b"@00F1023"), OK1),
            (b"@00L11D\r\n", OK1),
            (b"@00MED\r\n", checked(b"@00OF1023.S00.L1")),
        ],
    )
    CcsController(link, replace(LIGHTS, top_level=1023)).set_level(1, 1023)
    assert port.dialogue == []


@pytest.mark.parametrize(
    ("code", "words"),
    [(b"01", "does not know the command"), (b"03", "out of its range"), (b"77", r"it refuses \(NG 77\)")],
)
def test_refusals_in_words_and_never_sent_again(monkeypatch: pytest.MonkeyPatch, code: bytes, words: str) -> None:
    link, port = scripted_link(monkeypatch, [STATUS, SETTINGS, (b"@00F25582\r\n", checked(b"@00N" + code))])
    controller = CcsController(link, LIGHTS)
    with pytest.raises(RefusedError, match=f"light controller main on COM7: .*{words}.*@00F25582.*@00N{code.decode()}"):
        controller.set_level(1, 255)
    assert (port.dialogue, sum(event.retry for event in link.events)) == ([], 0)


SPOILT = [
    (None, "no reply after 0.02 s"),
    (b"@00OE", "the reply is incomplete"),
    (b"@00OEE\r\n", "wrong checksum"),
    (b"@01OF0\r\n", "for another channel"),
    (b"\xff\xfe@00OEF\r\n", "is not a frame"),
    (b"hello\r\n", "is not a frame"),
    (checked(b"@00OF255.S00.L1"), "to another command"),
    (checked(b"@00N02"), "damaged"),
]


@pytest.mark.parametrize(("reply", "words"), SPOILT)
def test_a_spoilt_reply_is_requested_again_and_reported(
    monkeypatch: pytest.MonkeyPatch, reply: bytes | None, words: str
) -> None:
    link, port = scripted_link(
        monkeypatch,
        [
            STATUS,
            SETTINGS,
            (b"@00F25582\r\n", reply),
            (b"@00F25582\r\n", OK1),
            (b"@00L11D\r\n", OK1),
            (b"@00MED\r\n", checked(b"@00OF255.S00.L1")),
        ],
    )
    controller = CcsController(link, LIGHTS)
    controller.set_level(1, 255)
    assert port.dialogue == []
    (event,) = [e for e in controller.events if e.retry]
    assert event.port == "COM7"
    assert words in event.what
    assert "sent again (1 of 2)" in event.what


@pytest.mark.parametrize(("reply", "words"), SPOILT)
def test_three_attempts_and_no_more(monkeypatch: pytest.MonkeyPatch, reply: bytes | None, words: str) -> None:
    link, port = scripted_link(monkeypatch, [STATUS, SETTINGS, *[(b"@00F25582\r\n", reply)] * 3])
    controller = CcsController(link, LIGHTS)
    with pytest.raises(ReplyError, match=f"{words}.*sent 3 times"):
        controller.set_level(1, 255)
    assert (port.dialogue, sum(event.retry for event in link.events)) == ([], 2)


def test_a_dead_device_gets_one_attempt_until_it_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Darkening: the switch is told off even if the intensity was not acknowledged."""
    link, port = scripted_link(
        monkeypatch,
        [
            STATUS,
            SETTINGS,
            *[(b"@00F00076\r\n", None)] * 3,
            (b"@00L01C\r\n", None),
            (b"@00CE3\r\n", b"@00O004F\r\n"),
            *[(b"@00CE3\r\n", None)] * 3,
        ],
    )
    controller = CcsController(link, LIGHTS)
    with pytest.raises(ReplyError, match="no reply"):
        controller.set_level(1, 0)
    controller.identify()
    with pytest.raises(ReplyError, match="sent 3 times"):
        controller.identify()
    assert port.dialogue == []


def test_a_refused_intensity_does_not_keep_the_light_on(monkeypatch: pytest.MonkeyPatch) -> None:
    link, port = scripted_link(
        monkeypatch, [STATUS, SETTINGS, (b"@00F00076\r\n", checked(b"@00N01")), (b"@00L01C\r\n", OK1)]
    )
    with pytest.raises(RefusedError):
        CcsController(link, LIGHTS).set_level(1, 0)
    assert port.dialogue == []


@pytest.mark.parametrize("held", [b"F124.S00.L1", b"F125.S00.L0"])
def test_what_it_holds_is_verified(monkeypatch: pytest.MonkeyPatch, held: bytes) -> None:
    link, _ = scripted_link(
        monkeypatch,
        [STATUS, SETTINGS, (b"@01F1257F\r\n", OK2), (checked(b"@01L1"), OK2), (b"@01MEE\r\n", checked(b"@01O" + held))],
    )
    with pytest.raises(HardwareError, match=r"channel 2 was set to 125 but holds 12[45] and is switched o"):
        CcsController(link, LIGHTS).set_level(2, 125)


def test_a_channel_that_waits_for_triggers(monkeypatch: pytest.MonkeyPatch) -> None:
    link, _ = scripted_link(
        monkeypatch,
        [
            STATUS,
            SETTINGS,
            (b"@01F1257F\r\n", OK2),
            (checked(b"@01L1"), OK2),
            (b"@01MEE\r\n", checked(b"@01OF125.S04.L1")),
        ],
    )
    with pytest.raises(HardwareError, match=r"channel 2 is in strobe mode S04.*@01S0054"):
        CcsController(link, LIGHTS).set_level(2, 125)


def test_where_settings_are_refused_lights_are_set_unverified_and_that_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    link, port = scripted_link(
        monkeypatch,
        [STATUS, (b"@00MED\r\n", checked(b"@00N01")), (b"@00F25582\r\n", OK1), (b"@00L11D\r\n", OK1), STATUS],
    )
    controller = CcsController(link, LIGHTS)
    controller.set_level(1, 255)
    assert controller.read_level(1) is None
    assert controller.identify()["read_back"] == "no"
    assert any("cannot be read back" in e.what for e in controller.events)
    assert port.dialogue == []


def test_settings_that_do_not_come_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three lost replies must not switch the verification off for the rest of the run."""
    link, _ = scripted_link(monkeypatch, [STATUS, *[(b"@00MED\r\n", None)] * 3])
    with pytest.raises(ReplyError, match=r"no reply after .*sent 3 times"):
        CcsController(link, LIGHTS)


@pytest.mark.parametrize(("channel", "level"), [(0, 1), (5, 1), (1, -1), (1, 256)])
def test_out_of_range_is_refused_before_a_byte_is_sent(
    monkeypatch: pytest.MonkeyPatch, channel: int, level: int
) -> None:
    link, port = scripted_link(monkeypatch, [STATUS, SETTINGS])
    controller = CcsController(link, LIGHTS)
    with pytest.raises(InputError, match="light controller main: expected"):
        controller.set_level(channel, level)
    assert len(port.sent) == 2


def test_opening_says_something_at_once_and_closes_after_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty connection wedges a PD3-EI until it is power cycled."""
    _, port = scripted_link(monkeypatch, [(b"@00CE3\r\n", None)] * 3)
    with pytest.raises(ReplyError, match=r"light controller side \(ccs\) on COM8: no reply"):
        LIGHT_DRIVERS["ccs"](LightSettings("side", "COM8", timeout_s=0.02), None)
    assert port.closed
    assert port.sent[0] == b"@00CE3\r\n"
    assert (port.opened_with["url"], port.opened_with["baudrate"], port.opened_with["exclusive"]) == (
        ("COM8", 38400, True)
    )
    assert port.opened_with["write_timeout"] > 0


@pytest.mark.parametrize(("driver", "baud"), [("ccs", 38400), ("sa", 19200), ("template", 9600)])
def test_baud_rates(monkeypatch: pytest.MonkeyPatch, driver: str, baud: int) -> None:
    """A pseudo-terminal takes any, so they are looked at here."""
    for given_, expected in ((None, baud), (57600, 57600)):
        _, port = scripted_link(monkeypatch, [])
        with pytest.raises(AssertionError, match="after the end"):
            LIGHT_DRIVERS[driver](
                LightSettings(
                    "a", "COM1", baud=given_, template={"set": "{level}", "read": "?", "read_reply": "(?P<level>.)"}
                ),
                None,
            )
        assert port.opened_with["baudrate"] == expected
        assert port.closed


@given(st.lists(st.sampled_from(list(GOLDEN.values())), max_size=6), st.data())
def test_firmware_answers_the_same_however_the_bytes_come(frames: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(frame + b"\r\n" for frame in frames)
    whole = CcsFirmware().feed(stream, 0.0)
    firmware, replies = CcsFirmware(), b""
    while stream:
        count = data.draw(st.integers(1, len(stream)))
        replies += firmware.feed(stream[:count], 0.0)
        stream = stream[count:]
    assert replies == whole
    assert replies.count(b"\r\n") == len(frames)


@given(st.binary(max_size=80))
def test_firmware_survives_any_bytes(noise: bytes) -> None:
    firmware = CcsFirmware()
    for line in firmware.feed(noise, 0.0).split(b"\r\n")[:-1]:
        assert line[3:4] in (b"O", b"N")
    firmware.feed(b"\r\n", 0.0)
    assert firmware.feed(b"@00CE3\r\n", 0.0) == b"@00O004F\r\n"


@given(st.sampled_from(list(GOLDEN.values())), st.integers(0, 9), st.integers(1, 255))
def test_a_single_wrong_byte_is_never_obeyed(frame: bytes, place: int, flip: int) -> None:
    at = place % len(frame)
    wrong = frame[:at] + bytes([frame[at] ^ flip]) + frame[at + 1 :]
    reply = CcsFirmware().feed(wrong + b"\r\n", 0.0)
    assert reply[3:4] != b"O" or wrong.upper() == frame


@pytest.mark.parametrize(
    ("body", "code"),
    [
        (b"@00F256", b"03"),
        (b"@00L2", b"03"),
        (b"@00S11", b"03"),
        (b"@04F001", b"03"),
        (b"@00F12", b"01"),
        (b"@00Fabc", b"01"),
        (b"@00X1", b"01"),
        (b"@00F00107", b"01"),
        (b"@0", b"01"),
    ],
)
def test_firmware_refuses(body: bytes, code: bytes) -> None:
    reply = CcsFirmware().feed(checked(body), 0.0)
    assert reply[3:6] == b"N" + code
    assert reply == checked(reply[:-4])


def test_firmware_wrong_checksum_is_error_2() -> None:
    assert CcsFirmware().feed(b"@00F25583\r\n", 0.0) == checked(b"@00N02")


def test_firmware_keeps_intensity_and_switch_apart() -> None:
    firmware = CcsFirmware(on=False)
    firmware.feed(checked(b"@00F100"), 0.0)
    assert firmware.levels()[1] == 0
    firmware.feed(checked(b"@00L1"), 0.0)
    assert firmware.levels()[1] == 100 / 255
    firmware.feed(checked(b"@00S03"), 0.0)
    assert firmware.levels()[1] == 0
    assert firmware.feed(checked(b"@00M"), 0.0) == checked(b"@00OF100.S03.L1")


def test_firmware_does_not_hear_what_comes_too_early() -> None:
    firmware = FaultyCcs(gap_s=0.005)
    assert firmware.feed(b"@00CE3\r\n", 1.0) != b""
    assert firmware.feed(b"@00CE3\r\n", 1.004) == b""
    assert firmware.feed(b"@00CE3\r\n", 1.006) != b""
