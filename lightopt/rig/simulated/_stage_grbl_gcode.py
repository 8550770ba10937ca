"""The little of G-code that a stage needs, as Grbl 1.1 reads it, and the settings ``$0`` to ``$132``."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

_WORD = re.compile(r"([A-Z])([+-]?(?:\d+\.?\d*|\.\d+))")
_KNOWN = {0, 1, 4, 17, 21, 53, 54, 90, 91, 94}
_KNOWN_M = {5, 9}
_LETTER, _NUMBER, _UNSUPPORTED, _NO_FEED, _UNUSED = 1, 2, 20, 22, 36


class GcodeError(Exception):
    """A line that Grbl refuses, with the number of the error."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


@dataclass
class Modes:
    """What one line leaves to the next: G0 rather than G1, G91 rather than G90, and F [mm/min]."""

    rapid: bool = True
    relative: bool = False
    feed: float = 0.0


@dataclass(frozen=True)
class Move:
    """What a line asks for: axis words by letter [mm], how to read and go them, the time that G4 waits at the end."""

    words: dict[str, float] = field(default_factory=dict[str, float])
    relative: bool = False
    rapid: bool = False
    feed: float = 0.0
    dwell_s: float | None = None


def parse_line(text: str, modes: Modes, *, jog: bool = False) -> Move:
    """Read a line and change the modes; a jog, and a line that raises a GcodeError, leave them as they were."""
    line = re.sub(r"\s", "", text).upper()
    words: dict[str, float] = {}
    commands: list[tuple[str, float]] = []
    at = 0
    while at < len(line):
        match = _WORD.match(line, at)
        if match is None:
            raise GcodeError(_NUMBER if line[at].isalpha() else _LETTER)
        letter, number = match[1], float(match[2])
        if letter in "GM":
            commands.append((letter, number))
        elif letter in "XYZFPN":
            words[letter] = number
        else:
            raise GcodeError(_UNSUPPORTED)
        at = match.end()
    return _understood(commands, words, modes, jog=jog)


def _understood(commands: list[tuple[str, float]], words: dict[str, float], modes: Modes, *, jog: bool) -> Move:
    numbers = {number for letter, number in commands if letter == "G"}
    if not numbers <= _KNOWN or not {n for letter, n in commands if letter == "M"} <= _KNOWN_M:
        raise GcodeError(_UNSUPPORTED)
    rapid = 0 in numbers or (modes.rapid and 1 not in numbers)
    relative = 91 in numbers or (modes.relative and 90 not in numbers)
    feed = words.get("F", 0.0 if jog else modes.feed)
    axes = {letter: number for letter, number in words.items() if letter in "XYZ"}
    dwell = words.get("P") if 4 in numbers else None
    if "P" in words and dwell is None:
        raise GcodeError(_UNUSED)
    if axes and feed <= 0 and (jog or not rapid):
        raise GcodeError(_NO_FEED)
    if not jog:
        modes.rapid, modes.relative, modes.feed = rapid, relative, feed
    return Move(words=axes, relative=relative, rapid=rapid and not jog, feed=feed, dwell_s=dwell)


# as a Grbl 1.1h lists them when new: number=value, with as many decimals as it writes
_NEW = """
0=10 1=25 2=0 3=0 4=0 5=0 6=0 10=1 11=0.010 12=0.002 13=0 20=0 21=0 22=0 23=0 24=25.000 25=500.000 26=250 27=1.000
30=1000 31=0 32=0 100=250.000 101=250.000 102=250.000 110=500.000 111=500.000 112=500.000
120=10.000 121=10.000 122=10.000 130=200.000 131=200.000 132=200.000
"""
_UNKNOWN, _NEEDS_HOMING = 3, 10
_SOFT_LIMITS, _HOMING = 20, 22


class GrblSettings:
    """The settings by number; `changed` are those that are not as new, by their numbers as text."""

    def __init__(self, changed: Mapping[str, float]) -> None:
        self._values: dict[int, float] = {}
        self._decimals: dict[int, int] = {}
        for item in _NEW.split():
            number, _, value = item.partition("=")
            self._values[int(number)] = float(value)
            self._decimals[int(number)] = len(value.partition(".")[2])
        for key, value in changed.items():
            if not key.isdigit() or int(key) not in self._values:
                raise ValueError(f"Grbl has no setting ${key}")
            self._values[int(key)] = float(value)

    def __getitem__(self, number: int) -> float:
        return self._values[number]

    def lines(self) -> bytes:
        """Answer to ``$$`` without its ok."""
        return b"".join(
            f"${number}={value:.{self._decimals[number]}f}\r\n".encode() for number, value in self._values.items()
        )

    def set_from(self, line: str) -> None:
        """Obey ``$number=value``; a GcodeError when Grbl refuses it."""
        match = re.fullmatch(r"\$(\d+)=(\d+(?:\.\d+)?)", line)
        if match is None or int(match[1]) not in self._values:
            raise GcodeError(_UNKNOWN)
        number, value = int(match[1]), float(match[2])
        if number == _SOFT_LIMITS and value and not self._values[_HOMING]:
            raise GcodeError(_NEEDS_HOMING)
        self._values[number] = value
        if number == _HOMING and not value:
            self._values[_SOFT_LIMITS] = 0.0
