"""The little of G-code that a stage needs, as Grbl 1.1 reads it."""

from __future__ import annotations

import re
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
    """What one line leaves to the next.

    Attributes
    ----------
    rapid
        G0 rather than G1.
    relative
        G91 rather than G90.
    feed
        F [mm/min].
    """

    rapid: bool = True
    relative: bool = False
    feed: float = 0.0


@dataclass(frozen=True)
class Move:
    """What a line asks for.

    Attributes
    ----------
    words
        Axis words by letter [mm].
    relative, rapid, feed
        How to read and go them.
    dwell_s
        G4: time [s] to wait when all moves are done; None without one.
    """

    words: dict[str, float] = field(default_factory=dict[str, float])
    relative: bool = False
    rapid: bool = False
    feed: float = 0.0
    dwell_s: float | None = None


def parse_line(text: str, modes: Modes, *, jog: bool = False) -> Move:
    """Read a line, and change the modes as it says; a jog changes none.

    Raises
    ------
    GcodeError
        When Grbl would refuse it; the modes are then as they were.
    """
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


def _understood(
    commands: list[tuple[str, float]], words: dict[str, float], modes: Modes, *, jog: bool
) -> Move:
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
