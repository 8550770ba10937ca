"""A reply that matches a pattern, so that firmware can be made up from patterns of replies."""

from __future__ import annotations

import re
import string

# Tried in turn for a class of characters.
_CANDIDATES = "0" + string.ascii_letters + string.digits + string.punctuation + " \r\n\t\x02\x03\x06\x15"
_WIDEST = 8


def example(pattern: str, level: int | None = None) -> str:
    """Make up the plainest text that a pattern matches wholly.

    Alternatives are resolved to the first, repetitions to the fewest; a group named ``level`` becomes the level, with
    as many leading zeros as the pattern wants.

    Parameters
    ----------
    pattern
        Regular expression.
    level
        Value of the group ``level``.

    Raises
    ------
    ValueError
        When none can be made up: the pattern looks around, refers back, or is conditional.
    """
    for width in range(1, _WIDEST + 1):
        text = _Maker(pattern, "" if level is None else f"{level:0{width}d}").make()
        if re.fullmatch(pattern, text, re.DOTALL):
            return text
    raise ValueError(f"cannot make up a reply that matches {pattern!r}")


class _Maker:
    """One walk over a pattern."""

    def __init__(self, pattern: str, level: str) -> None:
        self._pattern = pattern
        self._level = level
        self._at = 0

    def make(self) -> str:
        text = self._alternatives()
        if self._at != len(self._pattern):
            raise ValueError(f"cannot make up a reply that matches {self._pattern!r}")
        return text

    def _rest(self) -> str:
        return self._pattern[self._at :]

    def _alternatives(self) -> str:
        chosen = self._sequence()
        while self._rest().startswith("|"):
            self._at += 1
            self._sequence()
        return chosen

    def _sequence(self) -> str:
        text = ""
        while self._rest() and self._rest()[0] not in "|)":
            atom = self._atom()
            text += atom * self._fewest()
        return text

    def _fewest(self) -> int:
        match = re.match(r"([*+?]|\{(\d*),?\d*\})[?+]?", self._rest())
        if match is None:
            return 1
        self._at += match.end()
        return 1 if match[1] == "+" else int(match[2] or 0)

    def _atom(self) -> str:
        rest = self._rest()
        if rest[0] == "(":
            return self._group()
        single = re.match(
            r"\[\^?\]?(?:\\.|[^\]\\])*\]|\\x[0-9a-fA-F]{2}|\\u[0-9a-fA-F]{4}|\\.|.", rest, re.DOTALL
        )
        if single is None or re.match(r"\\[1-9]", single[0]):
            raise ValueError(f"cannot make up a reply that matches {self._pattern!r}")
        self._at += single.end()
        literal = not single[0].startswith(("\\", "[")) and single[0] not in ".^$"
        if literal or re.fullmatch(single[0], ""):
            return single[0] if literal else ""
        everything = _CANDIDATES + "".join(map(chr, range(256)))
        return next((c for c in everything if re.fullmatch(single[0], c)), "")

    def _group(self) -> str:
        head = re.match(r"\((?:\?:|\?P<(\w+)>|(?!\?))", self._rest())
        if head is None:
            raise ValueError(f"cannot make up a reply that matches {self._pattern!r}")
        self._at += head.end()
        text = self._alternatives()
        if not self._rest().startswith(")"):
            raise ValueError(f"cannot make up a reply that matches {self._pattern!r}")
        self._at += 1
        return self._level if head[1] == "level" else text
