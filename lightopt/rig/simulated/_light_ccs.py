"""Simulated firmware of a controller that speaks CCS ``@`` frames; both dialects are understood, mixed."""

import re
from typing import Any

from lightopt.rig.simulated._firmware import LampFirmware

_COMMAND, _CHECKSUM, _VALUE = 1, 2, 3
_MODES = 10  # S00 is on/off, S01 … S10 are strobes


class CcsFirmware(LampFirmware):
    def __init__(self, **lamps: Any) -> None:
        super().__init__(**lamps)
        self._digits = max(3, len(str(self._top_level)))
        self._mode = dict.fromkeys(self._level, 0)

    def levels(self) -> dict[int, float]:
        """Brightness of each channel; a channel in a strobe mode is dark, because it is never triggered."""
        return {c: share if self._mode[c] == 0 else 0.0 for c, share in super().levels().items()}

    def _answer(self, command: bytes, now: float) -> bytes:  # noqa: ARG002
        start = command.rfind(b"@")
        if start < 0:
            return b""
        frame = command[start:]
        head = frame[1:3].decode("ascii", "replace") if frame[1:3].isdigit() else "00"
        match = re.fullmatch(rb"@(\d\d)([A-Z])(.*)([0-9A-F]{2})", frame)
        if match is None:
            return self._reply(head, f"N{_COMMAND:02d}")
        if int(match[4], 16) != sum(frame[:-2]) % 256:
            return self._reply(head, f"N{_CHECKSUM:02d}")
        outcome = self._obey(int(match[1]) + 1, match[2].decode(), match[3].decode("ascii", "replace"))
        if isinstance(outcome, int):
            outcome = f"N{outcome:02d}"
        return self._reply(head, outcome)

    def _reply(self, head: str, outcome: str) -> bytes:
        body = f"@{head}{outcome}".encode("ascii")
        return body + f"{sum(body) % 256:02X}\r\n".encode("ascii")

    def _obey(self, channel: int, instruction: str, data: str) -> str | int:
        width = {"F": self._digits, "L": 1, "S": 2, "M": 0, "C": 0}.get(instruction)
        if width is None or (data and not (data.isascii() and data.isdigit())):
            return _COMMAND
        if data[width:] not in ("", "00") or len(data) < width:
            return _COMMAND
        if channel > self._channels:
            return _VALUE
        value = int(data[:width] or 0)
        if instruction == "C":
            return "O00"
        if instruction == "M":
            level, mode, on = self._level[channel], self._mode[channel], int(self._on[channel])
            return f"OF{level:0{self._digits}d}.S{mode:02d}.L{on}"
        if value > {"F": self._top_level, "L": 1, "S": _MODES}[instruction]:
            return _VALUE
        if instruction == "F":
            self._level[channel] = value
        elif instruction == "L":
            self._on[channel] = bool(value)
        else:
            self._mode[channel] = value
        return "O"
