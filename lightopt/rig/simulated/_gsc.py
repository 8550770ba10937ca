"""Simulated firmware of the SIGMA KOKI / OptoSigma GSC-02: silent but to questions, relative moves only.

Whether a command was taken is told by ACK1 of the next ``Q:``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._sigmakoki import Controller

_FARTHEST = 16_777_214
_RANGES = {"1": (1, 200), "2": (50, 20_000)}


class GscFirmware:
    """A GSC-02; faults as :class:`~lightopt.rig.simulated._sigmakoki.Controller` has them.

    Parameters
    ----------
    axes
        Arguments of each axis by its number.
    speed, home_speed
        Speed at power-up, and of the search for the origin [pulses/s].
    """

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        speed: float = 5000.0,
        home_speed: float = 5000.0,
    ) -> None:
        self._controller = Controller(axes=axes, speed=speed, home_speed=home_speed)
        self._accepted = True

    def feed(self, data: bytes, now: float) -> bytes:
        """Take bytes; answer the questions among them."""
        replies = b""
        for line in self._controller.lines(data):
            question = self._question(line, now)
            if question is None:
                self._accepted = not self._controller.refuses() and self._obey(line, now)
            else:
                replies += question.encode() + b"\r\n"
        return replies

    def poll(self, now: float) -> bytes:  # noqa: ARG002
        """Return nothing: it speaks when spoken to."""
        return b""

    def positions(self, now: float) -> dict[str, float]:
        """Where each axis really stands [pulses from its origin]."""
        return self._controller.axes.real(now)

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:
        """Suffer a fault; see the class."""
        self._controller.inject(fault, options, now)

    def _question(self, line: str, now: float) -> str | None:
        if line == "Q:":
            return self._controller.status(now, accepted=self._accepted, detached=True)
        if line == "!:":
            return "B" if self._controller.axes.moving(now) else "R"
        if line == "?:V":
            return "V2.00"
        return None

    def _obey(self, line: str, now: float) -> bool:
        verb, _, words = line.partition(":")
        controller = self._controller
        if verb == "L":
            return controller.stop(words, now, homing_stops=False)
        if controller.axes.moving(now):
            return False
        if verb == "M":
            near = all(int(way) <= _FARTHEST for way in re.findall(r"\d+", words[1:]))
            return near and controller.plan(verb, words)
        if verb == "J":
            return controller.plan(verb, words)
        if verb == "G":
            return not words and controller.start(now)
        if verb == "H":
            match = re.fullmatch(r"(?:([12])[+-])|(?:W[+-][+-])", words)
            names = [] if match is None else [match[1]] if match[1] else list(controller.axes.by_name)
            return controller.home(names, now)
        if verb == "R":
            return controller.zero(words, now)
        if verb == "D":
            return self._set_speeds(words)
        if verb == "C":
            return re.fullmatch(r"[12][01]|W[01][01]", words) is not None
        return False

    def _set_speeds(self, words: str) -> bool:
        match = re.fullmatch(r"([12])S(\d+)F(\d+)R(\d+)S(\d+)F(\d+)R(\d+)", words)
        if match is None:
            return False
        slowest, fastest = _RANGES[match[1]]
        numbers = [int(number) for number in match.groups()[1:]]
        for name, (slow, fast, ramp) in zip(
            self._controller.axes.by_name, (numbers[:3], numbers[3:]), strict=False
        ):
            if not (slowest <= slow <= fast <= fastest and ramp <= 1000):
                return False
            self._controller.speed[name] = float(fast)
        return True
