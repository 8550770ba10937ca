"""Simulated firmware of a controller of the ``SA0255#`` family."""

import re
from typing import Any

from lightopt.rig.simulated._firmware import LampFirmware


class SaFirmware(LampFirmware):
    """A controller of the ``SA0255#`` family, which acknowledges by the channel's letter, in lower case."""

    END = b"#"

    def __init__(self, **lamps: Any) -> None:
        super().__init__(**lamps)
        self._letters = "ABCDEF"[: self._channels]

    def _answer(self, command: bytes, now: float) -> bytes:  # noqa: ARG002
        return self._obey(command.decode("ascii", "replace")).encode("ascii")

    def _obey(self, command: str) -> str:
        match = re.fullmatch(r"S([A-F])(\d{4})?", command)
        if match is None:
            return "NG"
        letter, digits = match.groups()
        if letter not in self._letters:
            return "NG"
        channel = self._letters.index(letter) + 1
        if digits is None:
            return f"{letter.lower()}{self._level[channel]:04d}"
        if int(digits) > self._top_level:
            return "NG"
        self._level[channel] = int(digits)
        return letter.lower()
