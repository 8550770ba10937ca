"""What the channels of a simulated light controller hold and really shine, the faults of its lamps included."""

from collections.abc import Mapping
from typing import Any, ClassVar

from lightopt.rig.simulated._firmware import Firmware

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
