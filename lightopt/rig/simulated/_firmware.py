"""Registry of simulated firmware, and what all of it and all lamps share. Add a new device here.

Firmware is written from the tables of its protocol, not from the driver: the two meet on the wire only.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, cast


class Firmware(ABC):
    """A device behind a wire. Time [s] is given, never read, so that a dialogue can be replayed."""

    def __init__(self) -> None:
        self._buffer = b""

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
