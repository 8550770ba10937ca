"""What every light driver is, whatever its protocol: it refuses what may not be, tells, and reads back.

A driver only says its protocol: how a level is told, and how the level that is held is asked for.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import TypeVar

from lightopt.core.errors import InputError
from lightopt.rig.devices._errors import RefusedError
from lightopt.rig.devices._lights import LightSettings
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._log import Event, SerialLog
from lightopt.rig.devices._retry import Persistence
from lightopt.rig.devices._roles import Identity


class LightDriver(ABC):
    """A :class:`~lightopt.rig.devices.LightController` on a serial link.

    Parameters
    ----------
    link
        The wire.
    name
        Name of the protocol, as in the rig file.
    channels
        Number of channels.
    top_level
        Highest intensity.
    max_levels
        Intensities never exceeded, by channel.
    """

    def __init__(
        self,
        link: SerialLink,
        *,
        name: str,
        channels: int,
        top_level: int,
        max_levels: Mapping[int, int] | None,
    ) -> None:
        self._link = link
        self._name = name
        self._channels = channels
        self._top_level = top_level
        self._max_levels = max_levels or {}
        self._persistence = Persistence(link)
        self._told_s = 0.0
        self._reads = False  # whether levels can be read back, which each protocol finds out in its own way

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self._channels

    @property
    def top_level(self) -> int:
        """Highest intensity."""
        return self._top_level

    @property
    def told_s(self) -> float:
        """When [s, monotonic clock] the device had the last intensity, before it was read back."""
        return self._told_s

    @property
    def events(self) -> list[Event]:
        """What was out of the ordinary on the wire."""
        return self._link.events

    def identify(self) -> Identity:
        """Ask the device something that changes nothing, and say who it is."""
        says = {**self._ask_who(), "read_back": "yes" if self._reads else "no"}
        return Identity(self._name, self._link.port, says)

    def set_level(self, channel: int, level: int) -> int | None:
        """Set the intensity, and read it back where that can be; returns what is held, None where nobody knows.

        Darkening comes first: a dialogue under way on the wire is broken off for it, retries included.

        Raises
        ------
        lightopt.core.errors.InputError
            For a channel or an intensity that the controller does not have, or the channel may not have; nothing was
            sent.
        lightopt.core.errors.HardwareError
            When the controller does not answer, or holds something else.
        """
        self._check(channel, level)
        lock = self._link.lock
        with lock if level > 0 else lock.first():
            self._tell(channel, level)
            self._told_s = time.monotonic()
            if not self._reads:
                return None
            self._verify(channel, level)
            return level

    def read_level(self, channel: int) -> int | None:
        """Intensity that the controller holds, 0 where it is switched off; None where it cannot be read back."""
        self._check(channel, 0)
        return self._held(channel) if self._reads else None

    def close(self) -> None:
        """Give up the link; lights stay as they are."""
        self._link.close()

    @abstractmethod
    def _ask_who(self) -> dict[str, str]:
        """Ask the device something that changes nothing; what it says of itself."""

    @abstractmethod
    def _tell(self, channel: int, level: int) -> None:
        """Light a channel at an intensity, or darken it with 0."""

    @abstractmethod
    def _held(self, channel: int) -> int:
        """Ask for the intensity of a channel; only where levels can be read back."""

    def _answers_reading(self) -> bool:
        """Whether the controller says what it holds; one that refuses that is noted, one that is silent fails."""
        try:
            self._held(1)
        except RefusedError as error:  # a lost reply says nothing of what the controller can
            self._link.note(f"lights cannot be read back: {error}")
            return False
        return True

    def _verify(self, channel: int, level: int) -> None:
        """Raise unless the controller holds what it was told."""
        if (held := self._held(channel)) != level:
            raise self._link.failure(f"channel {channel} was set to {level} but holds {held}")

    def _check(self, channel: int, level: int) -> None:
        """Refuse what the controller does not have or a channel may not be set to, before anything is sent."""
        device = self._link.device
        if not 1 <= channel <= self._channels:
            raise InputError(f"{device}: expected a channel from 1 to {self._channels}, found {channel}")
        if not 0 <= level <= self._top_level:
            raise InputError(f"{device}: expected an intensity from 0 to {self._top_level}, found {level}")
        if level > self._max_levels.get(channel, level):
            raise InputError(
                f"{device}: channel {channel} may have an intensity of {self._max_levels[channel]} at most "
                f"(max_level), found {level}; nothing was sent"
            )


Driver = TypeVar("Driver", bound=LightDriver)


def open_driver(
    settings: LightSettings,
    log: SerialLog | None,
    *,
    name: str,
    baud: int,
    speak: Callable[[SerialLink], Driver],
    gap_s: float = 0.0,
) -> Driver:
    """Open the link of a controller and let its driver speak first; a link on which that fails is closed.

    Parameters
    ----------
    settings
        Port, name, deadline, and baud rate unless it is the protocol's usual one.
    log
        Where every byte is written down.
    name, baud
        Of the protocol.
    speak
        Makes the driver.
    gap_s
        Least time [s] that the controllers ask for between two commands.
    """
    link = SerialLink(
        settings.port,
        device=f"light controller {settings.name} ({name})",
        baud=settings.baud or baud,
        timeout_s=settings.timeout_s,
        gap_s=gap_s,
        log=log,
    )
    try:
        return speak(link)
    except BaseException:
        link.close()
        raise
