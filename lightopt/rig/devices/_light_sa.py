"""Driver of light controllers of the ``SA0255#`` family (HIKROBOT MV-LE, Rseelight, KDC and others).

``SA0255#`` sets channel A, ``SA#`` asks for it and is answered ``a0255``. Makers acknowledge a set in different ways:
by the channel's letter, by ``A`` or ``a``, or by ``!``; all are taken, and what was set is read back. There is no
checksum.
"""

import re

from lightopt.rig.devices._device import RefusedError, ReplyError
from lightopt.rig.devices._light import LightController, LightSettings
from lightopt.rig.devices._serial_link import SerialLink

_LETTERS = "ABCDEF"
_ACK = re.compile(rb"NG|[A-Fa-f!]")
_VALUE = re.compile(rb"NG|[A-Fa-f]\d{4}")


class SaController(LightController):
    """A light controller of the ``SA0255#`` family; opening asks for the intensity of channel A, no light changes."""

    NAME = "sa"
    BAUD = 19200

    def __init__(self, link: SerialLink, settings: LightSettings) -> None:
        super().__init__(link, settings)
        self._reads = self._can_read_levels()

    def _send_level(self, channel: int, level: int) -> None:
        letter = _LETTERS[channel - 1]
        self._retry.run(lambda: self._query(f"S{letter}{level:04d}#", _ACK, f"(?i:[A{letter}!])"))

    def _query_level(self, channel: int) -> int:
        letter = _LETTERS[channel - 1]
        return int(self._retry.run(lambda: self._query(f"S{letter}#", _VALUE, rf"(?i:{letter})\d{{4}}"))[1:])

    def _query(self, command: str, end: re.Pattern[bytes], expected: str) -> str:
        frame = command.encode("ascii")
        reply = self._link.query(frame, end=end)
        if reply == b"NG":
            raise self._link.failure("it refuses the command (NG)", sent=frame, reply=reply, kind=RefusedError)
        text = reply.decode("ascii", "replace")
        if re.fullmatch(expected, text) is None:
            raise self._link.failure("no acknowledgement or intensity", sent=frame, reply=reply, kind=ReplyError)
        return text
