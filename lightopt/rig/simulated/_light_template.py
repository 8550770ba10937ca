"""Simulated firmware of a controller that a rig file describes by templates of commands and patterns of replies."""

import re
import string
from collections.abc import Iterator, Mapping

from lightopt.rig.simulated._lamps import LampFirmware, Lamps

_LONGEST = 256


class TemplateFirmware(LampFirmware):
    """A controller that understands the commands of a template, and replies with what their patterns match.

    Commands and patterns are as in the rig file. A command that fault ``ng`` refuses is answered ``?`` with the end.
    """

    def __init__(
        self,
        *,
        template: Mapping[str, str | None],
        channels: int = 4,
        top_level: int = 255,
        levels: Mapping[str, int] | None = None,
    ) -> None:
        super().__init__(Lamps(channels, top_level, levels))
        self._template = {key: value for key, value in template.items() if value is not None}
        self._end = self._template.get("end", "")
        self._commands = [
            (verb, channel, re.compile(_understood(self._template[verb], channel), re.DOTALL))
            for verb in ("off", "set", "read")
            if verb in self._template
            for channel in range(1, channels + 1)
        ]
        self._text = ""
        for verb in ("set", "off", "read"):
            self._reply(verb, top_level)

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        self._text += data.decode("latin-1")
        replies = "".join(self._answers())
        self._text = self._text[-_LONGEST:]
        return replies.encode("latin-1")

    def _answers(self) -> Iterator[str]:
        while (found := self._first()) is not None:
            verb, channel, match = found
            self._text = self._text[match.end() :]
            level = int(match["level"]) if "level" in match.re.groupindex else 0
            if level > self._lamps.top_level or self._struck("ng"):
                yield "?" + self._end
                continue
            if verb != "read":
                self._lamps.set_level(channel, level)
            yield self._reply(verb, self._lamps.level[channel])

    def _first(self) -> tuple[str, int, re.Match[str]] | None:
        """The earliest command in the buffer, with what lies before it thrown away."""
        found = [(verb, channel, pattern.search(self._text)) for verb, channel, pattern in self._commands]
        hits = [(verb, channel, match) for verb, channel, match in found if match is not None]
        return min(hits, key=lambda hit: hit[2].start()) if hits else None

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
        single = re.match(r"\[\^?\]?(?:\\.|[^\]\\])*\]|\\x[0-9a-fA-F]{2}|\\u[0-9a-fA-F]{4}|\\.|.", rest, re.DOTALL)
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
