"""Light controllers whatever their protocol: settings, the base class of the drivers, and all lights off.

A driver (``_light_*.py``) derives from :class:`LightDriver` and only adds its protocol: how a level is set, and how the
level that the device holds is asked for.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from lightopt.core.errors import HardwareError, InputError, LightoptError, error_text
from lightopt.rig.devices._errors import RefusedError
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._log import Event, SerialLog
from lightopt.rig.devices._parallel import side_by_side
from lightopt.rig.devices._retry import Persistence
from lightopt.rig.devices._roles import Identity, LightController

_ATTEMPTS = 3
"""A channel is told to go dark so often where its driver fails in a way of which it knows nothing."""


class LightsStillOnError(HardwareError):
    """Channels could not be switched off.

    *messages: What failed.
    """

    def __init__(self, *messages: str, channels: Mapping[str, Sequence[int]]) -> None:
        super().__init__(*messages)
        self.channels = dict(channels)


@dataclass(frozen=True)
class LightSettings:
    """What a driver must know to open a light controller.

    name: Name of the controller in the rig file.
    port: Serial port or pyserial URL.
    baud: Baud rate; None is the protocol's usual one.
    channels: Number of channels.
    top_level: Highest intensity.
    dialect: ccs: ``lan`` or ``serial``.
    template: template: commands and patterns of replies, by the words of the rig file.
    timeout_s: Longest wait for a reply [s].
    max_levels: Intensities never exceeded, by channel; where none is given it is `top_level`.
    """

    name: str
    port: str
    baud: int | None = None
    channels: int = 4
    top_level: int = 255
    dialect: str = "lan"
    template: Mapping[str, str | None] | None = None
    timeout_s: float = 1.0
    max_levels: Mapping[int, int] = field(default_factory=dict[int, int])


def all_off(
    controllers: Mapping[str, LightController], *, burning: Mapping[str, Collection[int]] | None = None
) -> None:
    """Darken every channel of every controller, each of them even if others fail; no controller waits for another.

    controllers: By their names in the rig file.
    burning: Channels that are known to burn, by controller: they come first.

    Raises LightsStillOnError once all were tried, with a message per controller and reason that names the channels that
    may still be lit.
    """
    first = burning or {}
    reasons = side_by_side(
        {
            name: lambda name=name, controller=controller: _darken_all(controller, first.get(name, ()))
            for name, controller in controllers.items()
        }
    )
    if any(reasons.values()):
        raise LightsStillOnError(
            *(
                f"controller {name}, channel{'s' if len(channels) > 1 else ''} {', '.join(map(str, channels))}: "
                f"not switched off, may still be lit: {reason}"
                for name, found in reasons.items()
                for reason, channels in _by_reason(found).items()
            ),
            channels={name: sorted(found) for name, found in reasons.items() if found},
        )


def _darken_all(controller: LightController, first: Collection[int]) -> dict[int, str]:
    """Switch every channel off, some of them first; why that failed, by channel."""
    channels = sorted(range(1, controller.channels + 1), key=lambda channel: channel not in first)
    reasons = {channel: _darken(controller, channel) for channel in channels}
    return {channel: reason for channel, reason in reasons.items() if reason is not None}


def _by_reason(found: Mapping[int, str]) -> dict[str, list[int]]:
    channels: dict[str, list[int]] = {}
    for channel in sorted(found):
        channels.setdefault(found[channel], []).append(channel)
    return channels


def _darken(controller: LightController, channel: int) -> str | None:
    """Switch a channel off; why that failed, or None.

    A driver asks again by itself where it knows how its device fails; any other exception is a reason to try again.
    """
    reason = None
    for _ in range(_ATTEMPTS):
        try:
            controller.set_level(channel, 0)
        except LightoptError as error:  # noqa: PERF203
            return error_text(error)
        except Exception as error:  # noqa: BLE001  (whatever fails here, the other lights must go dark)
            reason = error_text(error)
        else:
            return None
    return reason


class LightDriver(ABC):
    """A :class:`~lightopt.rig.devices.LightController` on a serial link."""

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

        Raises InputError for a channel or an intensity that the controller does not have, or the channel may not have;
        nothing was sent.
        Raises HardwareError when the controller does not answer, or holds something else.
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

    name, baud: Of the protocol.
    speak: Makes the driver.
    gap_s: Least time [s] that the controllers ask for between two commands.
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
