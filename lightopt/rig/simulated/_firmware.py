"""What the simulated firmware of a device is, to the process that hosts it.

Firmware is written from the tables of its protocol, not from the driver: the two meet on the wire only.
"""

from __future__ import annotations

from typing import Any, Protocol


class Firmware(Protocol):
    """A device behind a wire. Time is given, never read, so that a dialogue can be replayed."""

    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes off the wire at a time [s] and return the bytes to send; keeps incomplete commands."""
        ...

    def poll(self, now: float) -> bytes:
        """Return bytes that the device sends on its own or late (banners, withheld replies); often none."""
        ...

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:
        """Suffer a fault of the device from a time [s] on: a stalled axis, a light that stays dark.

        Faults of the line (replies dropped, late, cut short) are the host's and never come here.

        Raises
        ------
        ValueError
            For a fault or an option that the device does not know; the message lists those that it does.
        """
        ...


class LightFirmware(Firmware, Protocol):
    """A light controller."""

    def levels(self) -> dict[int, float]:
        """Brightness of each channel from 1 up, as a share of the highest intensity; 0 when off."""
        ...


class StageFirmware(Firmware, Protocol):
    """A stage controller."""

    def positions(self, now: float) -> dict[str, float]:
        """Where each axis really stands at a time [s], in device units by the axis' name."""
        ...
