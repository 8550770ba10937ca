"""Zaber controllers, in the ASCII protocol with message numbers and checksums; positions in microsteps.

``move abs`` starts a move and is answered at once; each reply shows whether the axis moves and its gravest warning.
``WR`` and ``WH`` mean that the axis has not been homed, flags that begin with F that it has failed. Faults stay until a
person clears them with ``warnings clear``.

Source: the protocol's public description; the checksums in the tests are those that Zaber's own library sends.
"""

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lightopt.core.errors import InputError
from lightopt.rig.devices._device import ReplyError, printable
from lightopt.rig.devices._serial_link import SerialLink
from lightopt.rig.devices._stage import Axis, Dialogue, Reading

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
    "NU": "a setting waits for a restart",
}
_REJECTIONS = {
    "AGAIN": "not now; send again",
    "BADAXIS": "the device has no such axis",
    "BADCOMMAND": "unknown command or setting",
    "BADDATA": "the value is wrong or out of range",
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
    """A reply of a device or axis."""

    device: int
    axis: int
    number: int | None  # of the message that it answers; None when it has none
    accepted: bool  # OK rather than RJ
    busy: bool
    warning: str  # flag of the gravest warning; empty without one
    data: str  # the answer, or why it was rejected


def checksum(body: bytes) -> bytes:
    """LRC of a message without its first and last characters: two's complement of the sum, two hexadecimal digits."""
    return f"{-sum(body) & 0xFF:02X}".encode("ascii")


def frame(device: int, axis: int, number: int, command: str) -> bytes:
    body = f"{device} {axis} {number:02d} {command}".rstrip().encode("ascii")
    return b"/" + body + b":" + checksum(body) + b"\n"


def parse_reply(line: bytes) -> Reply:
    r"""Read a reply.

    Raises ValueError when it is none, or its checksum is wrong.

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


_SPEED_UNIT = 1.6384  # maxspeed per microstep per second
_STOPS = frozenset({"WL"})  # warnings after which the position is not to be trusted


class ZaberDialogue(Dialogue):
    """The Zaber ASCII protocol. Axes are called ``2`` (axis 2 of device 1) or ``2/1`` (axis 1 of device 2)."""

    BAUD = 115200

    def __init__(self, link: SerialLink, axes: Sequence[Axis], **options: Any) -> None:
        super().__init__(link, axes, **options)
        self._addresses = {axis.device: _address(axis) for axis in axes}
        self._devices = sorted({device for device, _ in self._addresses.values()})
        self._number = 0
        self._limits: dict[str, tuple[int, int]] = {}
        self._noted: set[str] = set()

    @classmethod
    def check_axes(cls, axes: Sequence[Axis]) -> None:
        if len({_address(axis) for axis in axes}) < len(axes):
            raise InputError("stage: elevation and rotation are the same axis of the controller")

    def identify(self) -> dict[str, str]:
        details: dict[str, str] = {}
        for device in self._devices:
            for setting in ("deviceid", "system.serial", "version"):
                reply = self._retry.run(lambda d=device, s=setting: self._exchange(d, 0, f"get {s}"))
                if reply.accepted:
                    key = setting.removeprefix("system.")
                    details[f"{key}{device if device > 1 else ''}"] = reply.data
        return details

    def read(self) -> Reading:
        units: dict[str, float] = {}
        moving, homed = False, True
        alarms: list[str] = []
        for axis in self._axes:
            reply, position = self._retry.run(lambda axis=axis: self._number_of(axis.device, "get pos"))
            units[axis.device] = float(position)
            moving = moving or reply.busy
            homed = homed and reply.warning not in NOT_HOMED
            if reply.warning.startswith("F") or reply.warning in _STOPS:
                advice = f"clear it with /{self._addresses[axis.device][0]} warnings clear, and home it"
                cause = f"axis {axis.device}: {_described(reply.warning, _WARNINGS)}"
                alarms.append(f"{cause}; when the cause is found, {advice}")
            elif reply.warning and reply.warning not in NOT_HOMED and reply.warning not in self._noted:
                self._noted.add(reply.warning)
                self.link.note(f"axis {axis.device} warns {_described(reply.warning, _WARNINGS)}")
        return Reading(units=units, moving=moving, referenced=homed, alarm="; ".join(alarms) or None)

    def check(self, targets: Mapping[str, float]) -> None:
        """Raise an InputError for targets outside the device's own limits."""
        for axis in self._axes:
            low, high = self._limits_of(axis.device)
            if not low <= targets[axis.device] <= high:
                outside = f"position {targets[axis.device]:.0f} lies outside the device's limits {low} … {high}"
                advice = "set zero and steps_per_deg in hardware.stage, or limit.min and limit.max in the device"
                raise InputError(f"stage axis {axis.name}: {outside}; {advice}; nothing was moved")

    def prepare(self) -> None:
        """Set the speed of each axis where it is another; the device keeps it."""
        for axis in self._axes:
            wanted = max(1, round(axis.speed_units() * _SPEED_UNIT))
            _, holds = self._retry.run(lambda axis=axis: self._number_of(axis.device, "get maxspeed"))
            if holds != wanted:
                self._retry.run(lambda axis=axis, v=wanted: self._accepted(axis.device, f"set maxspeed {v}"))
                self.link.note(f"axis {axis.device}: maxspeed was {holds}, set to {wanted}")

    def go(self, targets: Mapping[str, float]) -> None:
        """Start each axis; no command is sent again if its reply is lost."""
        self._start({axis: f"move abs {round(units)}" for axis, units in targets.items()})

    def home(self) -> None:
        self._start({axis.device: "home" for axis in self._axes})

    def homed(self, reading: Reading) -> str | None:
        """The device reports itself whether it is homed."""
        unknown = None if reading.referenced else "it still warns that it has no reference position"
        return reading.alarm or unknown

    def halt(self) -> None:
        for device in self._devices:
            reply = self._retry.run(lambda d=device: self._exchange(d, 0, "stop"))
            if not reply.accepted:
                raise self.link.failure(f"device {device} refused to stop: {_described(reply.data, _REJECTIONS)}")

    def _start(self, commands: Mapping[str, str]) -> None:
        """Send each axis its command once; a lost reply does not keep the other axes from theirs."""
        lost: ReplyError | None = None
        for axis, command in commands.items():
            try:
                self._accepted(axis, command)
            except ReplyError as error:  # noqa: PERF203  (a serial line is slower)
                lost = error
        if lost is not None:
            raise lost

    def _limits_of(self, axis: str) -> tuple[int, int]:
        if axis not in self._limits:
            _, low = self._retry.run(lambda: self._number_of(axis, "get limit.min"))
            _, high = self._retry.run(lambda: self._number_of(axis, "get limit.max"))
            self._limits[axis] = (low, high)
        return self._limits[axis]

    def _number_of(self, axis: str, command: str) -> tuple[Reply, int]:
        reply = self._accepted(axis, command)
        if re.fullmatch(r"-?\d+", reply.data) is None:
            frames = {"sent": command.encode(), "reply": reply.data.encode()}
            raise self.link.failure("expected a whole number", **frames, kind=ReplyError)
        return reply, int(reply.data)

    def _accepted(self, axis: str, command: str) -> Reply:
        reply = self._exchange(*self._addresses[axis], command)
        if not reply.accepted:
            why = f"axis {axis} rejected it: {_described(reply.data, _REJECTIONS)}"
            raise self.link.failure(why, sent=command.encode("ascii"))
        return reply

    def _exchange(self, device: int, axis: int, command: str) -> Reply:
        """Send a numbered command and return the reply with its number, passing over other messages of the devices."""
        with self.link.lock:
            self._number = (self._number + 1) % 100
            sent = frame(device, axis, self._number, command)
            self.link.send(sent)
            until = time.monotonic() + self.link.timeout_s
            while True:
                line = self.link.read(end=b"\n", deadline_s=max(0.0, until - time.monotonic()), after=sent)
                if line[:1] in (b"!", b"#"):  # alerts and comments
                    continue
                try:
                    reply = parse_reply(line)
                except ValueError as error:
                    raise self.link.failure(str(error), sent=sent, reply=line, kind=ReplyError) from None
                if (reply.device, reply.axis, reply.number) == (device, axis, self._number):
                    return reply
                self.link.note(f"passed over {line!r}, which answers something else")


def _address(axis: Axis) -> tuple[int, int]:
    device, _, number = axis.device.rpartition("/")
    return int(device or 1), int(number)


def _described(text: str, meanings: Mapping[str, str]) -> str:
    """A flag, or a reason with its details, and its meaning."""
    return f"{text} ({meanings.get(text.split(' ')[0], 'unknown')})"
