"""The SA0255# family and controllers described by templates, byte for byte."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from faulty_bench import FaultySa
from hypothesis import given, strategies as st
from scripted import scripted_link

from lightopt.core.errors import HardwareError
from lightopt.rig.devices import LightSettings
from lightopt.rig.devices._device import RefusedError, ReplyError
from lightopt.rig.devices._light_sa import SaController
from lightopt.rig.devices._light_template import TemplateController
from lightopt.rig.simulated._light_template import TemplateFirmware, example

LIGHTS = LightSettings("main", "COM7")

READ_A = (b"SA#", b"a0000")


# ---- SA0255#


@pytest.mark.parametrize("ack", [b"A", b"a", b"!", b"B", b"b"], ids=lambda ack: ack.decode())
def test_sa_takes_every_makers_acknowledgement_and_reads_back(monkeypatch: pytest.MonkeyPatch, ack: bytes) -> None:
    link, port = scripted_link(
        monkeypatch,
        [
            READ_A,
            (b"SB0255#", ack),
            (b"SB#", b"b0255"),
            (b"SB#", b"B0255"),
            (b"SB0000#", ack),
            (b"SB#", b"b0000"),
            READ_A,
        ],
    )
    controller = SaController(link, LIGHTS)
    controller.set_level(2, 255)
    assert controller.read_level(2) == 255
    controller.set_level(2, 0)
    assert controller.identify() == {"driver": "sa", "port": "COM7", "read_back": "yes"}
    controller.close()
    assert (port.dialogue, port.closed, controller.events) == ([], True, [])


@pytest.mark.parametrize(
    ("reply", "words"),
    [(None, "no reply"), (b"C", "no acknowledgement"), (b"\x80\x81", "incomplete"), (b"\x80B", "no acknowledgement")],
)
def test_sa_spoilt_acknowledgement(monkeypatch: pytest.MonkeyPatch, reply: bytes | None, words: str) -> None:
    script = [READ_A, (b"SB0255#", reply), (b"SB0255#", b"b"), (b"SB#", b"b0255")]
    link, port = scripted_link(monkeypatch, script)
    controller = SaController(link, LIGHTS)
    controller.set_level(2, 255)
    assert (port.dialogue, sum(event.retry for event in link.events)) == ([], 1)
    assert words in next(e.what for e in controller.events if e.retry)


@pytest.mark.parametrize("reply", [None, b"b", b"a0255", b"b02", b"!0255", b"Ab0255"])
def test_sa_spoilt_reading(monkeypatch: pytest.MonkeyPatch, reply: bytes | None) -> None:
    script = [READ_A, (b"SB#", reply), (b"SB#", b"b0017")]
    link, port = scripted_link(monkeypatch, script)
    assert SaController(link, LIGHTS).read_level(2) == 17
    assert (port.dialogue, sum(event.retry for event in link.events)) == ([], 1)


def test_sa_refusal_is_not_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    link, port = scripted_link(monkeypatch, [READ_A, (b"SB0255#", b"NG")])
    with pytest.raises(RefusedError, match=r'it refuses the command \(NG\); sent "SB0255#", got "NG"'):
        SaController(link, LIGHTS).set_level(2, 255)
    assert (port.dialogue, sum(event.retry for event in link.events)) == ([], 0)


def test_sa_holds_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    link, _ = scripted_link(monkeypatch, [READ_A, (b"SB0255#", b"b"), (b"SB#", b"b0100")])
    with pytest.raises(HardwareError, match="channel 2 was set to 255 but holds 100"):
        SaController(link, LIGHTS).set_level(2, 255)


def test_sa_that_cannot_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    link, port = scripted_link(monkeypatch, [(b"SA#", b"NG"), (b"SA0100#", b"!")])
    controller = SaController(link, LIGHTS)
    controller.set_level(1, 100)
    assert controller.read_level(1) is None
    assert controller.identify()["read_back"] == "no"
    assert port.dialogue == []


@pytest.mark.parametrize(("ack", "replies"), [("upper", b"AB"), ("lower", b"ab"), ("!", b"!!")])
def test_sa_firmware_by_the_table(ack: str, replies: bytes) -> None:
    firmware = FaultySa(top_level=999, ack=ack)
    assert firmware.feed(b"SA0888#SB0000#", 0.0) == replies
    assert firmware.feed(b"SA#", 0.0) == b"a0888"
    assert firmware.levels() == {1: 888 / 999, 2: 0, 3: 0, 4: 0}


@pytest.mark.parametrize("command", [b"SE0001#", b"SA1000#", b"SA12#", b"XA0001#", b"SH#", b"\xff#"])
def test_sa_firmware_refuses(command: bytes) -> None:
    assert FaultySa(channels=4, top_level=999).feed(command, 0.0) == b"NG"


@given(st.lists(st.sampled_from([b"SA0255#", b"SA#", b"SD0001#", b"SL#", b"SZ#"]), max_size=6), st.data())
def test_sa_firmware_answers_the_same_however_the_bytes_come(commands: list[bytes], data: st.DataObject) -> None:
    stream = b"".join(commands)
    whole = FaultySa().feed(stream, 0.0)
    firmware, replies = FaultySa(), b""
    while stream:
        count = data.draw(st.integers(1, len(stream)))
        replies += firmware.feed(stream[:count], 0.0)
        stream = stream[count:]
    assert replies == whole


# ---- templates

# Makers whose commands are known from public drivers: set, and what they send for channel 2 at 25.
MAKERS = {
    "L1255<CR><LF>": ("L{channel}{level:03d}\r\n", b"L2025\r\n"),
    "L0255<CR><LF>, channels from 0": ("L{channel0}{level:03d}\r\n", b"L1025\r\n"),
    "C1255<CR><LF>": ("C{channel}{level:03d}\r\n", b"C2025\r\n"),
    "<STX>1w0255<ETX>": ("\x02{channel}w{level:04d}\x03", b"\x022w0025\x03"),
    "#CH01BW0255E": ("#CH{channel:02d}BW{level:04d}E", b"#CH02BW0025E"),
    "letters and unpadded levels": ("{letter}={level};", b"B=25;"),
    "braces and high bytes": ("{{{channel}}}\xff{level:5d}", b"{2}\xff   25"),
}


@pytest.mark.parametrize(("command", "expected"), MAKERS.values(), ids=MAKERS)
def test_template_commands(monkeypatch: pytest.MonkeyPatch, command: str, expected: bytes) -> None:
    link, port = scripted_link(monkeypatch, [(expected, b"")])
    controller = TemplateController(link, replace(LIGHTS, template={"set": command}))
    controller.set_level(2, 25)
    assert controller.read_level(2) is None
    assert port.dialogue == []
    firmware = TemplateFirmware(template={"set": command})
    assert firmware.feed(expected, 0.0) == b""
    assert firmware.levels() == {1: 0, 2: 25 / 255, 3: 0, 4: 0}


FULL: dict[str, str | None] = {
    "set": "L{channel}{level:03d}\r",
    "set_reply": "OK|L\\d",
    "off": "X{channel}\r",
    "off_reply": "OFF",
    "read": "?{channel}\r",
    "read_reply": "V(?P<level>[0-9]+)",
    "end": "\r\n",
}
SILENT = FULL | {"end": None}


@pytest.mark.parametrize(("template", "end"), [(FULL, b"\r\n"), (SILENT, b"")], ids=["end", "silence"])
def test_template_with_everything(monkeypatch: pytest.MonkeyPatch, template: dict[str, str | None], end: bytes) -> None:
    link, port = scripted_link(
        monkeypatch,
        [
            (b"?1\r", b"V0" + end),
            (b"L2025\r", b"L2" + end),
            (b"?2\r", b"V025" + end),
            (b"X2\r", b"OFF" + end),
            (b"?2\r", b"V0" + end),
        ],
        timeout_s=1,
    )
    controller = TemplateController(link, replace(LIGHTS, template=template))
    controller.set_level(2, 25)
    controller.set_level(2, 0)
    assert (port.dialogue, controller.events) == ([], [])


@pytest.mark.parametrize(
    ("reply", "words"), [(None, "no reply"), (b"ERR\r\n", "does not match template.set_reply"), (b"OK", "incomplete")]
)
def test_template_spoilt_reply(monkeypatch: pytest.MonkeyPatch, reply: bytes | None, words: str) -> None:
    script = [(b"?1\r", b"V0\r\n"), *[(b"L2025\r", reply)] * 3]
    link, port = scripted_link(monkeypatch, script)
    with pytest.raises(ReplyError, match=rf"{re.escape(words)}.*L2025.*sent 3 times"):
        TemplateController(link, replace(LIGHTS, template=FULL)).set_level(2, 25)
    assert (port.dialogue, sum(event.retry for event in link.events)) == ([], 2)


def test_template_level_that_is_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    link, _ = scripted_link(monkeypatch, [(b"?1\r", b"VX\r\n")] * 3)
    with pytest.raises(ReplyError, match="no number"):
        TemplateController(link, replace(LIGHTS, template=FULL | {"read_reply": "V(?P<level>.)"}))


def test_template_holds_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    script = [(b"?1\r", b"V0\r\n"), (b"L2025\r", b"OK\r\n"), (b"?2\r", b"V24\r\n")]
    link, _ = scripted_link(monkeypatch, script)
    with pytest.raises(HardwareError, match="channel 2 was set to 25 but holds 24"):
        TemplateController(link, replace(LIGHTS, template=FULL)).set_level(2, 25)


def test_template_firmware_refuses_patterns_it_cannot_make_a_reply_of() -> None:
    with pytest.raises(ValueError, match="cannot make up a reply"):
        TemplateFirmware(template={"set": "{level}", "set_reply": "(?=x)"})


# ---- replies made up from patterns

_ATOMS = st.one_of(
    st.sampled_from(["a", "Z", "7", "#", r"\.", r"\\", r"\d", r"\w", r"\s", r"\r\n", r"\x06", "."]),
    st.sampled_from(["[0-9]", "[^0-9]", "[A-F]", "[]x]", "[^]]", r"[\]\d]", "(?:ab|cd)", "(OK|NG)", "()", "$"]),
)
_PIECES = st.tuples(_ATOMS, st.sampled_from(["", "", "?", "*", "+", "{2}", "{1,3}", "{0,}", "+?"])).map(
    lambda pair: pair[0] if pair[0] == "$" else "".join(pair)
)


@given(st.lists(st.lists(_PIECES, max_size=5).map("".join), min_size=1, max_size=3).map("|".join))
def test_examples_match(pattern: str) -> None:
    try:
        text = example(pattern)
    except ValueError:
        assert "$" in pattern  # an end in the middle matches nothing
        return
    assert re.fullmatch(pattern, text, re.DOTALL)


@given(st.integers(0, 999))
def test_examples_tell_the_level(level: int) -> None:
    for pattern in (r"(?P<level>\d+)", r"L1(?P<level>[0-9]{4})", r"v=(?P<level>\d{3,5}),(ok|ng)"):
        text = example(pattern, level)
        match = re.fullmatch(pattern, text)
        assert match is not None
        assert int(match["level"]) == level


@pytest.mark.parametrize("pattern", [r"(a)\1", "(?<=a)b", "(?i:a)", "a)", "(a"])
def test_examples_that_cannot_be_made(pattern: str) -> None:
    with pytest.raises(ValueError, match="cannot make up"):
        example(pattern)
