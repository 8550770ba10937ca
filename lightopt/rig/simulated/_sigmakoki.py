"""What the simulated SIGMA KOKI controllers have in common: lines, axes, speeds, positions as text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from lightopt.rig.simulated._fault_trigger import Trigger, trigger
from lightopt.rig.simulated._travel import Axes

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

    Parameters
    ----------
    axes
        Arguments of each axis by its number, ``"1"`` or ``"1"`` and ``"2"``; see :class:`Axes`. None: two of them.
    speed
        Speed at power-up [pulses/s].
    home_speed
        Speed of the search for the origin [pulses/s].
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
