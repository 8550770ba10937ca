"""Messages of Grbl 1.1: status reports, alarms, errors, settings.

Source: the interface description and the code tables that come with Grbl 1.1, and dialogues recorded from a Grbl 1.1h.
"""

import re
from dataclasses import dataclass

CRITICAL_ALARMS = frozenset({1, 2})  # Grbl then answers nothing, not even '?', until it is reset

_ALARMS = {
    1: "hard limit: a limit switch was hit, the position is lost",
    2: "soft limit: the target lies outside the travel; the position is kept",
    3: "reset in motion: steps may be lost",
    4: "probe fail: the probe was in another state than expected",
    5: "probe fail: the probe met nothing",
    6: "homing fail: reset during homing",
    7: "homing fail: the door was opened during homing",
    8: "homing fail: pulling off did not release the limit switch",
    9: "homing fail: no limit switch was found within the search distance",
    10: "homing fail: the second limit switch of an axis was not found",
}
_ERRORS = {
    1: "a letter was expected",
    2: "a number is missing or not one",
    3: "unknown $ command",
    4: "a negative value where none may be",
    5: "homing is not enabled ($22=0)",
    6: "step pulse shorter than 3 µs",
    7: "the settings could not be read from memory and were reset",
    8: "not possible while the machine is not idle",
    9: "locked by an alarm, or while jogging",
    10: "soft limits need homing ($22=1)",
    11: "the line is too long",
    12: "the step rate is too high",
    13: "the door is open",
    14: "the startup line is too long",
    15: "the jog target lies outside the travel",
    16: "wrong jog command",
    17: "laser mode needs a PWM output",
    20: "unsupported command",
    21: "two commands of one group in a line",
    22: "the feed rate is missing",
    23: "a whole number was expected",
    24: "two commands that use the axis words",
    25: "a word twice in a line",
    26: "no axis words",
    31: "axis words without a command that uses them",
    33: "the target of the move is invalid",
}
_REPORT = re.compile(rb"<(?P<state>[A-Za-z]+(?::\d+)?)\|(?P<fields>[^<>]*)>\r?\n")
_NUMBERS = re.compile(r"-?\d+(?:\.\d+)?(?:,-?\d+(?:\.\d+)?)*")
_SETTING = re.compile(rb"\$(\d+)=(-?\d+(?:\.\d+)?)\r?\n")


def describe_alarm(code: int) -> str:
    """Number and meaning of an alarm."""
    return f"ALARM:{code} ({_ALARMS.get(code, 'unknown')})"


def describe_error(code: int) -> str:
    """Number and meaning of an error."""
    return f"error:{code} ({_ERRORS.get(code, 'unknown')})"


@dataclass(frozen=True)
class StatusReport:
    """A status report: state (``Idle``, ``Run``, ``Hold:0``, …) and machine position of X, Y, Z [units of $100]."""

    state: str
    position: tuple[float, ...]


def parse_report(line: bytes) -> StatusReport | None:
    r"""Read a status report; None when the line is none.

    Raises ValueError for a status report without a machine position.

    Examples
    --------
    >>> parse_report(b"<Run|MPos:-1.450,0.000,0.000|FS:175,0>\r\n")
    StatusReport(state='Run', position=(-1.45, 0.0, 0.0))
    """
    match = _REPORT.fullmatch(line)
    if match is None:
        return None
    fields: dict[str, str] = {}
    for field in match["fields"].decode("ascii", "replace").split("|"):
        key, _, value = field.partition(":")
        fields[key] = value
    position = fields.get("MPos", "")
    if "WPos" in fields and not position:
        raise ValueError("reports work positions; set $10=1, so that it reports machine positions")
    if not _NUMBERS.fullmatch(position):
        raise ValueError("a status report without a machine position")
    return StatusReport(
        state=match["state"].decode("ascii"), position=tuple(float(number) for number in position.split(","))
    )


def parse_setting(line: bytes) -> tuple[int, float] | None:
    r"""Number and value of a line of ``$$``; None when the line is none.

    Examples
    --------
    >>> parse_setting(b"$100=250.000\r\n")
    (100, 250.0)
    """
    match = _SETTING.fullmatch(line)
    return None if match is None else (int(match[1]), float(match[2]))
