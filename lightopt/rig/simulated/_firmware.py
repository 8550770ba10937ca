"""Registry of simulated firmware, and what all of it, all lamps and all axes share. Add a new device here.

Firmware is written from the tables of its protocol, not from the driver: the two meet on the wire only.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any, ClassVar

from lightopt.core.arrays import Float64

_LONGEST = 256  # bytes of an incomplete command that are kept


@dataclass(frozen=True)
class SeenPicture:
    """What a screen shows; `number` is that of the picture, the same whenever it is shown."""

    number: int
    radiance: Float64  # shares of the full one as seen from the part, `along` upwards, shape (rows, columns)
    rounding: Float64  # how far that may be from what was meant, since levels are whole numbers; likewise


class Firmware:
    """A device behind a wire. Time [s] is given, never read, so that a dialogue can be replayed."""

    END: ClassVar[bytes] = b"\r\n"  # of a command

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes off the wire and return the bytes to send; an incomplete command is kept."""
        *whole, rest = (self._buffer + data).split(self.END)
        self._buffer = rest[-_LONGEST:]
        return b"".join(self._answer(command, now) for command in whole)

    def _answer(self, command: bytes, now: float) -> bytes:
        """Obey a command, without its end, and return the bytes to send; not where `feed` is another."""
        raise NotImplementedError

    def poll(self, now: float) -> bytes:  # noqa: ARG002
        """Bytes that the device sends on its own or late (banners, withheld replies); often none."""
        return b""

    def levels(self) -> dict[int, float] | None:
        """Brightness of each channel from 1 up, as a share of the highest; None for what is no light controller."""
        return None

    def picture(self) -> SeenPicture | None:
        """What a screen shows; None for what is no screen."""
        return None

    def positions(self, now: float) -> dict[str, float] | None:  # noqa: ARG002
        """Where each axis really stands, in device units by the axis' name; None for what is no stage."""
        return None


# Module of each protocol's firmware, imported when needed: a bench of two devices does not load the others.
FIRMWARE = {
    **{kind: f"_light_{kind}" for kind in ("ccs", "sa", "template", "screen")},
    **dict.fromkeys(("shot", "gsc"), "_stage_sigmakoki"),
    **{kind: f"_stage_{kind}" for kind in ("grbl", "zaber")},
}


def build(kind: str, options: dict[str, Any]) -> Firmware:
    """Power up the firmware of a protocol; a ValueError for an unknown one, or options that it refuses."""
    if kind not in FIRMWARE:
        raise ValueError(f'no firmware called "{kind}"; there is {", ".join(FIRMWARE)}')
    module: Any = import_module(f"{__package__}.{FIRMWARE[kind]}")
    try:
        return getattr(module, f"{kind.capitalize()}Firmware")(**options)
    except TypeError as error:
        raise ValueError(f"firmware {kind}: {error}") from None


class LampFirmware(Firmware):
    """Firmware of a light controller: intensity and switch of each channel, counted from 1.

    levels: Intensities at power-up by channel, 0 where absent. Keys may be text, as in JSON.
    on: Whether the channels are switched on at power-up.
    """

    def __init__(
        self, *, channels: int = 4, top_level: int = 255, levels: Mapping[str, int] | None = None, on: bool = True
    ) -> None:
        super().__init__()
        self._channels = channels
        self._top_level = top_level
        self._level = dict.fromkeys(range(1, channels + 1), 0)
        self._on = dict.fromkeys(range(1, channels + 1), on)
        for channel, level in (levels or {}).items():
            if int(channel) not in self._level or not 0 <= level <= top_level:
                raise ValueError(f"no level {level} on channel {channel} of {channels}")
            self._level[int(channel)] = level

    def levels(self) -> dict[int, float]:
        return {channel: level / self._top_level * self._on[channel] for channel, level in self._level.items()}


class SimulatedAxis:
    """One axis of constant speed: where it really `stands` at power-up, and its limit switches.

    An axis has a count, which its controller believes, and a place where it really stands, from its mechanical origin;
    both in device units. They agree once it has been homed and while no step is lost.
    """

    def __init__(self, *, stands: float = 0.0, low: float = -math.inf, high: float = math.inf) -> None:
        self._low = low
        self._high = high
        self._offset = stands  # real = count + offset
        self._start = self._end = 0.0
        self._began = 0.0
        self._speed = 1.0
        self._homing: float | None = None
        self._ends_at_switch = False
        self.at_limit = False  # whether the last move ended at a switch
        self.homed = False  # whether it has found its origin since power-up

    def count(self, now: float) -> float:
        """What the controller believes."""
        self._advance(now)
        way = self._end - self._start
        gone = min(abs(way), self._speed * max(0.0, now - self._began))
        return self._start + math.copysign(gone, way)

    def real(self, now: float) -> float:
        return self.count(now) + self._offset

    def moving(self, now: float) -> bool:
        self._advance(now)
        return self._end != self._start

    def home(self, speed: float, now: float, *, becomes: float = 0.0) -> None:
        """Seek the place that many units from the mechanical origin, where the count becomes right."""
        self.homed = False
        self.move(becomes - self._offset, speed, now, homing=becomes)

    def stop(self, now: float) -> None:
        self._start = self._end = self.count(now)
        self._homing = None

    def move(self, target: float, speed: float, now: float, *, homing: float | None = None) -> None:
        """Move the count to a target at a speed [units/s], or seek the origin, where it becomes `homing`."""
        self.at_limit = False
        self._start = self.count(now)
        self._began = now
        self._speed = speed
        self._homing = homing
        real = target + self._offset
        self._ends_at_switch = not self._low <= real <= self._high
        if self._ends_at_switch:
            target = min(max(real, self._low), self._high) - self._offset
        self._end = target
        if self._end == self._start:
            self._arrived()

    def _advance(self, now: float) -> None:
        if self._end != self._start and now >= self._began + abs(self._end - self._start) / self._speed:
            self._start = self._end
            self._arrived()

    def _arrived(self) -> None:
        if self._ends_at_switch:
            self.at_limit = True
        elif self._homing is not None:
            self._offset = 0.0
            self._start = self._end = self._homing
            self.homed = True
        self._homing = None
        self._ends_at_switch = False


class StageFirmware(Firmware):
    """Firmware of a stage, whose axes have names; `axes` are the arguments of each :class:`SimulatedAxis`."""

    def __init__(self, axes: Mapping[str, Mapping[str, float]]) -> None:
        super().__init__()
        if not axes:
            raise ValueError("a stage has at least one axis")
        self._axes = {name: SimulatedAxis(**options) for name, options in axes.items()}

    def positions(self, now: float) -> dict[str, float]:
        return {name: axis.real(now) for name, axis in self._axes.items()}

    def _axes_move(self, now: float) -> bool:
        return any(axis.moving(now) for axis in self._axes.values())

    def _stop_axes(self, now: float) -> None:
        for axis in self._axes.values():
            axis.stop(now)
