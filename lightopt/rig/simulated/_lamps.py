"""What the channels of a simulated light controller hold and really shine, the faults of its lamps included."""

from collections.abc import Mapping
from typing import Any, ClassVar

from lightopt.rig.simulated._firmware import Firmware


class Lamps:
    """Intensity and switch of each channel, counted from 1.

    Faults: ``dark`` (the lamp gives no light, the controller does not know), ``lit`` (it is on at full brightness, the
    controller does not know), ``deaf`` (the controller acknowledges and keeps what it has), ``aged`` (it gives that
    ``share`` of its light), ``swapped`` (its plug is where that of channel ``other`` belongs, and the other way round),
    each for one channel; ``power_cycle`` (the channels are as at power-up).

    levels: Intensities at power-up by channel, 0 where absent. Keys may be text, as in JSON.
    level, on: Intensity that each channel holds, and whether it is switched on.
    """

    FAULTS = ("dark", "lit", "deaf", "aged", "swapped", "power_cycle")

    def __init__(
        self, channels: int, top_level: int, levels: Mapping[str, int] | None = None, *, on: bool = True
    ) -> None:
        self.channels = channels
        self.top_level = top_level
        self.level = dict.fromkeys(range(1, channels + 1), 0)
        self.on = dict.fromkeys(range(1, channels + 1), on)
        self._faults: dict[int, str] = {}
        self._aged: dict[int, float] = {}
        self._lamp_of = {channel: channel for channel in self.level}
        for channel, level in (levels or {}).items():
            if int(channel) not in self.level or not 0 <= level <= top_level:
                raise ValueError(f"no level {level} on channel {channel} of {channels}")
            self.level[int(channel)] = level
        self._at_power_up = dict(self.level), dict(self.on)

    def set_level(self, channel: int, level: int) -> None:
        if self._faults.get(channel) != "deaf":
            self.level[channel] = level

    def switch(self, channel: int, on: bool) -> None:
        if self._faults.get(channel) != "deaf":
            self.on[channel] = on

    def inject(self, fault: str, options: Mapping[str, Any], known: tuple[str, ...] = ()) -> None:
        """Let a channel suffer a fault: one of `FAULTS`, or ``clear``; `known` are others, for the message."""
        if fault == "clear":
            self._faults.clear()
            self._aged.clear()
            self._lamp_of = {channel: channel for channel in self.level}
            return
        if fault not in self.FAULTS:
            raise ValueError(f'no fault called "{fault}"; there are {", ".join((*self.FAULTS, *known, "clear"))}')
        if fault == "power_cycle":
            self.level, self.on = (dict(held) for held in self._at_power_up)
            return
        more = {"aged": {"share"}, "swapped": {"other"}}.get(fault, set[str]())
        if set(options) != {"channel", *more} or options["channel"] not in self.level:
            wants = "".join(f" and {name}" for name in more)
            raise ValueError(f"{fault} wants a channel from 1 to {self.channels}{wants}, got {dict(options)}")
        if fault == "aged":
            self._aged[options["channel"]] = float(options["share"])
            return
        if fault == "swapped":
            if options["other"] not in self.level:
                raise ValueError(f"swapped wants another channel from 1 to {self.channels}, got {dict(options)}")
            channel, other = options["channel"], options["other"]
            self._lamp_of |= {channel: other, other: channel}
            return
        self._faults[options["channel"]] = fault

    def brightness(self, *, lit: bool = True) -> dict[int, float]:
        """Brightness of each channel as a share of the highest; `lit` is False where a master switch is off."""
        return {
            lamp: self._share(channel, lit=lit) * self._aged.get(lamp, 1.0) for channel, lamp in self._lamp_of.items()
        }

    def _share(self, channel: int, *, lit: bool) -> float:
        fault = self._faults.get(channel)
        if fault == "dark":
            return 0.0
        if fault == "lit":
            return 1.0
        return self.level[channel] / self.top_level if lit and self.on[channel] else 0.0


class LampFirmware(Firmware):
    """What the firmware of light controllers shares: lamps with their faults, and ``ng``, which refuses commands."""

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"ng": {}}

    def __init__(self, lamps: Lamps) -> None:
        super().__init__()
        self._lamps = lamps

    def levels(self) -> dict[int, float]:
        return self._lamps.brightness()

    def _suffer(self, fault: str, options: Mapping[str, Any], now: float) -> None:  # noqa: ARG002
        self._lamps.inject(fault, options, tuple(self.FAULTS))
