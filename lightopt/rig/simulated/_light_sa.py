"""Simulated firmware of a controller of the ``SA0255#`` family (HIKROBOT MV-LE, Rseelight, KDC and others).

``SA0255#`` sets channel A, ``SA#`` reads it and is answered ``a0255``; makers differ in how they acknowledge a set.
``SH#`` and ``SL#`` switch all channels on and off and are answered ``H`` and ``L``. There is no terminator but ``#``,
and no checksum.
"""

import re
from collections.abc import Mapping

from lightopt.rig.simulated._lamps import LampFirmware, Lamps

_LONGEST = 16
_ACKS = ("upper", "lower", "!")


class SaFirmware(LampFirmware):
    """A controller of the ``SA0255#`` family; `ack` is how it acknowledges: ``upper`` or ``lower`` letter, or ``!``."""

    def __init__(
        self, *, channels: int = 4, top_level: int = 255, levels: Mapping[str, int] | None = None, ack: str = "lower"
    ) -> None:
        if ack not in _ACKS:
            raise ValueError(f'ack is one of {", ".join(_ACKS)}, not "{ack}"')
        super().__init__(Lamps(channels, top_level, levels))
        self._letters = "ABCDEF"[:channels]
        self._ack = ack
        self._master = True

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        self._buffer += data
        replies = ""
        while b"#" in self._buffer:
            command, _, self._buffer = self._buffer.partition(b"#")
            replies += self._answer(command.decode("ascii", "replace"))
        self._buffer = self._buffer[-_LONGEST:]
        return replies.encode("ascii")

    def levels(self) -> dict[int, float]:
        return self._lamps.brightness(lit=self._master)

    def _answer(self, command: str) -> str:
        match = re.fullmatch(r"S([A-FHL])(\d{4})?", command)
        if match is None or self._struck("ng"):
            return "NG"
        letter, digits = match.groups()
        if letter in "HL":
            if digits:
                return "NG"
            self._master = letter == "H"
            return letter
        if letter not in self._letters:
            return "NG"
        channel = self._letters.index(letter) + 1
        if digits is None:
            return f"{letter.lower()}{self._lamps.level[channel]:04d}"
        if int(digits) > self._lamps.top_level:
            return "NG"
        self._lamps.set_level(channel, int(digits))
        return {"upper": letter, "lower": letter.lower(), "!": "!"}[self._ack]
