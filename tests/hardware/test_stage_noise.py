"""Noise on the line: firmware takes any bytes, and a driver turns any reply into an answer or a HardwareError."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from grbl_recordings import BANNER
from hypothesis import HealthCheck, given, settings, strategies as st
from stage_worlds import AXES, KINDS, firmware

from lightopt.core.errors import HardwareError
from lightopt.rig.devices import open_stage
from lightopt.rig.simulated._firmware import build

SAID = (
    rb"\r\n|\n|Q:|G:|A:1+P5|M:W+P1-P1|H:W-+|L:E|?|!|~|\x18|$$|$H|$X|G1X-1F5|/1 1 |home|move abs 5|:2C"
    rb"|ok\r\n|error:|ALARM:|<Idle|MPos:|@01 1 |OK "
)
WORDS = st.sampled_from([word.decode("unicode_escape").encode("latin-1") for word in SAID.split(b"|")])
NOISE = st.lists(st.binary(max_size=8) | WORDS, max_size=12)


@pytest.mark.parametrize("kind", KINDS)
@given(pieces=NOISE, pause=st.floats(0, 5))
def test_firmware_takes_any_bytes(kind: str, pieces: list[bytes], pause: float) -> None:
    device: Any = build(kind, firmware(kind)["options"])
    now = 0.0
    for piece in pieces:
        assert isinstance(device.feed(piece, now), bytes)
        now += pause
        assert isinstance(device.poll(now), bytes)
    assert len(device.positions(now)) >= 2


class Noisy:
    """A port that answers everything with noise."""

    def __init__(self, noise: bytes, greeting: bytes) -> None:
        self._noise = noise
        self._coming = greeting
        self._greeted = not greeting

    def write(self, data: bytes) -> int:
        if self._greeted:
            self._coming += self._noise
        self._greeted = True
        return len(data)

    def read(self, size: int = 1) -> bytes:
        data, self._coming = self._coming[:size], self._coming[size:]
        return data

    @property
    def in_waiting(self) -> int:
        return len(self._coming)

    def close(self) -> None:
        pass


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pieces=NOISE)
def test_drivers_take_any_reply(kind: str, monkeypatch: pytest.MonkeyPatch, pieces: list[bytes]) -> None:
    greeting = BANNER if kind == "grbl" else b""
    port = Noisy(b"".join(pieces), greeting)
    monkeypatch.setattr("serial.serial_for_url", lambda *_, **__: port)
    stage = open_stage(kind, port="COM9", axes=AXES[kind], timeout_s=0.01)
    for question in (stage.state, stage.identify):
        error = failure(question)
        assert error is None or "COM9" in str(error)
    stage.close()


def failure(question: Callable[[], object]) -> HardwareError | None:
    try:
        question()
    except HardwareError as error:
        return error
    return None
