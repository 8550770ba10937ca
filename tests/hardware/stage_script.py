"""A wire that knows its dialogue by heart: what must be sent next, and what is answered to it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

Dialogue = Sequence[tuple[bytes, bytes]]


class Script:
    """Stands in for the serial port that pyserial opens."""

    def __init__(self, dialogue: Dialogue) -> None:
        self._dialogue = list(dialogue)
        self._coming = b""
        self._going = b""
        self.opened: dict[str, Any] = {}

    def write(self, data: bytes) -> int:
        self._going += data
        assert self._dialogue, f"nothing more was to be sent, and {data!r} was"
        sent, reply = self._dialogue[0]
        assert sent.startswith(self._going), f"{sent!r} was to be sent, and {self._going!r} was"
        if self._going == sent:
            self._going = b""
            self._dialogue.pop(0)
            self._coming += reply
        return len(data)

    def read(self, size: int = 1) -> bytes:
        data, self._coming = self._coming[:size], self._coming[size:]
        return data

    @property
    def in_waiting(self) -> int:
        return len(self._coming)

    def close(self) -> None:
        pass

    def ended(self) -> bool:
        """Whether all of it was said."""
        return not self._dialogue and not self._going


def play(monkeypatch: pytest.MonkeyPatch, dialogue: Dialogue) -> Script:
    """Let the next port that is opened play a dialogue."""
    script = Script(dialogue)

    def open_url(port: str, **settings: Any) -> Script:
        script.opened = {"port": port, **settings}
        return script

    monkeypatch.setattr("serial.serial_for_url", open_url)
    return script
