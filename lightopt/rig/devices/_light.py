"""Light controllers whatever their protocol: settings, the base class of the drivers, and all lights off."""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from lightopt.config import PictureConfig
from lightopt.core.arrays import Float64
from lightopt.core.errors import HardwareError, InputError, LightoptError, error_text
from lightopt.rig.devices._device import RefusedError, Retry
from lightopt.rig.devices._serial_link import Link, SerialLink, SerialLog

T = TypeVar("T")
_ATTEMPTS = 3  # to darken a channel whose driver fails in a way that it does not know


class LightsStillOnError(HardwareError):
    """Channels could not be switched off; `channels` by the name of the controller."""

    def __init__(self, *messages: str, channels: Mapping[str, Sequence[int]]) -> None:
        super().__init__(*messages)
        self.channels = dict(channels)


@dataclass(frozen=True)
class LightSettings:
    """What a driver must know to open a light controller."""

    name: str  # in the rig file
    port: str  # serial port or pyserial URL; empty for a real display
    baud: int | None = None  # None is the protocol's usual rate
    channels: int = 4
    top_level: int = 255
    dialect: str = "lan"  # ccs: lan or serial
    template: Mapping[str, str | None] | None = None  # commands and patterns of replies, by the keys of the rig file
    monitor: int | None = None  # screen: its number, from 1
    command: tuple[str, ...] | None = None  # command: program and arguments, with {file}
    folder: Path = Path()  # command: where it is run
    picture: PictureConfig | None = None  # screen, command
    # picture of each channel, made when it is needed: shares of the full radiance as seen from the part
    pictures: Mapping[int, Callable[[], Float64]] = field(default_factory=dict[int, Callable[[], Float64]])
    timeout_s: float = 1.0  # longest wait for a reply [s]
    max_levels: Mapping[int, int] = field(default_factory=dict[int, int])  # highest allowed intensities by channel


def all_off(controllers: Mapping[str, "LightController"], *, lit: Mapping[str, Collection[int]] | None = None) -> None:
    """Darken every channel of every controller, each of them even if others fail; no controller waits for another.

    lit: Channels that are known to be lit, by controller: they come first.

    Raises LightsStillOnError once all were tried, with a message per controller and reason.
    """
    first = lit or {}
    work = {name: partial(_darken_all, one, first.get(name, ())) for name, one in controllers.items()}
    reasons = run_in_parallel(work)
    messages: list[str] = []
    for name, found in reasons.items():
        for reason, channels in found.items():
            which = f"controller {name}, channel{'s' * (len(channels) > 1)} {', '.join(map(str, channels))}"
            messages.append(f"{which}: not switched off, may still be lit: {reason}")
    if messages:
        still_on = {name: sorted(chain(*found.values())) for name, found in reasons.items() if found}
        raise LightsStillOnError(*messages, channels=still_on)


def _darken_all(controller: "LightController", first: Collection[int]) -> dict[str, list[int]]:
    """Switch every channel off, some of them first; those where that failed, by reason."""
    channels = range(1, controller.channels + 1)
    reasons = {channel: _darken(controller, channel) for channel in sorted(channels, key=lambda c: c not in first)}
    found: dict[str, list[int]] = {}
    for channel in channels:
        if (reason := reasons[channel]) is not None:
            found.setdefault(reason, []).append(channel)
    return found


def _darken(controller: "LightController", channel: int) -> str | None:
    """Switch a channel off; why that failed, or None. Errors that no driver foresaw are reasons to try again."""
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


class LightController(ABC):
    """Panels behind one controller on a link; channels are counted from 1, as printed on the device.

    Every method raises :class:`~lightopt.core.errors.HardwareError` when the device does not answer, answers no, or
    does not hold what was set.
    """

    NAME: ClassVar[str]  # name of the protocol, as in the rig file
    BAUD: ClassVar[int]  # the protocol's usual baud rate
    GAP_S: ClassVar[float] = 0.0  # least time [s] that the controllers ask for between two commands

    def __init__(self, link: Link, settings: LightSettings) -> None:
        self.channels = settings.channels
        self.events = link.events  # irregularities on the wire so far
        self._link: Any = link  # of the kind that the driver opens
        self.top_level = settings.top_level
        self._max_levels = settings.max_levels
        self._retry = Retry(link)
        self.level_set_s = 0.0  # when [s, monotonic clock] the device had the last intensity, before it was read back
        self._reads = False  # whether levels can be read back, which each protocol finds out in its own way

    @classmethod
    def open(cls, settings: LightSettings, log: SerialLog | None = None) -> "LightController":
        """Open the link of a controller and let its driver talk first; a link on which that fails is closed."""
        device, baud = f"light controller {settings.name} ({cls.NAME})", settings.baud or cls.BAUD
        port, timeout_s, gap_s = settings.port, settings.timeout_s, cls.GAP_S
        link = SerialLink(port, device=device, baud=baud, timeout_s=timeout_s, gap_s=gap_s, log=log)
        try:
            return cls(link, settings)
        except BaseException:
            link.close()
            raise

    def identify(self) -> dict[str, str]:
        details = {**self._query_identity(), "read_back": "yes" if self._reads else "no"}
        return {"driver": self.NAME, "port": self._link.port, **details}

    def set_level(self, channel: int, level: int) -> int | None:
        """Light a channel at an intensity in 1 … top_level, or darken it with 0; returns the intensity read back.

        None where it cannot be read back. InputError before anything is sent: no such channel, or an intensity above
        what it may have. Darkening has priority: a dialogue under way on the wire is broken off for it, retries
        included.
        """
        self._check(channel, level)
        lock = self._link.lock
        with lock if level > 0 else lock.priority():
            self._send_level(channel, level)
            self.level_set_s = time.monotonic()
            if not self._reads:
                return None
            self._verify(channel, level)
            return level

    def read_level(self, channel: int) -> int | None:
        """Intensity that the device holds, 0 when it is off; None where it cannot be read back."""
        self._check(channel, 0)
        return self._query_level(channel) if self._reads else None

    def close(self) -> None:
        """Give up the link; never changes a light, never raises."""
        self._link.close()

    def _query_identity(self) -> dict[str, str]:
        """What the device reports about itself: nothing where the protocol has no name, but it has to answer."""
        if self._reads:
            self._query_level(1)
        return {}

    @abstractmethod
    def _send_level(self, channel: int, level: int) -> None:
        """Light a channel at an intensity, or darken it with 0."""

    @abstractmethod
    def _query_level(self, channel: int) -> int:
        """Ask for the intensity of a channel; only where levels can be read back."""

    def _can_read_levels(self) -> bool:
        """Whether the controller reports what it holds; one that refuses that is noted, one that is silent fails."""
        try:
            self._query_level(1)
        except RefusedError as error:  # a lost reply does not show what the controller can do
            self._link.note(f"lights cannot be read back: {error}")
            return False
        return True

    def _verify(self, channel: int, level: int) -> None:
        if (held := self._query_level(channel)) != level:
            raise self._link.failure(f"channel {channel} was set to {level} but holds {held}")

    def _check(self, channel: int, level: int) -> None:
        device = self._link.device
        if not 1 <= channel <= self.channels:
            raise InputError(f"{device}: expected a channel from 1 to {self.channels}, found {channel}")
        if not 0 <= level <= self.top_level:
            raise InputError(f"{device}: expected an intensity from 0 to {self.top_level}, found {level}")
        if level > (most := self._max_levels.get(channel, level)):
            allowed = f"channel {channel} may have an intensity of {most} at most (max_level)"
            raise InputError(f"{device}: {allowed}, found {level}; nothing was sent")


def run_in_parallel(work: Mapping[str, Callable[[], T]]) -> dict[str, T]:
    """Run the work of each device in a thread of its own; results in the order of the devices.

    All of it is done, whatever fails; then the first error in the order of the devices is raised, and Ctrl-C once all
    has ended. While the interpreter shuts down, when no thread can be started any more, one is done after the other.
    """
    results: dict[str, T] = {}
    errors: dict[str, BaseException] = {}

    def do(name: str) -> None:
        try:
            results[name] = work[name]()
        except BaseException as error:  # noqa: BLE001  (raised below)
            errors[name] = error

    threads: list[threading.Thread] = []
    for name in [*work][1:]:
        thread = threading.Thread(target=do, args=(name,))
        try:
            thread.start()
        except RuntimeError:
            do(name)
        else:
            threads.append(thread)
    try:
        if work:
            do(next(iter(work)))
    finally:
        try:
            for thread in threads:
                thread.join()
        except BaseException:  # what interrupts the waiting is raised once all have ended
            for thread in threads:
                thread.join()
            raise
    for name in work:
        if name in errors:
            raise errors[name]
    return {name: results[name] for name in work}
