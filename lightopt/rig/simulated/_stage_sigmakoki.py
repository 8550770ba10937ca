"""Simulated firmware of SIGMA KOKI / OptoSigma controllers: the SHOT family (MAIN mode) and the GSC-02.

While an axis moves, only stop and status are taken. The count starts at 0 at power-up, wherever the axes stand.
"""

import re
from abc import abstractmethod
from collections.abc import Iterable, Mapping
from typing import ClassVar

from lightopt.rig.simulated._firmware import StageFirmware

_SHOT_SPEEDS = (1, 500_000)  # [pulses/s]
_GSC_FARTHEST = 16_777_214  # longest relative move [pulses]
_GSC_SPEEDS = {"1": (1, 200), "2": (50, 20_000)}  # ranges of D: [pulses/s]


class _SigmakokiFirmware(StageFirmware):
    """A controller with axis 1, or axes 1 and 2; speeds in pulses/s."""

    VERSION: ClassVar[str]
    MOVES: ClassVar[tuple[str, ...]]
    SPEED: ClassVar[float]  # speed at power-up [pulses/s]
    HOME: ClassVar[str]  # pattern of the words of ``H:``; its group is the axis, none for all
    ANSWERS: ClassVar[bool] = True  # whether commands other than questions are answered
    DETACHED: ClassVar[bool] = False
    """Whether a sign stands at the left edge of its column rather than before the digits."""

    def __init__(self, *, axes: Mapping[str, Mapping[str, float]] | None = None, home_speed: float = 5000.0) -> None:
        super().__init__({"1": {}, "2": {}} if axes is None else axes)
        names = list(self._axes)
        if names not in (["1"], ["1", "2"]):
            raise ValueError(f"the axes are 1, or 1 and 2, found {', '.join(names)}")
        self._home_speed = home_speed
        self._speed = dict.fromkeys(names, self.SPEED)
        self._planned: dict[str, tuple[str, int]] = {}  # axis: kind of move (A, M) and number
        self._accepted = True

    def _answer(self, command: bytes, now: float) -> bytes:
        line = command.decode("ascii", "replace")
        answer = self._question(line, now)
        if answer is None:
            self._accepted = self._obey(line, now)
            if not self.ANSWERS:
                return b""
            answer = "OK" if self._accepted else "NG"
        return answer.encode() + self.END

    @abstractmethod
    def _set_speeds(self, words: str) -> bool:
        """Take the words of ``D:``."""

    def _question(self, line: str, now: float) -> str | None:
        if line == "Q:":
            return self._status(now)
        if line == "!:":
            return "B" if self._axes_move(now) else "R"
        return self.VERSION if line == "?:V" else None

    def _obey(self, line: str, now: float) -> bool:
        verb, _, words = line.partition(":")
        if verb == "L":
            self._planned = {}
            if words in ("W", "E"):  # all; it ends the search for the origin, too
                self._stop_axes(now)
            return words in ("W", "E")
        if self._axes_move(now):
            return False
        if verb in self.MOVES:
            return self._plan(verb, words)
        if verb == "G":
            return not words and self._start(now)
        if verb == "H":
            return self._home(words, now)
        return verb == "D" and self._set_speeds(words)

    def _status(self, now: float) -> str:
        """Answer to Q: — positions, then whether the last command was taken, limits, busy or ready."""
        # a switch is read only once the axis is known to have stopped
        busy = self._axes_move(now)
        pulses = [round(axis.count(now)) for axis in self._axes.values()]
        places = [f"{'-' if p < 0 else ' '}{abs(p):9d}" if self.DETACHED else f"{p:10d}" for p in pulses]
        hit = "".join(name for name, axis in self._axes.items() if axis.at_limit)
        limit = {"": "K", "1": "L", "2": "M", "12": "W"}[hit]
        return ",".join([*places, "K" if self._accepted else "X", limit, "B" if busy else "R"])

    def _plan(self, kind: str, words: str) -> bool:
        match = re.fullmatch(r"([12W])((?:[+-]P\d+)+)", words)
        if match is None:
            return False
        names = list(self._axes) if match[1] == "W" else [match[1]]
        numbers = [int(number) for number in re.findall(r"[+-]\d+", match[2].replace("P", ""))]
        if len(numbers) != len(names) or not set(names) <= set(self._axes):
            return False
        self._planned = {name: (kind, number) for name, number in zip(names, numbers, strict=True)}
        return True

    def _start(self, now: float) -> bool:
        if not self._planned:
            return False
        for name, (kind, number) in self._planned.items():
            axis = self._axes[name]
            start = round(axis.count(now)) if kind == "M" else 0
            axis.move(float(start + number), self._speed[name], now)
        self._planned = {}
        return True

    def _home(self, words: str, now: float) -> bool:
        match = re.fullmatch(self.HOME, words)
        if match is None or (match[1] and match[1] not in self._axes):
            return False
        self._planned = {}
        for name in [match[1]] if match[1] else self._axes:
            self._axes[name].home(self._home_speed, now)
        return True

    def _set_speed(self, name: str, words: Iterable[str], limits: tuple[int, int]) -> bool:
        slow, fast, ramp = map(int, words)
        if name not in self._axes or not (limits[0] <= slow <= fast <= limits[1] and ramp <= 1000):
            return False
        self._speed[name] = float(fast)
        return True


class ShotFirmware(_SigmakokiFirmware):
    VERSION = "V1.30"
    MOVES = ("A", "M")
    SPEED = 10_000.0
    HOME = "([12])|W"

    def _question(self, line: str, now: float) -> str | None:
        if line == "?:SW":  # divisions of a full step
            return ",".join("2" for _ in self._axes)
        return super()._question(line, now)

    def _obey(self, line: str, now: float) -> bool:
        return ":" in line and super()._obey(line, now)

    def _set_speeds(self, words: str) -> bool:
        match = re.fullmatch(r"([12])S(\d+)F(\d+)R(\d+)", words)
        return match is not None and self._set_speed(match[1], match.groups()[1:], _SHOT_SPEEDS)


class GscFirmware(_SigmakokiFirmware):
    VERSION = "V2.00"
    MOVES = ("M",)
    SPEED = 5000.0
    HOME = r"([12])[+-]|W[+-][+-]"
    ANSWERS = False
    DETACHED = True

    def _plan(self, kind: str, words: str) -> bool:
        if any(int(way) > _GSC_FARTHEST for way in re.findall(r"\d+", words[1:])):
            return False
        return super()._plan(kind, words)

    def _set_speeds(self, words: str) -> bool:
        match = re.fullmatch(r"([12])S(\d+)F(\d+)R(\d+)S(\d+)F(\d+)R(\d+)", words)
        if match is None:
            return False
        words_of_axes = zip(self._axes, (match.groups()[1:4], match.groups()[4:]), strict=False)
        return all(self._set_speed(name, its_words, _GSC_SPEEDS[match[1]]) for name, its_words in words_of_axes)
