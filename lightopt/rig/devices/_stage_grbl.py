r"""Grbl 1.1 controllers, with rotary axes on X, Y or Z ($100, $101, $102 in steps per degree).

A line is answered by ``ok`` or ``error:N``; single bytes (``?`` status, ``!`` hold, 0x18 reset) are obeyed at once and
get no ``ok``. What a driver must know:

- ``ok`` means planned, not done, and in the first milliseconds after it the state is still ``Idle``; so a move is done
  when the state is ``Idle`` *and* the position is the target.
- After ALARM:1 and ALARM:2 nothing is answered, not even ``?``, until a reset. The driver then queries no more, reports
  it, and does not reset: a person must look first.
- The homed machine's space is negative, from 0 down to −$130; ``G53`` moves in it whatever offsets are set.
- Opening the port resets most boards, which then report ``Grbl`` within two seconds.
- ``$H`` is known only with ``$22=1``, and no report is given while it lasts.
"""

import math
import re
import time
from collections.abc import Mapping, Sequence
from typing import Any

from lightopt.core.errors import HardwareError, InputError
from lightopt.rig.devices._device import LinkLostError, ReplyError
from lightopt.rig.devices._serial_link import SerialLink
from lightopt.rig.devices._stage import Axis, Dialogue, Reading

_AXES = ("X", "Y", "Z")
_RESET = b"\x18"
_BANNER = b"Grbl "
_BANNER_S = 2.5  # a board that was reset by the opening of the port reports its name within
_LISTEN_S = 0.2
_HOLD_S = 1.0
_FINEST = 0.001  # reports have three decimals
_MOVING = ("Run", "Jog", "Home", "Hold:1")
_HELD = {
    "Hold:0": "feed hold; resume or reset it",
    "Check": "check mode; leave it with $C",
    "Sleep": "asleep; reset it",
    "Alarm": "locked; home it (lightopt bench home RIG), or find out why and unlock it with $X",
}
_CRITICAL = ("ALARM:1 ", "ALARM:2 ")  # Grbl then answers nothing, not even '?', until it is reset
_RESET_IT = "look what it hit, reset it, and home it"
_ALARMS = {
    1: "hard limit: a limit switch was hit, the position is lost",
    2: "soft limit: the target lies outside the travel; the position is kept",
    3: "reset in motion: steps may be lost",
    6: "homing fail: reset during homing",
    7: "homing fail: the door was opened during homing",
    8: "homing fail: pulling off did not release the limit switch",
    9: "homing fail: no limit switch was found within the search distance",
    10: "homing fail: the second limit switch of an axis was not found",
}
_ERRORS = {  # that a line of this driver can cause as it was sent; others mean that it was damaged on its way
    5: "homing is not enabled ($22=0)",
    8: "not possible while the machine is not idle",
    9: "locked by an alarm, or while jogging",
    13: "the door is open",
    20: "unsupported command",
}
_REPORT = re.compile(rb"<(?P<state>[A-Za-z]+(?::\d+)?)\|(?P<fields>[^<>]*)>\r?\n")
_NUMBERS = re.compile(r"-?\d+(?:\.\d+)?(?:,-?\d+(?:\.\d+)?)*")
_SETTING = re.compile(rb"\$(\d+)=(-?\d+(?:\.\d+)?)\r?\n")


def parse_report(line: bytes) -> tuple[str, tuple[float, ...]] | None:
    r"""State (``Idle``, ``Hold:0``, …) and machine position [units of $100] of a status report; None for other lines.

    Raises ValueError for a status report without a machine position.

    >>> parse_report(b"<Run|MPos:-1.450,0.000,0.000|FS:175,0>\r\n")
    ('Run', (-1.45, 0.0, 0.0))
    """
    match = _REPORT.fullmatch(line)
    if match is None:
        return None
    text = match["fields"].decode("ascii", "replace")
    fields = {key: value for key, _, value in (field.partition(":") for field in text.split("|"))}
    position = fields.get("MPos", "")
    if "WPos" in fields and not position:
        raise ValueError("reports work positions; set $10=1, so that it reports machine positions")
    if not _NUMBERS.fullmatch(position):
        raise ValueError("a status report without a machine position")
    return match["state"].decode("ascii"), tuple(map(float, position.split(",")))


class GrblDialogue(Dialogue):
    """The protocol of Grbl 1.1; axes X, Y, Z. The speeds that it allows are only known from the device."""

    BAUD = 115200
    HOMES_TO_END = True

    def __init__(self, link: SerialLink, axes: Sequence[Axis], **options: Any) -> None:
        super().__init__(link, axes, **options)
        self._settings: dict[int, float] | None = None
        self._here: dict[str, float] = {}
        self._critical: str | None = None
        self._restarted = False
        self._homing = False
        self._greet()

    def identify(self) -> dict[str, str]:
        lines = self._retry.run(lambda: self._line("$I"))
        fields = (line.decode("ascii", "replace").strip().strip("[]").partition(":") for line in lines)
        return {key.lower(): value.rstrip(":") for key, _, value in fields if key in ("VER", "OPT") and value}

    def read(self) -> Reading:
        """Position and state; after an alarm that silences Grbl, the last known ones, without a query."""
        if self._critical is None:
            try:
                return self._retry.run(self._report)
            except ReplyError as error:
                if self._critical is None:
                    silent = f"Grbl answers nothing, not even to '?', after ALARM:1 or ALARM:2; if so, {_RESET_IT}"
                    raise ReplyError(*error.messages, silent) from None
        alarm = f"{self._critical}; Grbl answers nothing until it is reset: {_RESET_IT}"
        return Reading(self._units(), moving=False, referenced=False, alarm=alarm)

    def step(self, axis: Axis) -> float:
        """A motor step, but no finer than reports resolve."""
        number = 100 + _AXES.index(axis.device)
        return max(1.0 / self._setting(number), _FINEST)

    def check(self, targets: Mapping[str, float]) -> None:
        """Raise an InputError outside Grbl's own travel (with soft limits on), or faster than its axes go."""
        for axis in self._axes:
            index = _AXES.index(axis.device)
            travel = self._setting(130 + index)
            if self._setting(20) and not -travel <= targets[axis.device] <= 0:
                low, high = map(axis.units_of, axis.range_deg)
                raise InputError(
                    f"stage axis {axis.name}: {axis.device}{targets[axis.device]:.3f} lies outside Grbl's travel "
                    f"-{travel:g} … 0 (${130 + index}, soft limits on), and the rig's range is {axis.device}{low:g} … "
                    f"{high:g}; set zero in the rig's hardware.stage, or the travel in Grbl; nothing was moved"
                )
            fastest = self._setting(110 + index) / 60
            if axis.speed_units() > fastest * (1 + 1e-6):
                allowed = f"(${110 + index} allows {fastest / abs(axis.steps_per_deg):g}°/s)"
                faster = f"{axis.speed_deg_per_s:g}°/s is faster than Grbl's axis goes {allowed}"
                raise InputError(f"stage axis {axis.name}: {faster}; nothing was moved")

    def go(self, targets: Mapping[str, float]) -> None:
        """Plan a straight move in machine coordinates, fast enough for the axis that takes longest."""
        ways = {axis: units - self._here[axis] for axis, units in targets.items()}
        speeds = {axis.device: axis.speed_units() for axis in self._axes}
        longest_s = max(abs(way) / speeds[axis] for axis, way in ways.items())
        feed = 60 * math.hypot(*ways.values()) / longest_s
        words = "".join(f"{axis}{units:.3f}" for axis, units in sorted(targets.items()))
        self._line(f"G90G94G21G53G1{words}F{feed:.1f}")

    def home(self) -> None:
        """Seek the limit switches, to the end."""
        if self._critical is not None:
            raise self.link.failure(f"{self._critical}; it must be reset before it can be homed")
        if not self._setting(22):
            raise self.link.failure("homing is not enabled ($22=0); with limit switches, set $22=1", sent=b"$H\n")
        self._restarted = False
        self._homing = True  # until it answers ok: while it seeks, it reports nothing and ignores a hold
        self._line("$H", deadline_s=self.home_timeout_s)
        self._homing = False

    def halt(self) -> None:
        """Hold, and when it stands still reset, which forgets the rest of the way and keeps the position.

        While it seeks its switches it ignores a hold and is reset at once; it is then locked until it is homed.
        After an alarm that silences Grbl the motors are off already, and a reset would clear what a person should see.
        """
        if self._critical is not None:
            return
        if not self._homing:
            self.link.write(b"!")
            until = time.monotonic() + _HOLD_S
            while time.monotonic() < until and self._moves():
                pass
            if self._critical is not None:
                return
        self._homing = False
        self.link.write(_RESET)
        until = time.monotonic() + _BANNER_S
        try:
            while not self._next_line(until, _RESET).startswith(_BANNER):
                pass
        except ReplyError as error:
            raise self.link.failure("did not restart after '!' and a reset", sent=_RESET) from error
        self.link.drain(quiet_s=0.05)
        self._restarted = False

    def _moves(self) -> bool:
        """Whether it reports that it moves; after an alarm, or without an answer, it is not waited for."""
        try:
            return self._report().moving
        except LinkLostError:
            raise
        except HardwareError:
            return False

    def _greet(self) -> None:
        """Wait until Grbl answers: it restarts when the port is opened, unless the board is wired not to."""
        until = time.monotonic() + _BANNER_S
        while True:
            self.link.write(b"?")
            try:
                heard = b""
                while not heard.startswith((_BANNER, b"<")):
                    heard = self.link.read(end=b"\n", deadline_s=_LISTEN_S)
            except ReplyError:
                if time.monotonic() > until:
                    why = "wrong port or baud rate, or a limit alarm (press its reset button; then home it)"
                    raise self.link.failure(f"no Grbl answers: {why}", sent=b"?") from None
                continue
            self.link.drain()
            return

    def _setting(self, number: int) -> float:
        if self._settings is None:
            lines = self._retry.run(lambda: self._line("$$"))
            matches = (match for line in lines if (match := _SETTING.fullmatch(line)) is not None)
            settings = {int(match[1]): float(match[2]) for match in matches}
            needed = {20, 22, *(base + i for base in (100, 110, 130) for i in range(3))}
            if missing := needed - set(settings):
                lacks = f"settings are missing: {sorted(missing)}"
                raise self.link.failure(lacks, sent=b"$$\n", reply=b"".join(lines), kind=ReplyError)
            if settings.get(13, 0):
                raise self.link.failure("reports inches; set $13=0", sent=b"$$\n")
            self._settings = settings
        return self._settings[number]

    def _report(self) -> Reading:
        """Query a status report once, and handle the messages that come before it."""
        self.link.write(b"?")
        until = time.monotonic() + self.link.timeout_s
        while True:
            line = self._heard(until, b"?")
            try:
                report = parse_report(line)
            except ValueError as error:
                raise self.link.failure(str(error), sent=b"?", reply=line) from None
            if report is None:
                if line.startswith(b"<"):
                    raise self.link.failure("a broken status report", sent=b"?", reply=line, kind=ReplyError)
                continue
            self._homing = False  # it reports again
            state, position = report
            self._here = dict(zip(_AXES, position, strict=False))
            held = _HELD.get(state) or ("the door is open" if state.startswith("Door") else None)
            if held is None and state != "Idle" and state not in _MOVING:
                raise self.link.failure("an unknown state", sent=b"?", reply=line, kind=ReplyError)
            referenced = False if state == "Alarm" or self._restarted else None
            return Reading(self._units(), moving=state in _MOVING, referenced=referenced, alarm=held)

    def _units(self) -> dict[str, float]:
        return {axis.device: self._here.get(axis.device, math.nan) for axis in self._axes}

    def _line(self, text: str, *, deadline_s: float | None = None) -> list[bytes]:
        """Send a line; returns the lines that came before its ok."""
        frame = text.encode("ascii") + b"\n"
        self.link.write(frame)
        until = time.monotonic() + (self.link.timeout_s if deadline_s is None else deadline_s)
        before: list[bytes] = []
        while True:
            line = self._heard(until, frame)
            if line == b"ok\r\n":
                return before
            if line.startswith(b"error:"):
                raise self.link.failure(f"refused: {self._described(line, _ERRORS)}", sent=frame, reply=line)
            before.append(line)

    def _next_line(self, until: float, sent: bytes) -> bytes:
        return self.link.read(end=b"\n", deadline_s=max(0.0, until - time.monotonic()), after=sent)

    def _heard(self, until: float, sent: bytes) -> bytes:
        """The next line, once it is known to be neither an alarm nor a restart."""
        line = self._next_line(until, sent)
        if line.startswith(b"ALARM:"):
            words = self._described(line, _ALARMS)
            if words.startswith(_CRITICAL):
                self._critical = words
            raise self.link.failure(words, sent=sent, reply=line)
        if line.startswith(_BANNER):
            self._restarted = True
            self.link.note("Grbl restarted by itself: it was switched off, reset, or lost power")
        return line

    def _described(self, line: bytes, meanings: Mapping[int, str]) -> str:
        """An alarm or error with its meaning: ``error:5 (homing is not enabled)``."""
        kind, _, number = line.decode("ascii", "replace").strip().partition(":")
        if not number.isdigit():
            raise self.link.failure("a broken reply", reply=line, kind=ReplyError)
        return f"{kind}:{number} ({meanings.get(int(number), 'see the lists of Grbl')})"
