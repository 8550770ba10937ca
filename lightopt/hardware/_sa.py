"""Driver of light controllers of the ``SA0255#`` family (HIKROBOT MV-LE, Rseelight, KDC and others).

``SA0255#`` sets channel A, ``SA#`` asks for it and is answered ``a0255``. Makers acknowledge a set in different ways:
by the channel's letter, by ``A`` or ``a``, or by ``!``; all are taken, and what was set is read back. There is no
checksum.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from lightopt.errors import InputError
from lightopt.hardware._errors import RefusedError, ReplyError
from lightopt.hardware._lights import LightSettings, check_light
from lightopt.hardware._link import SerialLink
from lightopt.hardware._log import Event, SerialLog
from lightopt.hardware._retry import Persistence
from lightopt.hardware._roles import Identity

__all__ = ["SaController", "open_sa"]

_BAUD = 19200
_LETTERS = "ABCDEF"
_TOP = 9999
_ACK = re.compile(rb"NG|[A-Fa-f!]")
_VALUE = re.compile(rb"NG|[A-Fa-f]\d{4}")


class SaController:
    """A light controller of the ``SA0255#`` family, as a :class:`~lightopt.hardware.LightController`.

    Opening asks for the intensity of channel A; no light changes.

    Parameters
    ----------
    link
        The wire.
    channels
        Number of channels, up to 6.
    top_level
        Highest intensity, up to 9999.
    max_levels
        Intensities never exceeded, by channel.

    Raises
    ------
    lightopt.errors.InputError
        For more channels or levels than the protocol can say.
    lightopt.errors.HardwareError
        When the controller does not answer.
    """

    def __init__(
        self,
        link: SerialLink,
        *,
        channels: int = 4,
        top_level: int = 255,
        max_levels: Mapping[int, int] | None = None,
    ) -> None:
        if channels > len(_LETTERS) or top_level > _TOP:
            raise InputError(
                f"{link.device}: the protocol has {len(_LETTERS)} channels and intensities up to {_TOP}, "
                f"found channels: {channels}, top_level: {top_level}"
            )
        self._link = link
        self._channels = channels
        self._top_level = top_level
        self._max_levels = max_levels
        self._persistence = Persistence(link)
        self._reads = True
        try:
            self._read(1)
        except RefusedError as error:
            self._reads = False
            link.note(f"lights cannot be read back: {error}")

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self._channels

    @property
    def top_level(self) -> int:
        """Highest intensity."""
        return self._top_level

    @property
    def events(self) -> list[Event]:
        """What was out of the ordinary on the wire."""
        return self._link.events

    def identify(self) -> Identity:
        """Ask for an intensity: the protocol has no name."""
        if self._reads:
            self._read(1)
        return Identity("sa", self._link.port, {"read_back": "yes" if self._reads else "no"})

    def set_level(self, channel: int, level: int) -> None:
        """Set the intensity, and read it back."""
        check_light(
            self._link.device,
            channel,
            level,
            channels=self._channels,
            top_level=self._top_level,
            max_levels=self._max_levels,
        )
        letter = _LETTERS[channel - 1]
        with self._link.lock:
            self._persistence.ask(lambda: self._set_once(f"S{letter}{level:04d}#".encode("ascii"), letter))
            held = self._read(channel) if self._reads else level
        if held != level:
            raise self._link.failure(f"channel {channel} was set to {level} but holds {held}")

    def read_level(self, channel: int) -> int | None:
        """Intensity that the controller holds; None where it refuses to say."""
        check_light(self._link.device, channel, 0, channels=self._channels, top_level=self._top_level)
        return self._read(channel) if self._reads else None

    def close(self) -> None:
        """Give up the link; lights stay as they are."""
        self._link.close()

    def _read(self, channel: int) -> int:
        return self._persistence.ask(lambda: self._read_once(_LETTERS[channel - 1]))

    def _set_once(self, frame: bytes, letter: str) -> None:
        reply = self._query(frame, _ACK)
        if reply.decode("ascii", "replace").upper() not in (letter, "A", "!"):
            raise ReplyError(self._link.words("the reply is no acknowledgement", sent=frame, reply=reply))

    def _read_once(self, letter: str) -> int:
        frame = f"S{letter}#".encode("ascii")
        reply = self._query(frame, _VALUE)
        if re.fullmatch(rb"[A-F]\d{4}", reply.upper()) is None or chr(reply[0]).upper() != letter:
            raise ReplyError(
                self._link.words("the reply is not this channel's intensity", sent=frame, reply=reply)
            )
        return int(reply[1:])

    def _query(self, frame: bytes, end: re.Pattern[bytes]) -> bytes:
        reply = self._link.query(frame, end=end)
        if reply == b"NG":
            raise RefusedError(self._link.words("it refuses the command (NG)", sent=frame, reply=reply))
        return reply


def open_sa(settings: LightSettings, log: SerialLog | None = None) -> SaController:
    """Open a controller of the ``SA0255#`` family.

    Raises
    ------
    lightopt.errors.InputError
        When the port cannot be opened, or for more channels or levels than the protocol can say.
    lightopt.errors.HardwareError
        When the controller does not answer.
    """
    link = SerialLink(
        settings.port,
        device=f"light controller {settings.name} (sa)",
        baud=settings.baud or _BAUD,
        timeout_s=settings.timeout_s,
        log=log,
    )
    try:
        return SaController(
            link, channels=settings.channels, top_level=settings.top_level, max_levels=settings.max_levels
        )
    except BaseException:
        link.close()
        raise
