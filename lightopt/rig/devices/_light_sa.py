"""Driver of light controllers of the ``SA0255#`` family (HIKROBOT MV-LE, Rseelight, KDC and others).

``SA0255#`` sets channel A, ``SA#`` asks for it and is answered ``a0255``. Makers acknowledge a set in different ways:
by the channel's letter, by ``A`` or ``a``, or by ``!``; all are taken, and what was set is read back. There is no
checksum.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from lightopt.core.errors import InputError
from lightopt.rig.devices._errors import RefusedError, ReplyError
from lightopt.rig.devices._lights import LightDriver, LightSettings, open_driver
from lightopt.rig.devices._link import SerialLink
from lightopt.rig.devices._log import SerialLog

_BAUD = 19200
_LETTERS = "ABCDEF"
_TOP = 9999
_ACK = re.compile(rb"NG|[A-Fa-f!]")
_VALUE = re.compile(rb"NG|[A-Fa-f]\d{4}")


class SaController(LightDriver):
    """A light controller of the ``SA0255#`` family, as a :class:`~lightopt.rig.devices.LightController`.

    Opening asks for the intensity of channel A; no light changes.

    Raises InputError for more channels or levels than the protocol can say.
    Raises HardwareError when the controller does not answer.
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
        super().__init__(link, name="sa", channels=channels, top_level=top_level, max_levels=max_levels)
        self._reads = self._answers_reading()

    def _ask_who(self) -> dict[str, str]:
        """Ask for an intensity: the protocol has no name."""
        if self._reads:
            self._held(1)
        return {}

    def _tell(self, channel: int, level: int) -> None:
        letter = _LETTERS[channel - 1]
        self._persistence.ask(lambda: self._set_once(f"S{letter}{level:04d}#".encode("ascii"), letter))

    def _held(self, channel: int) -> int:
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

    Raises InputError when the port cannot be opened, or for more channels or levels than the protocol can say.
    Raises HardwareError when the controller does not answer.
    """
    return open_driver(
        settings,
        log,
        name="sa",
        baud=_BAUD,
        speak=lambda link: SaController(
            link, channels=settings.channels, top_level=settings.top_level, max_levels=settings.max_levels
        ),
    )
