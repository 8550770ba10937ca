"""Simulated firmware of SIGMA KOKI / OptoSigma SHOT controllers in MAIN mode: OK or NG to each command.

While an axis moves, only stop and status are taken. The count starts at 0 at power-up, wherever the axes stand.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._sigmakoki import Controller

_TOP_SPEED = 500_000


class ShotFirmware:
    """A SHOT controller; faults as :class:`~lightopt.rig.simulated._sigmakoki.Controller` has them.

    Parameters
    ----------
    axes
        Arguments of each axis by its number.
    speed, home_speed
        Speed at power-up, and of the search for the origin [pulses/s].
    detached
        Whether a sign stands at the left edge of its column rather than before the digits.
    """

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        speed: float = 10_000.0,
        home_speed: float = 5000.0,
        detached: bool = False,
    ) -> None:
        self._controller = Controller(axes=axes, speed=speed, home_speed=home_speed)
        self._detached = detached
        self._accepted = True

    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes; answer each line."""
        return b"".join(self._answer(line, now).encode() + b"\r\n" for line in self._controller.lines(data))

    def poll(self, now: float) -> bytes:  # noqa: ARG002
        """Return nothing: it speaks when spoken to."""
        return b""

    def positions(self, now: float) -> dict[str, float]:
        """Where each axis really stands [pulses from its origin]."""
        return self._controller.axes.real(now)

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:
        """Suffer a fault; see the class."""
        self._controller.inject(fault, options, now)

    def _answer(self, line: str, now: float) -> str:
        question = self._question(line, now)
        if question is not None:
            return question
        self._accepted = not self._controller.refuses() and self._obey(line, now)
        return "OK" if self._accepted else "NG"

    def _question(self, line: str, now: float) -> str | None:
        axes = self._controller.axes
        if line == "Q:":
            return self._controller.status(now, accepted=self._accepted, detached=self._detached)
        if line == "!:":
            return "B" if axes.moving(now) else "R"
        if line == "?:V":
            return "V1.30"
        if line == "?:SW":  # divisions of a full step
            return ",".join("2" for _ in axes.by_name)
        return None

    def _obey(self, line: str, now: float) -> bool:
        verb, colon, words = line.partition(":")
        controller = self._controller
        if not colon:
            return False
        if verb == "L":
            return controller.stop(words, now)
        if controller.axes.moving(now):
            return False
        if verb in ("A", "M", "J"):
            return controller.plan(verb, words)
        if verb == "G":
            return not words and controller.start(now)
        if verb == "H":
            return controller.home(list(controller.axes.by_name) if words == "W" else [words], now)
        if verb == "R":
            return controller.zero(words, now)
        if verb == "D":
            return self._set_speed(words)
        if verb == "C":
            return re.fullmatch(r"[12W][01]", words) is not None
        if verb == "S":
            return re.fullmatch(r"[12]\d{1,3}", words) is not None
        return False

    def _set_speed(self, words: str) -> bool:
        match = re.fullmatch(r"([12W])((?:S\d+F\d+R\d+)+)", words)
        if match is None:
            return False
        names = list(self._controller.axes.by_name) if match[1] == "W" else [match[1]]
        each = [tuple(map(int, m)) for m in re.findall(r"S(\d+)F(\d+)R(\d+)", match[2])]
        right = all(1 <= s <= f <= _TOP_SPEED and r <= 1000 for s, f, r in each)
        if not right or len(each) != len(names) or not set(names) <= set(self._controller.axes.by_name):
            return False
        for name, (_, fast, _) in zip(names, each, strict=True):
            self._controller.speed[name] = float(fast)
        return True
