"""SIGMA KOKI / OptoSigma controllers: the SHOT family (MAIN mode) and GSC-02; positions in pulses.

Both: ``Q:`` asks for positions and motion; ``H:`` seeks the mechanical origin, where the count becomes 0; ``L:E`` stops
at once. While an axis moves only stop and status are taken. The count starts at 0 when the controller is switched on,
wherever the stage stands, and nothing shows whether it has been homed since. There are no limits but the switches.

SHOT answers OK or NG to each command. ``A:1+P9000`` or ``A:W+P1800-P2000`` names the target and ``G:`` goes there.

GSC-02 answers questions only; ACK1 of the next ``Q:`` shows whether a command was taken. It knows no absolute move: the
position is asked for, ``M:1+P500`` or ``M:W+P500-P200`` names the way from there, ``G:`` goes it, and the position is
verified at the end. A relative move is never sent twice. Seeking the origin needs a sense, ``H:1-`` or ``H:W-+``, and
only ``L:W`` and ``L:E`` stop it. ``D:`` sets the speeds of both axes at once, in a slow or in a fast range.

Sources: the docstrings that ``elerac/optosigma`` took from the GSC-01 and GSC-02 manuals, ``ken1row/PyOptoSigma``, and
``SigmaKokiPy``, which agree on what is used here.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from lightopt.core.errors import InputError, refuse
from lightopt.rig.devices._device import ReplyError, printable
from lightopt.rig.devices._stage import Axis, Dialogue, Reading

END = b"\r\n"
RAMP_MS = 200  # acceleration and deceleration; the controllers' own value at power-up
_POSITION = re.compile(r"\s*([+-]?)\s*(\d+)\s*")
_LIMITS = {"L": "axis 1", "M": "axis 2", "W": "both axes"}
_GSC_SPEEDS = {1: (1, 200), 2: (50, 20_000)}  # speed ranges of D: [pulses/s]
_GSC_FARTHEST = 16_777_214  # longest relative move [pulses]
_REFUSED = "the command is wrong, or the stage is moving"


@dataclass(frozen=True)
class Status:
    """The answer to ``Q:``: positions [pulses], command accepted (ACK1), axis at its limit (ACK2), busy (ACK3)."""

    positions: tuple[int, ...]
    accepted: bool
    limit: str | None
    busy: bool


def command(text: str) -> bytes:
    return text.encode("ascii") + END


def signed(pulses: int) -> str:
    """A distance or position as the commands write it."""
    return f"{'-' if pulses < 0 else '+'}P{abs(pulses)}"


def axis_command(verb: str, values: Mapping[str, str]) -> str:
    """A command for one axis or for both, from the words of each."""
    if len(values) == 1:
        ((axis, value),) = values.items()
        return f"{verb}:{axis}{value}"
    return f"{verb}:W{values['1']}{values['2']}"


def parse_status(line: bytes) -> Status:
    r"""Read the answer to ``Q:``.

    Raises ValueError when it is none, with the reason.

    >>> parse_status(b"        100,-       20,K,K,R\r\n")
    Status(positions=(100, -20), accepted=True, limit=None, busy=False)
    """
    fields = line.decode("ascii", "replace").rstrip("\r\n").split(",")
    if len(fields) < 4:
        raise ValueError(f"expected positions and three letters, got {printable(line)}")
    *places, ack1, ack2, ack3 = fields
    positions: list[int] = []
    for place in places:
        # the sign may stand apart from the digits: "-    1000"
        match = _POSITION.fullmatch(place)
        if match is None:
            raise ValueError(f"expected a position, got {printable(place.encode('ascii', 'replace'))}")
        positions.append(int(match[1] + match[2]))
    if ack1 not in ("K", "X") or ack2 not in ("K", *_LIMITS) or ack3 not in ("B", "R"):
        raise ValueError(f"expected K or X, K L M or W, B or R, got {printable(','.join(fields[-3:]).encode())}")
    return Status(positions=tuple(positions), accepted=ack1 == "K", limit=_LIMITS.get(ack2), busy=ack3 == "B")


class _SigmakokiDialogue(Dialogue):
    BAUD = 9600
    SPEEDS: ClassVar[tuple[int, int]]  # slowest and fastest [pulses/s]

    @classmethod
    def check_axes(cls, axes: Sequence[Axis]) -> None:
        slowest, fastest = cls.SPEEDS
        wrong = [axis for axis in axes if not slowest <= round(axis.speed_units()) <= fastest]
        speeds = [f"{axis.name}: {axis.speed_deg_per_s:g}°/s are {axis.speed_units():g} pulses/s" for axis in wrong]
        refuse(f"stage axis {speed}; the controller takes {slowest} to {fastest}" for speed in speeds)

    def identify(self) -> dict[str, str]:
        line = self._retry.run(lambda: self.link.query(command("?:V"), end=END))
        version = line.decode("ascii", "replace").strip()
        return {"version": version} if version not in ("", "NG") else {}

    def read(self) -> Reading:
        return self._retry.run(self._status)[1]

    def homed(self, reading: Reading) -> str | None:
        """The count is 0 at the origin."""
        if reading.alarm is not None:
            return reading.alarm
        off = [f"axis {axis} reads {units:g}" for axis, units in reading.units.items() if units != 0]
        return f"{', '.join(off)} pulses, not 0" if off else None

    def _status(self) -> tuple[Status, Reading]:
        frame = command("Q:")
        try:
            status = parse_status(self._status_line(frame))
        except ValueError as error:
            raise self.link.failure(str(error), sent=frame, kind=ReplyError) from None
        needed = max(int(axis.device) for axis in self._axes)
        if len(status.positions) < needed:
            problem = f"reports {len(status.positions)} axes, and the rig uses axis {needed}"
            raise self.link.failure(problem, sent=frame, kind=ReplyError)
        alarm = f"{status.limit} stopped at the limit switch" if status.limit and not status.busy else None
        units = {axis.device: float(status.positions[int(axis.device) - 1]) for axis in self._axes}
        return status, Reading(units=units, moving=status.busy, alarm=alarm)

    def _status_line(self, frame: bytes) -> bytes:
        return self.link.query(frame, end=END)


class ShotDialogue(_SigmakokiDialogue):
    RTSCTS = True
    SPEEDS = (1, 500_000)

    def prepare(self) -> None:
        for axis in self._axes:
            fast = round(axis.speed_units())
            slow = max(self.SPEEDS[0], fast // 10)
            text = f"D:{axis.device}S{slow}F{fast}R{RAMP_MS}"
            self._retry.run(lambda text=text: self._command(text))

    def go(self, targets: Mapping[str, float]) -> None:
        """Set the targets, which may be repeated, and go, which may not."""
        text = axis_command("A", {axis: signed(round(units)) for axis, units in targets.items()})
        self._retry.run(lambda: self._command(text))
        self._command("G:")

    def home(self) -> None:
        self._command("H:W" if len(self._axes) == 2 else f"H:{self._axes[0].device}")

    def halt(self) -> None:
        self._retry.run(lambda: self._command("L:E"))

    def _command(self, text: str) -> None:
        reply = self.link.query(command(text), end=END)
        if reply == b"NG\r\n":
            raise self.link.failure(f"refused (NG): {_REFUSED}", sent=command(text), reply=reply)
        if reply != b"OK\r\n":
            raise self.link.failure("expected OK or NG", sent=command(text), reply=reply, kind=ReplyError)


class GscDialogue(_SigmakokiDialogue):
    SPEEDS = (_GSC_SPEEDS[1][0], _GSC_SPEEDS[2][1])

    @classmethod
    def check_axes(cls, axes: Sequence[Axis]) -> None:
        super().check_axes(axes)
        _speed_command(axes)

    def check(self, targets: Mapping[str, float]) -> None:
        """Raise an InputError for a way that is longer than the command can express."""
        here = self.read().units
        for axis, target in targets.items():
            if (way := abs(target - here[axis])) > _GSC_FARTHEST:
                more = f"{way:.0f} pulses in one move are more than the {_GSC_FARTHEST} that the controller takes"
                raise InputError(f"stage axis {axis}: {more}; nothing was moved")

    def prepare(self) -> None:
        self._command(_speed_command(self._axes))

    def go(self, targets: Mapping[str, float]) -> None:
        """Set the way from here, and go; each command is sent once."""
        here = self.read().units
        self._command(axis_command("M", {axis: signed(round(units - here[axis])) for axis, units in targets.items()}))
        self._command("G:")

    def home(self) -> None:
        senses = {axis.device: "+" if axis.home_sense > 0 else "-" for axis in self._axes}
        self._command(axis_command("H", senses))

    def halt(self) -> None:
        """L:E also stops the search for the origin, which L:1 does not."""
        self._command("L:E")

    def _command(self, text: str) -> None:
        """Send a command, and query whether it was accepted."""
        self.link.send(command(text))
        status, _ = self._retry.run(self._status)
        if not status.accepted:
            raise self.link.failure(f"refused (ACK1 is X): {_REFUSED}", sent=command(text))

    def _status_line(self, frame: bytes) -> bytes:
        line = super()._status_line(frame)
        if line in (b"OK\r\n", b"NG\r\n"):  # from a controller that answers to commands as well
            line = self.link.read(end=END, after=frame)
        return line


def _speed_command(axes: Sequence[Axis]) -> str:
    """The command that sets both speeds; an axis that the rig does not use gets the other's."""
    speeds = {axis.device: round(axis.speed_units()) for axis in axes}
    given = next(iter(speeds.values()))
    both = [speeds.get("1", given), speeds.get("2", given)]
    for number, (slowest, fastest) in reversed(_GSC_SPEEDS.items()):
        if all(slowest <= speed <= fastest for speed in both):
            words = "".join(f"S{max(slowest, speed // 10)}F{speed}R{RAMP_MS}" for speed in both)
            return f"D:{number}{words}"
    ranges = "in different ranges of the controller (1 to 200, 50 to 20000), and it takes both from one"
    raise InputError(f"stage: the speeds {both[0]} and {both[1]} pulses/s are {ranges}; change speed_deg_per_s")
