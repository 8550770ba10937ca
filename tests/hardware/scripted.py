"""A serial port that follows a script: what must be sent, and what is replied."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from lightopt.hardware import SerialLink


class ScriptedPort:
    """Stands for pyserial's port; time passes only in the reads that find nothing."""

    def __init__(self, dialogue: Sequence[tuple[bytes, bytes | None]]) -> None:
        self.dialogue = list(dialogue)
        self.sent: list[bytes] = []
        self.input = bytearray()
        self.closed = False
        self.opened_with: dict[str, Any] = {}

    @property
    def in_waiting(self) -> int:
        return len(self.input)

    def write(self, data: bytes) -> int:
        assert self.dialogue, f"{data!r} was sent after the end of the dialogue"
        expected, reply = self.dialogue.pop(0)
        assert data == expected
        self.sent.append(data)
        self.input += reply or b""
        return len(data)

    def read(self, count: int) -> bytes:
        data = bytes(self.input[:count])
        del self.input[:count]
        return data

    def close(self) -> None:
        self.closed = True


def scripted_link(
    monkeypatch: pytest.MonkeyPatch, dialogue: Sequence[tuple[bytes, bytes | None]], **options: Any
) -> tuple[SerialLink, ScriptedPort]:
    """A link whose port follows a dialogue of (sent, reply); a reply of None never comes."""
    port = ScriptedPort(dialogue)

    def opened(url: str, **arguments: Any) -> ScriptedPort:
        port.opened_with = {"url": url, **arguments}
        return port

    monkeypatch.setattr("lightopt.hardware._link.serial.serial_for_url", opened)
    settings = {"device": "light controller main", "baud": 38400, "timeout_s": 0.02, **options}
    return SerialLink("COM7", **settings), port
