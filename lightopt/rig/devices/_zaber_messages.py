"""Messages of the Zaber ASCII protocol, their checksum, and what their flags mean.

Source: the protocol's public description; the checksums in the tests are those that Zaber's own library sends.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from lightopt.rig.devices._errors import printable

NOT_HOMED = frozenset({"WR", "WH"})

_WARNINGS = {
    "FF": "critical system error",
    "FN": "the peripheral is not supported",
    "FZ": "the peripheral is inactive",
    "FH": "the device has detected a hardware error",
    "FV": "the supply voltage is too high",
    "FO": "the driver is disabled",
    "FC": "the driver is disabled by the current limit",
    "FM": "the motor does not answer",
    "FD": "the driver is disabled (too hot, or switched off)",
    "FQ": "encoder error: the position may be wrong",
    "FS": "stalled and stopped",
    "FT": "the lockstep axes twist too much",
    "FB": "a streamed motion left its bounds",
    "FP": "a streamed motion left its path",
    "FE": "a limit sensor cannot be reached or is faulty",
    "WH": "not homed",
    "WL": "a limit sensor ended a move that should not have met it: the axis may have slipped",
    "WP": "the calibration data are not supported",
    "WV": "the supply voltage is out of range",
    "WT": "the controller is hot",
    "WM": "the axis was pushed while it stood still",
    "WR": "no reference position",
    "NC": "moved by hand with the knob",
    "NI": "a move was interrupted by another",
    "ND": "a stream ran out of motions",
    "NU": "a setting waits for a restart",
    "NJ": "the joystick is being calibrated",
}
_REJECTIONS = {
    "AGAIN": "not now; send again",
    "BADAXIS": "the device has no such axis",
    "BADCOMMAND": "unknown command or setting",
    "BADDATA": "the value is wrong or out of range",
    "BADMESSAGEID": "the message number is wrong",
    "DEVICEONLY": "a command for the device, not for an axis",
    "FULL": "no more room",
    "LOCKSTEP": "the axis is part of a lockstep group",
    "NOACCESS": "not allowed at this access level",
    "PARKED": "the device is parked",
    "STATUSBUSY": "not while it is moving",
}
_REPLY = re.compile(
    rb"@(?P<device>\d{2}) (?P<axis>\d) (?:(?P<id>\d{2}) )?(?P<flag>OK|RJ) (?P<status>IDLE|BUSY) "
    rb"(?P<warning>[A-Z]{2}|--) (?P<data>[^:\r\n]*?)(?::(?P<lrc>[0-9A-F]{2}))?\r?\n"
)


@dataclass(frozen=True)
class Reply:
    """A reply of a device.

    Attributes
    ----------
    device, axis
        Who answers.
    number
        Number of the message that it answers; None when it has none.
    accepted
        OK rather than RJ.
    busy
        Whether it moves.
    warning
        Flag of the gravest warning; empty without one.
    data
        The answer, or why it was rejected.
    """

    device: int
    axis: int
    number: int | None
    accepted: bool
    busy: bool
    warning: str
    data: str


def checksum(body: bytes) -> bytes:
    """LRC of a message without its first and last characters: two's complement of the sum, two hexadecimal digits.

    Examples
    --------
    >>> checksum(b"1 1 00 get pos")
    b'2C'
    """
    return f"{-sum(body) & 0xFF:02X}".encode("ascii")


def frame(device: int, axis: int, number: int, command: str) -> bytes:
    r"""A numbered command with its checksum.

    Examples
    --------
    >>> frame(1, 1, 1, "home")
    b'/1 1 01 home:34\n'
    """
    body = " ".join(part for part in (str(device), str(axis), f"{number:02d}", command) if part).encode(
        "ascii"
    )
    return b"/" + body + b":" + checksum(body) + b"\n"


def parse_reply(line: bytes) -> Reply:
    r"""Read a reply.

    Raises
    ------
    ValueError
        When it is none, or its checksum is wrong.

    Examples
    --------
    >>> parse_reply(b"@01 1 OK BUSY WR 0\r\n")
    Reply(device=1, axis=1, number=None, accepted=True, busy=True, warning='WR', data='0')
    """
    match = _REPLY.fullmatch(line)
    if match is None:
        raise ValueError("a broken reply")
    if match["lrc"] is not None and checksum(line[1 : match.start("lrc") - 1]) != match["lrc"]:
        raise ValueError(f"the checksum should be {printable(checksum(line[1 : match.start('lrc') - 1]))}")
    warning = match["warning"].decode("ascii")
    return Reply(
        device=int(match["device"]),
        axis=int(match["axis"]),
        number=None if match["id"] is None else int(match["id"]),
        accepted=match["flag"] == b"OK",
        busy=match["status"] == b"BUSY",
        warning="" if warning == "--" else warning,
        data=match["data"].decode("ascii", "replace").strip(),
    )


def warning_words(flag: str) -> str:
    """A warning for people, with its flag."""
    return f"{flag} ({_WARNINGS.get(flag, 'unknown')})"


def rejection_words(reason: str) -> str:
    """Why a command was rejected, for people."""
    return f"{reason} ({_REJECTIONS.get(reason.split(' ')[0], 'unknown')})"
