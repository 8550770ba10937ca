"""Simulated firmware of a controller that a rig file describes by templates of commands and patterns of replies."""

from __future__ import annotations

import re
import string
from collections.abc import Iterator, Mapping
from typing import Any

from lightopt.rig.simulated._fault_trigger import Trigger, trigger
from lightopt.rig.simulated._lamps import Lamps
from lightopt.rig.simulated._reply_patterns import example

_LONGEST = 256


class TemplateFirmware:
    """A controller that understands the commands of a template, and replies with what their patterns match.

    Faults besides those of its lamps: ``ng`` (the command is answered ``?`` with the end of replies and not obeyed),
    with ``after``, ``count``, ``probability`` and ``seed``.

    Parameters
    ----------
    template
        Commands and patterns as in the rig file: ``set``, ``set_reply``, ``off``, ``off_reply``, ``read``,
        ``read_reply``, ``end``; those that are None or absent do not exist.
    channels
        Number of channels.
    top_level
        Highest intensity.
    levels
        Intensities at power-up by channel.
    """

    def __init__(
        self,
        *,
        template: Mapping[str, str | None],
        channels: int = 4,
        top_level: int = 255,
        levels: Mapping[str, int] | None = None,
    ) -> None:
        self._template = {key: value for key, value in template.items() if value is not None}
        self._end = self._template.get("end", "")
        self._lamps = Lamps(channels, top_level, levels)
        self._commands = [
            (verb, channel, re.compile(_understood(self._template[verb], channel), re.DOTALL))
            for verb in ("off", "set", "read")
            if verb in self._template
            for channel in range(1, channels + 1)
        ]
        self._buffer = ""
        self._ng: Trigger | None = None
        for verb in ("set", "off", "read"):
            self._reply(verb, top_level)

    def feed(self, data: bytes, now: float) -> bytes:  # noqa: ARG002
        """Take bytes; answer the commands that they complete."""
        self._buffer += data.decode("latin-1")
        replies = "".join(self._answers())
        self._buffer = self._buffer[-_LONGEST:]
        return replies.encode("latin-1")

    def poll(self, now: float) -> bytes:  # noqa: ARG002
        """Return nothing: it speaks when spoken to."""
        return b""

    def levels(self) -> dict[int, float]:
        """Brightness of each channel."""
        return self._lamps.shine()

    def inject(self, fault: str, options: dict[str, Any], now: float) -> None:  # noqa: ARG002
        """Suffer a fault; see the class."""
        if fault == "ng":
            self._ng = trigger(fault, options)
            return
        if fault == "clear":
            self._ng = None
        self._lamps.inject(fault, options, ("ng",))

    def _answers(self) -> Iterator[str]:
        while (found := self._first()) is not None:
            verb, channel, match = found
            self._buffer = self._buffer[match.end() :]
            level = int(match["level"]) if "level" in match.re.groupindex else 0
            if level > self._lamps.top_level or (self._ng is not None and self._ng.strikes()):
                yield "?" + self._end
                continue
            if verb != "read":
                self._lamps.set_level(channel, level)
            yield self._reply(verb, self._lamps.level(channel))

    def _first(self) -> tuple[str, int, re.Match[str]] | None:
        """The earliest command in the buffer, with what lies before it thrown away."""
        found = [(verb, channel, pattern.search(self._buffer)) for verb, channel, pattern in self._commands]
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
