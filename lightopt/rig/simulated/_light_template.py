"""Simulated firmware of a controller that a rig file describes by templates of commands and patterns of replies."""

import re
import string
from collections.abc import Iterator, Mapping
from typing import Any

from lightopt.rig.simulated._firmware import LampFirmware

_LONGEST = 256


class TemplateFirmware(LampFirmware):
    """A controller that understands a rig file's templates; a level that it does not have is answered ``?``."""

    def __init__(self, *, template: Mapping[str, str | None], **lamps: Any) -> None:
        super().__init__(**lamps)
        self._template = {key: value for key, value in template.items() if value is not None}
        self._end = self._template.get("end", "")
        verbs = [verb for verb in ("off", "set", "read") if verb in self._template]
        patterns = [(verb, n, _understood(self._template[verb], n)) for verb in verbs for n in self._level]
        self._commands = [(verb, n, re.compile(pattern, re.DOTALL)) for verb, n, pattern in patterns]
        self._text = ""
        for verb in ("set", "off", "read"):
            self._reply(verb, self._top_level)

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        self._text += data.decode("latin-1")
        replies = "".join(self._answers())
        self._text = self._text[-_LONGEST:]
        return replies.encode("latin-1")

    def _answers(self) -> Iterator[str]:
        while (found := self._first()) is not None:
            verb, channel, match = found
            self._text = self._text[match.end() :]
            yield self._obey(verb, channel, int(match["level"]) if "level" in match.re.groupindex else 0)

    def _obey(self, verb: str, channel: int, level: int) -> str:
        if level > self._top_level:
            return "?" + self._end
        if verb != "read":
            self._level[channel] = level
        return self._reply(verb, self._level[channel])

    def _first(self) -> tuple[str, int, re.Match[str]] | None:
        """The earliest command in the buffer, with what lies before it thrown away."""
        found = [(verb, n, match) for verb, n, one in self._commands if (match := one.search(self._text))]
        return min(found, key=lambda hit: hit[2].start(), default=None)

    def _reply(self, verb: str, level: int) -> str:
        """Reply to a command; its pattern describes it without the end."""
        pattern = self._template.get(f"{verb}_reply")
        return "" if pattern is None else example(pattern, level) + self._end


def _understood(command: str, channel: int) -> str:
    """Pattern of a command for one channel, with a group for the level."""
    values = {"channel": channel, "channel0": channel - 1, "letter": chr(64 + channel)}
    pattern = ""
    for literal, name, form, _ in string.Formatter().parse(command):
        pattern += re.escape(literal)
        if name == "level":
            width = re.fullmatch(r"0?(\d+)d?", form or "")
            pattern += rf"(?P<level>[\d ]{{{width[1]}}})" if width else r"(?P<level>\d+)"
        elif name is not None:
            pattern += re.escape(format(values[name], form or ""))
    return pattern


# Tried in turn for a class of characters.
_CANDIDATES = "0" + string.ascii_letters + string.digits + string.punctuation + " \r\n\t\x02\x03\x06\x15"
_WIDEST = 8


def example(pattern: str, level: int | None = None) -> str:
    """The plainest text that a pattern matches wholly.

    Alternatives are resolved to the first, repetitions to the fewest; a group named ``level`` becomes the level, with
    as many leading zeros as the pattern wants. Raises a ValueError for a pattern that looks around, refers back, or is
    conditional.
    """
    for width in range(1, _WIDEST + 1):
        maker = _Maker(pattern, "" if level is None else f"{level:0{width}d}")
        text = maker.alternatives()
        if maker.at == len(pattern) and re.fullmatch(pattern, text, re.DOTALL):
            return text
    raise ValueError(f"cannot make up a reply that matches {pattern!r}")


_ATOM = re.compile(
    r"\((?:\?:|\?P<(?P<name>\w+)>|(?!\?))|\[\^?\]?(?:\\.|[^\]\\])*\]|\\x[0-9a-fA-F]{2}|\\u[0-9a-fA-F]{4}|\\[^1-9]|[^(|)\\]",
    re.DOTALL,
)
_REPETITION = re.compile(r"([*+?]|\{(\d*),?\d*\})[?+]?")
_ALTERNATIVE, _END_OF_GROUP = re.compile(r"\|"), re.compile(r"\)")


class _Maker:
    def __init__(self, pattern: str, level: str) -> None:
        self._pattern = pattern
        self._level = level
        self.at = 0  # how far the pattern is understood

    def _take(self, token: re.Pattern[str]) -> re.Match[str] | None:
        match = token.match(self._pattern, self.at)
        self.at = self.at if match is None else match.end()
        return match

    def alternatives(self) -> str:
        chosen = self._sequence()
        while self._take(_ALTERNATIVE):
            self._sequence()
        return chosen

    def _sequence(self) -> str:
        text = ""
        while match := self._take(_ATOM):
            atom = self._example(match)
            times = self._take(_REPETITION)
            text += atom * (1 if times is None or times[1] == "+" else int(times[2] or 0))
        return text

    def _example(self, atom: re.Match[str]) -> str:
        """Text that a group, a class of characters or a single character matches."""
        if atom[0].startswith("("):
            text = self.alternatives()
            if self._take(_END_OF_GROUP) is None:
                raise ValueError(f"cannot make up a reply that matches {self._pattern!r}")
            return self._level if atom["name"] == "level" else text
        if atom[0][0] not in "\\[.^$":
            return atom[0]
        everything = ["", *_CANDIDATES, *map(chr, range(256))]
        return next((text for text in everything if re.fullmatch(atom[0], text)), "")
