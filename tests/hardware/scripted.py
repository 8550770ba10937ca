"""A serial port that follows a script: what must be sent next, and what is replied to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from lightopt.rig.devices._serial_link import SerialLink

Dialogue = Sequence[tuple[bytes, bytes | None]]


class ScriptedPort:
    """Stands in for the port that pyserial opens; a command may be sent in pieces, and a reply of None never comes."""

    def __init__(self, dialogue: Dialogue) -> None:
        self.dialogue = list(dialogue)
        self.sent: list[bytes] = []
        self.input = bytearray()
        self.closed = False
        self.opened_with: dict[str, Any] = {}
        self._going = b""

    @property
    def in_waiting(self) -> int:
        return len(self.input)

    def write(self, data: bytes) -> int:
        self._going += data
        assert self.dialogue, f"{data!r} was sent after the end of the dialogue"
        expected, reply = self.dialogue[0]
        assert expected.startswith(self._going), f"{expected!r} was to be sent, and {self._going!r} was"
        if self._going == expected:
            self._going = b""
            self.dialogue.pop(0)
            self.sent.append(expected)
            self.input += reply or b""
        return len(data)

    def read(self, size: int = 1) -> bytes:
        data = bytes(self.input[:size])
        del self.input[:size]
        return data

    def close(self) -> None:
        self.closed = True

    def ended(self) -> bool:
        """Whether all of it was said."""
        return not self.dialogue and not self._going


def play(monkeypatch: pytest.MonkeyPatch, dialogue: Dialogue) -> ScriptedPort:
    """Let the ports that are opened from now on be one that follows a dialogue."""
    port = ScriptedPort(dialogue)

    def opened(url: str, **arguments: Any) -> ScriptedPort:
        port.opened_with = {"url": url, **arguments}
        return port

    monkeypatch.setattr("serial.serial_for_url", opened)
    return port


def scripted_link(
    monkeypatch: pytest.MonkeyPatch, dialogue: Dialogue, **options: Any
) -> tuple[SerialLink, ScriptedPort]:
    """A link to a port that follows a dialogue."""
    port = play(monkeypatch, dialogue)
    settings = {"device": "light controller main", "baud": 38400, "timeout_s": 0.02, **options}
    return SerialLink("COM7", **settings), port
