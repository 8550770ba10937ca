"""Simulated firmware of SIGMA KOKI / OptoSigma controllers: the SHOT family (MAIN mode) and the GSC-02.

SHOT answers OK or NG to each command; while an axis moves, only stop and status are taken. GSC-02 answers questions
only, and knows relative moves only; ACK1 of the next ``Q:`` shows whether a command was taken. The count starts at 0 at
power-up, wherever the axes stand.
"""

import re
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

from lightopt.rig.simulated._axes import StageFirmware

_LONGEST = 256
_SHOT_TOP_SPEED = 500_000  # [pulses/s]
_GSC_FARTHEST = 16_777_214  # longest relative move [pulses]
_GSC_SPEEDS = {"1": (1, 200), "2": (50, 20_000)}  # ranges of D: [pulses/s]


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


class _SigmakokiFirmware(StageFirmware):
    """A controller with axis 1, or axes 1 and 2; speeds in pulses/s.

    Faults besides those of its axes: ``refuse`` (a command is refused and not obeyed), with the options of
    :class:`Trigger` counting commands other than questions.

    detached: Whether a sign stands at the left edge of its column rather than before the digits.
    """

    FAULTS: ClassVar[Mapping[str, Mapping[str, Any]]] = {"refuse": {}}
    VERSION: ClassVar[str]
    MOVES: ClassVar[tuple[str, ...]]
    STOP_ENDS_HOMING: ClassVar[bool] = True
    """Whether ``L:1`` and ``L:2`` stop the search for the origin, too."""

    IGNORED: ClassVar[dict[str, str]]
    """Patterns of the words of commands that are taken and change nothing here."""

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        speed: float = 5000.0,
        home_speed: float = 5000.0,
        detached: bool = False,
    ) -> None:
        super().__init__({"1": {}, "2": {}} if axes is None else axes)
        names = list(self._axes)
        if names not in (["1"], ["1", "2"]):
            raise ValueError(f"the axes are 1, or 1 and 2, found {', '.join(names)}")
        self._home_speed = home_speed
        self._power_up_speed = speed
        self._speed = dict.fromkeys(names, speed)
        self._detached = detached
        self._planned: dict[str, tuple[str, int]] = {}  # axis: kind of move (A, M, J) and number
        self._accepted = True

    def feed(self, data: bytes, now: float) -> bytes:
        self._buffer += data
        *whole, rest = re.split(rb"\r\n", self._buffer)
        self._buffer = rest[-_LONGEST:]
        replies = b""
        for line in (line.decode("ascii", "replace") for line in whole):
            answer = self._question(line, now)
            if answer is None:
                self._accepted = not self._struck("refuse") and self._obey(line, now)
                answer = self._acknowledgement()
            if answer is not None:
                replies += answer.encode() + b"\r\n"
        return replies

    def _power_up(self) -> None:
        self._speed = dict.fromkeys(self._speed, self._power_up_speed)
        self._planned.clear()
        self._buffer = b""

    @abstractmethod
    def _acknowledgement(self) -> str | None:
        """Reply to a command other than a question."""

    @abstractmethod
    def _homed_axes(self, words: str) -> list[str]:
        """Axes of ``H:``; empty or unknown ones where its words are wrong."""

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
            return self._stop(words, now)
        if self._axes_move(now):
            return False
        if verb in self.MOVES:
            return self._plan(verb, words)
        if verb == "G":
            return not words and self._start(now)
        if verb == "H":
            return self._home(self._homed_axes(words), now)
        if verb == "R":
            return self._zero(words, now)
        if verb == "D":
            return self._set_speeds(words)
        return verb in self.IGNORED and re.fullmatch(self.IGNORED[verb], words) is not None

    def _status(self, now: float) -> str:
        """Answer to Q: — positions, then whether the last command was taken, limits, busy or ready."""
        # a switch is read only once the axis is known to have stopped
        busy = self._axes_move(now)
        places = [position_text(round(axis.count(now)), detached=self._detached) for axis in self._axes.values()]
        hit = "".join(name for name, axis in self._axes.items() if axis.at_limit)
        limit = {"": "K", "1": "L", "2": "M", "12": "W"}[hit]
        return ",".join([*places, "K" if self._accepted else "X", limit, "B" if busy else "R"])

    def _plan(self, kind: str, words: str) -> bool:
        """Take the words of A:, M: or J:, and keep them for G:."""
        pattern = r"([+-])" if kind == "J" else r"([+-])P(\d+)"
        match = re.fullmatch(rf"([12W])((?:{pattern.replace('(', '(?:')})+)", words)
        if match is None:
            return False
        names = self._named(match[1])
        each = [m.groups() for m in re.finditer(pattern, match[2])]
        if len(each) != len(names) or not set(names) <= set(self._axes):
            return False
        self._planned = {
            name: (kind, int(f"{found[0]}{found[1] if kind != 'J' else 1}"))
            for name, found in zip(names, each, strict=True)
        }
        return True

    def _start(self, now: float) -> bool:
        """Go where A:, M: or J: said; refused when they did not."""
        if not self._planned:
            return False
        for name, (kind, number) in self._planned.items():
            axis = self._axes[name]
            target = float(number)
            if kind == "M":
                target += round(axis.count(now))
            elif kind == "J":
                target *= 1e9
            axis.move(target, self._speed[name], now)
        self._planned = {}
        return True

    def _home(self, names: list[str], now: float) -> bool:
        if not names or not set(names) <= set(self._axes):
            return False
        self._planned = {}
        for name in names:
            self._axes[name].home(self._home_speed, now)
        return True

    def _stop(self, words: str, now: float) -> bool:
        """Stop an axis, or all with W and E."""
        self._planned = {}
        if words in ("W", "E"):
            self._stop_axes(now)
            return True
        if words not in self._axes:
            return False
        if self.STOP_ENDS_HOMING or not self._axes[words].homing:
            self._axes[words].stop(now)
        return True

    def _named(self, word: str) -> list[str]:
        """Axes that a word names: W is all."""
        return list(self._axes) if word == "W" else [word]

    def _zero(self, words: str, now: float) -> bool:
        """Call the place where an axis stands 0."""
        names = self._named(words)
        if not set(names) <= set(self._axes):
            return False
        for name in names:
            self._axes[name].set_count(0.0, now)
        return True


class ShotFirmware(_SigmakokiFirmware):
    """A SHOT controller."""

    VERSION = "V1.30"
    MOVES = ("A", "M", "J")
    IGNORED: ClassVar[dict[str, str]] = {"C": r"[12W][01]", "S": r"[12]\d{1,3}"}

    def __init__(self, *, speed: float = 10_000.0, **options: Any) -> None:
        super().__init__(speed=speed, **options)

    def _acknowledgement(self) -> str:
        return "OK" if self._accepted else "NG"

    def _question(self, line: str, now: float) -> str | None:
        if line == "?:SW":  # divisions of a full step
            return ",".join("2" for _ in self._axes)
        return super()._question(line, now)

    def _obey(self, line: str, now: float) -> bool:
        return ":" in line and super()._obey(line, now)

    def _homed_axes(self, words: str) -> list[str]:
        return self._named(words)

    def _set_speeds(self, words: str) -> bool:
        match = re.fullmatch(r"([12W])((?:S\d+F\d+R\d+)+)", words)
        if match is None:
            return False
        names = self._named(match[1])
        each = [tuple(map(int, m)) for m in re.findall(r"S(\d+)F(\d+)R(\d+)", match[2])]
        right = all(1 <= s <= f <= _SHOT_TOP_SPEED and r <= 1000 for s, f, r in each)
        if not right or len(each) != len(names) or not set(names) <= set(self._axes):
            return False
        for name, (_, fast, _) in zip(names, each, strict=True):
            self._speed[name] = float(fast)
        return True


class GscFirmware(_SigmakokiFirmware):
    """A GSC-02."""

    VERSION = "V2.00"
    MOVES = ("M", "J")
    STOP_ENDS_HOMING = False
    IGNORED: ClassVar[dict[str, str]] = {"C": r"[12][01]|W[01][01]"}

    def __init__(
        self,
        *,
        axes: Mapping[str, Mapping[str, float]] | None = None,
        speed: float = 5000.0,
        home_speed: float = 5000.0,
    ) -> None:
        super().__init__(axes=axes, speed=speed, home_speed=home_speed, detached=True)

    def _acknowledgement(self) -> None:
        return None

    def _plan(self, kind: str, words: str) -> bool:
        if kind == "M" and any(int(way) > _GSC_FARTHEST for way in re.findall(r"\d+", words[1:])):
            return False
        return super()._plan(kind, words)

    def _homed_axes(self, words: str) -> list[str]:
        match = re.fullmatch(r"(?:([12])[+-])|(?:W[+-][+-])", words)
        return [] if match is None else [match[1]] if match[1] else list(self._axes)

    def _set_speeds(self, words: str) -> bool:
        match = re.fullmatch(r"([12])S(\d+)F(\d+)R(\d+)S(\d+)F(\d+)R(\d+)", words)
        if match is None:
            return False
        slowest, fastest = _GSC_SPEEDS[match[1]]
        numbers = [int(number) for number in match.groups()[1:]]
        for name, (slow, fast, ramp) in zip(self._axes, (numbers[:3], numbers[3:]), strict=False):
            if not (slowest <= slow <= fast <= fastest and ramp <= 1000):
                return False
            self._speed[name] = float(fast)
        return True
