"""Simulated firmware of SIGMA KOKI / OptoSigma controllers: the SHOT family (MAIN mode) and the GSC-02.

SHOT answers OK or NG to each command; while an axis moves, only stop and status are taken. GSC-02 answers questions
only, and knows relative moves only; ACK1 of the next ``Q:`` shows whether a command was taken. The count starts at 0 at
power-up, wherever the axes stand.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._axes import Axes
from lightopt.rig.simulated._faults import Trigger, trigger

_HOME_SPEED = 5000.0  # [pulses/s]
_LONGEST = 256


def position_text(pulses: int, *, detached: bool) -> str:
    """A position in ten columns; the sign stands at the left edge (detached) or before the digits.

    Examples
    --------
    >>> position_text(-1000, detached=True), position_text(-1000, detached=False)
    ('-     1000', '     -1000')
    """
    if detached:
        return f"{'-' if pulses < 0 else ' '}{abs(pulses):9d}"
    return f"{pulses:10d}"


class Controller:
    """The lines and the axes of a controller with one or two axes.

    Faults besides those of its axes: ``refuse`` (a command is refused and not obeyed), with ``after``, ``count``,
    ``probability`` and ``seed`` counting commands other than questions; ``power_cycle``.

    axes: Arguments of each axis by its number, ``"1"`` or ``"1"`` and ``"2"``; see :class:`Axes`. None: two of them.
    speed: Speed at power-up [pulses/s].
    home_speed: Speed of the search for the origin [pulses/s].
    """

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        speed: float = 5000.0,
        home_speed: float = _HOME_SPEED,
    ) -> None:
        self.axes = Axes({"1": {}, "2": {}} if axes is None else axes)
        names = list(self.axes.by_name)
        if names not in (["1"], ["1", "2"]):
            raise ValueError(f"the axes are 1, or 1 and 2, found {', '.join(names)}")
        self.home_speed = home_speed
        self._power_up_speed = speed
        self.speed = dict.fromkeys(names, speed)
        self.planned: dict[str, tuple[str, int]] = {}  # axis: kind of move (A, M, J) and number
        self._buffer = b""
        self._refuse: Trigger | None = None

    def lines(self, data: bytes) -> list[str]:
        """Whole lines of what has come."""
        self._buffer += data
        *whole, rest = re.split(rb"\r\n", self._buffer)
        self._buffer = rest[-_LONGEST:]
        return [line.decode("ascii", "replace") for line in whole]

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:
        """Suffer a fault; see the class."""
        if fault == "refuse":
            self._refuse = trigger(fault, options)
        elif fault == "power_cycle":
            self.axes.power_cycle(now)
            self.speed = dict.fromkeys(self.speed, self._power_up_speed)
            self.planned.clear()
            self._buffer = b""
        else:
            if fault == "clear":
                self._refuse = None
            self.axes.inject(fault, options, ("refuse", "power_cycle"))

    def refuses(self) -> bool:
        """Whether a command is refused because of a fault."""
        return self._refuse is not None and self._refuse.strikes()

    def status(self, now: float, *, accepted: bool, detached: bool) -> str:
        """Answer to Q: — positions, then whether the last command was taken, limits, busy or ready."""
        # a switch is read only once the axis is known to have stopped
        busy = self.axes.moving(now)
        places = [
            position_text(round(axis.count(now)), detached=detached) for axis in self.axes.by_name.values()
        ]
        hit = "".join(name for name, axis in self.axes.by_name.items() if axis.at_limit)
        limit = {"": "K", "1": "L", "2": "M", "12": "W"}[hit]
        return ",".join([*places, "K" if accepted else "X", limit, "B" if busy else "R"])

    def plan(self, kind: str, words: str) -> bool:
        """Take the words of A:, M: or J:, and keep them for G:."""
        pattern = r"([+-])" if kind == "J" else r"([+-])P(\d+)"
        match = re.fullmatch(rf"([12W])((?:{pattern.replace('(', '(?:')})+)", words)
        if match is None:
            return False
        names = list(self.axes.by_name) if match[1] == "W" else [match[1]]
        each = [m.groups() for m in re.finditer(pattern, match[2])]
        if len(each) != len(names) or not set(names) <= set(self.axes.by_name):
            return False
        self.planned = {
            name: (kind, int(f"{found[0]}{found[1] if kind != 'J' else 1}"))
            for name, found in zip(names, each, strict=True)
        }
        return True

    def start(self, now: float) -> bool:
        """Go where A:, M: or J: said; refused when they did not."""
        if not self.planned:
            return False
        for name, (kind, number) in self.planned.items():
            axis = self.axes[name]
            target = float(number)
            if kind == "M":
                target += round(axis.count(now))
            elif kind == "J":
                target *= 1e9
            axis.move(target, self.speed[name], now)
        self.planned = {}
        return True

    def home(self, names: list[str], now: float) -> bool:
        """Seek the origin of axes."""
        if not names or not set(names) <= set(self.axes.by_name):
            return False
        self.planned = {}
        for name in names:
            self.axes[name].home(self.home_speed, now)
        return True

    def stop(self, words: str, now: float, *, homing_stops: bool = True) -> bool:
        """Stop an axis, or all with W and E."""
        self.planned = {}
        if words in ("W", "E"):
            self.axes.stop(now)
            return True
        if words not in self.axes.by_name:
            return False
        if homing_stops or not self.axes[words].homing:
            self.axes[words].stop(now)
        return True

    def zero(self, words: str, now: float) -> bool:
        """Call the place where an axis stands 0."""
        names = list(self.axes.by_name) if words == "W" else [words]
        if not set(names) <= set(self.axes.by_name):
            return False
        for name in names:
            self.axes[name].set_count(0.0, now)
        return True


_TOP_SPEED = 500_000


class ShotFirmware:
    """A SHOT controller; faults as :class:`~lightopt.rig.simulated._stage_sigmakoki.Controller` has them.

    axes: Arguments of each axis by its number.
    speed, home_speed: Speed at power-up, and of the search for the origin [pulses/s].
    detached: Whether a sign stands at the left edge of its column rather than before the digits.
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


_FARTHEST = 16_777_214
_RANGES = {"1": (1, 200), "2": (50, 20_000)}


class GscFirmware:
    """A GSC-02; faults as :class:`~lightopt.rig.simulated._stage_sigmakoki.Controller` has them.

    axes: Arguments of each axis by its number.
    speed, home_speed: Speed at power-up, and of the search for the origin [pulses/s].
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
