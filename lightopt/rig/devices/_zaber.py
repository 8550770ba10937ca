"""Zaber controllers, in the ASCII protocol with message numbers and checksums; positions in microsteps.

``move abs`` starts a move and is answered at once; each reply tells whether the axis moves and its gravest warning.
``WR`` and ``WH`` say that the axis has not been homed, flags that begin with F that it has failed. Faults stay until a
person clears them with ``warnings clear``.
"""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lightopt.core.errors import InputError
from lightopt.rig.devices._axes import Axis
from lightopt.rig.devices._dialogue import Reading
from lightopt.rig.devices._errors import ReplyError
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._retry import Persistence
from lightopt.rig.devices._zaber_messages import (
    NOT_HOMED,
    Reply,
    frame,
    parse_reply,
    rejection_words,
    warning_words,
)

_SPEED_UNIT = 1.6384  # maxspeed per microstep per second
_STOPS = frozenset({"WL"})  # warnings after which the position is not to be trusted
_ADDRESS = re.compile(r"(?:(?P<device>[1-9]\d?)/)?(?P<axis>[1-9])")


@dataclass(frozen=True)
class _Address:
    device: int
    axis: int


def check_zaber(axes: Sequence[Axis]) -> None:
    """Refuse axes that the protocol cannot address."""
    if len({_address(axis) for axis in axes}) < len(axes):
        raise InputError("stage: elevation and rotation are the same axis of the controller")


class ZaberDialogue:
    """The Zaber ASCII protocol; see :class:`~lightopt.rig.devices._dialogue.Dialogue`.

    Parameters
    ----------
    link
        The wire.
    axes
        The axes, called ``2`` (axis 2 of device 1) or ``2/1`` (axis 1 of device 2).

    Raises
    ------
    lightopt.core.errors.InputError
        For an axis with another kind of name, or the same axis twice.
    """

    def __init__(self, link: SerialLink, axes: Sequence[Axis]) -> None:
        self.link = link
        self.homes_to_end = False
        self._patience = Persistence(link)
        self._axes = tuple(axes)
        check_zaber(axes)
        self._addresses = {axis.device: _address(axis) for axis in axes}
        self._number = 0
        self._limits: dict[str, tuple[int, int]] = {}
        self._told: set[str] = set()

    def says(self) -> dict[str, str]:
        """Kind, serial number and firmware of each device."""
        says: dict[str, str] = {}
        for device in sorted({address.device for address in self._addresses.values()}):
            for key, setting in (
                ("deviceid", "deviceid"),
                ("serial", "system.serial"),
                ("version", "version"),
            ):
                reply = self._patience.ask(lambda d=device, s=setting: self._exchange(d, 0, f"get {s}"))
                if reply.accepted:
                    says[f"{key}{device if device > 1 else ''}"] = reply.data
        return says

    def read(self) -> Reading:
        """Position, motion and warnings of each axis."""
        units: dict[str, float] = {}
        moving, homed = False, True
        alarms: list[str] = []
        for axis in self._axes:
            reply, position = self._patience.ask(lambda axis=axis: self._number_of(axis.device, "get pos"))
            units[axis.device] = float(position)
            moving = moving or reply.busy
            homed = homed and reply.warning not in NOT_HOMED
            if reply.warning.startswith("F") or reply.warning in _STOPS:
                alarms.append(
                    f"axis {axis.device}: {warning_words(reply.warning)}; when the cause is found, clear it with "
                    f"/{self._addresses[axis.device].device} warnings clear, and home it"
                )
            elif reply.warning and reply.warning not in NOT_HOMED and reply.warning not in self._told:
                self._told.add(reply.warning)
                self.link.note(f"axis {axis.device} warns {warning_words(reply.warning)}")
        return Reading(units=units, moving=moving, referenced=homed, alarm="; ".join(alarms) or None)

    def step(self, axis: Axis) -> float:  # noqa: ARG002  (the same for all)
        """One microstep."""
        return 1.0

    def check(self, targets: Mapping[str, float]) -> None:
        """Raise an InputError for targets outside the device's own limits."""
        for axis in self._axes:
            low, high = self._limits_of(axis.device)
            if not low <= targets[axis.device] <= high:
                raise InputError(
                    f"stage axis {axis.name}: position {targets[axis.device]:.0f} lies outside the device's limits "
                    f"{low} … {high} (limit.min, limit.max); set zero and steps_per_deg in the rig's "
                    "hardware.stage, or the limits of the device; nothing was moved"
                )

    def prepare(self) -> None:
        """Set the speed of each axis where it is another; the device keeps it."""
        for axis in self._axes:
            wanted = max(1, round(axis.speed_units() * _SPEED_UNIT))
            _, holds = self._patience.ask(lambda axis=axis: self._number_of(axis.device, "get maxspeed"))
            if holds != wanted:
                self._patience.ask(
                    lambda axis=axis, v=wanted: self._accepted(axis.device, f"set maxspeed {v}")
                )
                self.link.note(f"axis {axis.device}: maxspeed was {holds}, set to {wanted}")

    def go(self, targets: Mapping[str, float]) -> None:
        """Start each axis; a reply that is lost is not asked for again."""
        self._start({axis: f"move abs {round(units)}" for axis, units in targets.items()})

    def home(self) -> None:
        """Start to seek the home position of each axis in use."""
        self._start({axis.device: "home" for axis in self._axes})

    def homed(self, reading: Reading) -> str | None:
        """The device itself says whether it is."""
        if reading.alarm is not None:
            return reading.alarm
        return None if reading.referenced else "it still warns that it has no reference position"

    def halt(self) -> None:
        """Stop every axis of each device."""
        for device in sorted({address.device for address in self._addresses.values()}):
            reply = self._patience.ask(lambda d=device: self._exchange(d, 0, "stop"))
            if not reply.accepted:
                raise self.link.failure(f"device {device} refused to stop: {rejection_words(reply.data)}")

    def _start(self, commands: Mapping[str, str]) -> None:
        """Send each axis its command once; one whose reply is lost does not keep the others from theirs."""
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
            low, high = (
                self._patience.ask(lambda s=setting: self._number_of(axis, f"get {s}"))[1]
                for setting in ("limit.min", "limit.max")
            )
            self._limits[axis] = (low, high)
        return self._limits[axis]

    def _number_of(self, axis: str, command: str) -> tuple[Reply, int]:
        reply = self._accepted(axis, command)
        if re.fullmatch(r"-?\d+", reply.data) is None:
            raise ReplyError(
                self.link.words("expected a whole number", sent=command.encode(), reply=reply.data.encode())
            )
        return reply, int(reply.data)

    def _accepted(self, axis: str, command: str) -> Reply:
        address = self._addresses[axis]
        reply = self._exchange(address.device, address.axis, command)
        if not reply.accepted:
            raise self.link.failure(
                f"axis {axis} rejected it: {rejection_words(reply.data)}", sent=command.encode("ascii")
            )
        return reply

    def _exchange(self, device: int, axis: int, command: str) -> Reply:
        """Send a numbered command and return the reply with its number, passing over what else the devices say."""
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
                    raise ReplyError(self.link.words(str(error), sent=sent, reply=line)) from None
                if (reply.device, reply.axis, reply.number) == (device, axis, self._number):
                    return reply
                self.link.note(f"passed over {line!r}, which answers something else")


def _address(axis: Axis) -> _Address:
    match = _ADDRESS.fullmatch(axis.device)
    if match is None:
        raise InputError(
            f"stage axis {axis.name}: expected an axis of device 1 (2), or device/axis (2/1), found {axis.device}"
        )
    return _Address(device=int(match["device"] or 1), axis=int(match["axis"]))
