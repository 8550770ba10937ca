"""Simulated firmware of a controller of the ``SA0255#`` family (HIKROBOT MV-LE, Rseelight, KDC and others).

``SA0255#`` sets channel A, ``SA#`` reads it and is answered ``a0255``; makers differ in how they acknowledge a set.
``SH#`` and ``SL#`` switch all channels on and off and are answered ``H`` and ``L``. There is no terminator but ``#``,
and no checksum.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._faults import Trigger, trigger
from lightopt.rig.simulated._lamps import Lamps

_LONGEST = 16
_ACKS = ("upper", "lower", "!")


class SaFirmware:
    """A controller of the ``SA0255#`` family.

    Faults besides those of its lamps: ``ng`` (the command is refused and not obeyed), with ``after``, ``count``,
    ``probability`` and ``seed``.

    levels: Intensities at power-up by channel.
    ack: How a set is acknowledged: the channel's letter in ``upper`` or ``lower`` case, or ``!``.
    """

    def __init__(
        self,
        *,
        channels: int = 4,
        top_level: int = 255,
        levels: Mapping[str, int] | None = None,
        ack: str = "lower",
    ) -> None:
        if ack not in _ACKS:
            raise ValueError(f'ack is one of {", ".join(_ACKS)}, not "{ack}"')
        self._lamps = Lamps(channels, top_level, levels)
        self._letters = "ABCDEF"[:channels]
        self._ack = ack
        self._master = True
        self._buffer = b""
        self._ng: Trigger | None = None

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        """Take bytes; answer the commands that they complete."""
        self._buffer += data
        replies = ""
        while b"#" in self._buffer:
            command, _, self._buffer = self._buffer.partition(b"#")
            replies += self._answer(command.decode("ascii", "replace"))
        self._buffer = self._buffer[-_LONGEST:]
        return replies.encode("ascii")

    def poll(self, now: float) -> bytes:  # noqa: ARG002
        """Return nothing: it speaks when spoken to."""
        return b""

    def levels(self) -> dict[int, float]:
        """Brightness of each channel."""
        return self._lamps.shine(lit=self._master)

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:  # noqa: ARG002
        """Suffer a fault; see the class."""
        if fault == "ng":
            self._ng = trigger(fault, options)
            return
        if fault == "clear":
            self._ng = None
        self._lamps.inject(fault, options, ("ng",))

    def _answer(self, command: str) -> str:
        match = re.fullmatch(r"S([A-FHL])(\d{4})?", command)
        if match is None or (self._ng is not None and self._ng.strikes()):
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
            return f"{letter.lower()}{self._lamps.level(channel):04d}"
        if int(digits) > self._lamps.top_level:
            return "NG"
        self._lamps.set_level(channel, int(digits))
        return {"upper": letter, "lower": letter.lower(), "!": "!"}[self._ack]
