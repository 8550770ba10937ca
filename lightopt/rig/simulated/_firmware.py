"""Registry of simulated firmware, what all of it and all lamps share, and when faults strike. Add a new device here.

Firmware is written from the tables of its protocol, not from the driver: the two meet on the wire only. A fault strikes
by count or by seeded chance, so that a failed test can be run again.
"""

import random
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, ClassVar, cast


class Trigger:
    """Decides whether a fault strikes: `after` so many occasions, `count` times (None: always), by a seeded chance."""

    struck = 0  # how often faults struck in this process, those of all triggers together

    def __init__(self, *, after: int = 0, count: int | None = 1, probability: float = 1.0, seed: int = 0) -> None:
        if after < 0 or (count is not None and count < 1) or not 0 <= probability <= 1:
            raise ValueError("after counts from 0, count from 1, and probability lies between 0 and 1")
        self._after = after
        self._left = count
        self._probability = probability
        self._random = random.Random(seed)  # noqa: S311  (chance of a fault, not a secret)

    def strikes(self) -> bool:
        """Whether the fault strikes at this occasion."""
        if self._after > 0:
            self._after -= 1
            return False
        if self._left == 0 or self._random.random() >= self._probability:
            return False
        if self._left is not None:
            self._left -= 1
        Trigger.struck += 1
        return True


def trigger(fault: str, options: Mapping[str, Any]) -> Trigger:
    """Trigger of a fault from the options of a request; a ValueError names the fault."""
    try:
        return Trigger(**options)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{fault}: {error}") from None


class Firmware(ABC):
    """A device behind a wire. Time [s] is given, never read, so that a dialogue can be replayed."""

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    """Faults of replies by name, each with its option, if any, and the default of that, beside the trigger's."""

    def __init__(self) -> None:
        self._buffer = b""
        self._faults: dict[str, tuple[Trigger, Any]] = {}

    def _whole_commands(self, end: bytes, longest: int) -> list[bytes]:
        """Whole commands in the buffer, without their end; an incomplete one is kept, of no more than so many bytes."""
        *whole, rest = self._buffer.split(end)
        self._buffer = rest[-longest:]
        return whole

    @abstractmethod
    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes off the wire and return the bytes to send; incomplete commands are kept."""

    def poll(self, now: float) -> bytes:  # noqa: ARG002
        """Bytes that the device sends on its own or late (banners, withheld replies); often none."""
        return b""

    def levels(self) -> dict[int, float] | None:
        """Brightness of each channel from 1 up, as a share of the highest; None for what is no light controller."""
        return None

    def positions(self, now: float) -> dict[str, float] | None:  # noqa: ARG002
        """Where each axis really stands, in device units by the axis' name; None for what is no stage."""
        return None

    def inject(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        """Set a fault of the device from now on, none of the line; ``clear`` ends all. ValueError lists the faults."""
        if fault in self.FAULTS:
            own = self.FAULTS[fault]
            values = {**own, **options}
            value = next((values.pop(name) for name in own), True)
            self._faults[fault] = (trigger(fault, values), value)
            return
        if fault == "clear":
            self._faults.clear()
        self._suffer(fault, options, now)

    @abstractmethod
    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:
        """Set a fault of the lamps or axes, or of the whole device."""

    def _struck(self, fault: str) -> Any:
        """Option of a fault of replies that strikes now, True where it has none; None where it does not strike."""
        strikes, value = self._faults.get(fault, (None, None))
        return value if strikes is not None and strikes.strikes() else None


# Imported when needed: a bench of two devices does not load the others.
FIRMWARE = {
    "ccs": ("_light_ccs", "CcsFirmware"),
    "sa": ("_light_sa", "SaFirmware"),
    "template": ("_light_template", "TemplateFirmware"),
    "shot": ("_stage_sigmakoki", "ShotFirmware"),
    "gsc": ("_stage_sigmakoki", "GscFirmware"),
    "grbl": ("_stage_grbl", "GrblFirmware"),
    "zaber": ("_stage_zaber", "ZaberFirmware"),
}


def build(kind: str, options: dict[str, Any]) -> Firmware:
    """Power up the firmware of a protocol; a ValueError for an unknown one, or options that it refuses."""
    if kind not in FIRMWARE:
        raise ValueError(f'no firmware called "{kind}"; there is {", ".join(FIRMWARE)}')
    module, name = FIRMWARE[kind]
    make = cast("Callable[..., Firmware]", getattr(import_module(f"{__package__}.{module}"), name))
    try:
        return make(**options)
    except TypeError as error:
        raise ValueError(f"firmware {kind}: {error}") from None


_FAULTS = ("dark", "lit", "deaf", "aged", "swapped", "power_cycle")


class LampFirmware(Firmware):
    """Firmware of a light controller: intensity and switch of each channel, counted from 1.

    Faults: ``ng`` (a command is refused); ``dark`` (the lamp gives no light, the controller does not know), ``lit`` (it
    is on at full brightness, the controller does not know), ``deaf`` (the controller acknowledges and keeps what it
    has), ``aged`` (it gives that ``share`` of its light), ``swapped`` (its plug is where that of channel ``other``
    belongs, and the other way round), each for one channel; ``power_cycle`` (the channels are as at power-up).

    levels: Intensities at power-up by channel, 0 where absent. Keys may be text, as in JSON.
    on: Whether the channels are switched on at power-up.
    """

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"ng": {}}

    def __init__(
        self, *, channels: int = 4, top_level: int = 255, levels: Mapping[str, int] | None = None, on: bool = True
    ) -> None:
        super().__init__()
        self._channels = channels
        self._top_level = top_level
        self._level = dict.fromkeys(range(1, channels + 1), 0)
        self._on = dict.fromkeys(range(1, channels + 1), on)
        self._lamp_faults: dict[int, str] = {}
        self._aged: dict[int, float] = {}
        self._lamp_of = {channel: channel for channel in self._level}
        for channel, level in (levels or {}).items():
            if int(channel) not in self._level or not 0 <= level <= top_level:
                raise ValueError(f"no level {level} on channel {channel} of {channels}")
            self._level[int(channel)] = level
        self._at_power_up = dict(self._level), dict(self._on)

    def _set_level(self, channel: int, level: int) -> None:
        if self._lamp_faults.get(channel) != "deaf":
            self._level[channel] = level

    def _switch(self, channel: int, on: bool) -> None:
        if self._lamp_faults.get(channel) != "deaf":
            self._on[channel] = on

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:  # noqa: ARG002
        if fault == "clear":
            self._lamp_faults.clear()
            self._aged.clear()
            self._lamp_of = {channel: channel for channel in self._level}
            return
        if fault not in _FAULTS:
            raise ValueError(f'no fault called "{fault}"; there are {", ".join((*_FAULTS, *self.FAULTS, "clear"))}')
        if fault == "power_cycle":
            self._level, self._on = (dict(held) for held in self._at_power_up)
            return
        more = {"aged": {"share"}, "swapped": {"other"}}.get(fault, set[str]())
        if set(options) != {"channel", *more} or options["channel"] not in self._level:
            wants = "".join(f" and {name}" for name in more)
            raise ValueError(f"{fault} wants a channel from 1 to {self._channels}{wants}, got {dict(options)}")
        channel = options["channel"]
        if fault == "aged":
            self._aged[channel] = float(options["share"])
        elif fault == "swapped":
            other = options["other"]
            if other not in self._level:
                raise ValueError(f"swapped wants another channel from 1 to {self._channels}, got {dict(options)}")
            self._lamp_of |= {channel: other, other: channel}
        else:
            self._lamp_faults[channel] = fault

    def levels(self) -> dict[int, float]:
        return {lamp: self._share(channel) * self._aged.get(lamp, 1.0) for channel, lamp in self._lamp_of.items()}

    def _share(self, channel: int) -> float:
        fault = self._lamp_faults.get(channel)
        if fault == "dark":
            return 0.0
        if fault == "lit":
            return 1.0
        return self._level[channel] / self._top_level if self._on[channel] else 0.0
