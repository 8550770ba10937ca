r"""Driver of light controllers whose commands the rig file spells out: templates out, patterns of replies in.

``set: "L{channel}{level:03d}\r\n"`` with ``set_reply: OK`` and ``end: "\r\n"`` is a whole protocol. Text is sent as
Latin-1, one byte per character.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from lightopt.errors import InputError
from lightopt.hardware._errors import ReplyError
from lightopt.hardware._lights import LightSettings, check_light
from lightopt.hardware._link import SerialLink
from lightopt.hardware._log import Event, SerialLog
from lightopt.hardware._retry import Persistence
from lightopt.hardware._roles import Identity

__all__ = ["TemplateController", "open_template"]

_BAUD = 9600


class TemplateController:
    """A light controller that speaks as a template says, as a :class:`~lightopt.hardware.LightController`.

    Opening asks for the intensity of channel 1 where the template can ask; no light changes.

    Parameters
    ----------
    link
        The wire.
    template
        ``set``, ``set_reply``, ``off``, ``off_reply``, ``read``, ``read_reply``, ``end`` as in the rig file; what is
        None or absent does not exist. Fields of commands: ``{channel}`` from 1, ``{channel0}`` from 0, ``{letter}``,
        ``{level}``. Patterns match a reply without its end.
    channels
        Number of channels.
    top_level
        Highest intensity.
    max_levels
        Intensities never exceeded, by channel.

    Raises
    ------
    lightopt.errors.InputError
        When a command names another field, or a pattern is none.
    lightopt.errors.HardwareError
        When the controller does not answer.
    """

    def __init__(
        self,
        link: SerialLink,
        template: Mapping[str, str | None],
        *,
        channels: int = 4,
        top_level: int = 255,
        max_levels: Mapping[int, int] | None = None,
    ) -> None:
        self._link = link
        self._channels = channels
        self._top_level = top_level
        self._max_levels = max_levels
        self._words = {key: text for key, text in template.items() if text is not None}
        self._end = self._words.get("end", "").encode("latin-1")
        self._patterns: dict[str, re.Pattern[bytes]] = {}
        self._check()
        self._persistence = Persistence(link)
        if self._reads:
            self._read(1)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self._channels

    @property
    def top_level(self) -> int:
        """Highest intensity."""
        return self._top_level

    @property
    def events(self) -> list[Event]:
        """What was out of the ordinary on the wire."""
        return self._link.events

    def identify(self) -> Identity:
        """Ask for an intensity where the template can; it has no question for a name."""
        if self._reads:
            self._read(1)
        return Identity("template", self._link.port, {"read_back": "yes" if self._reads else "no"})

    def set_level(self, channel: int, level: int) -> None:
        """Set the intensity, or darken by the template's own command; read back where it can."""
        check_light(
            self._link.device,
            channel,
            level,
            channels=self._channels,
            top_level=self._top_level,
            max_levels=self._max_levels,
        )
        verb = "off" if level == 0 and "off" in self._words else "set"
        with self._link.lock:
            self._persistence.ask(lambda: self._say(verb, channel, level))
            held = self._read(channel) if self._reads else level
        if held != level:
            raise self._link.failure(f"channel {channel} was set to {level} but holds {held}")

    def read_level(self, channel: int) -> int | None:
        """Intensity that the controller holds; None where the template cannot ask."""
        check_light(self._link.device, channel, 0, channels=self._channels, top_level=self._top_level)
        return self._read(channel) if self._reads else None

    def close(self) -> None:
        """Give up the link; lights stay as they are."""
        self._link.close()

    @property
    def _reads(self) -> bool:
        return "read" in self._words

    def _check(self) -> None:
        for verb in ("set", "off", "read"):
            self._check_verb(verb)
        if self._reads and "level" not in getattr(self._patterns.get("read"), "groupindex", {}):
            raise InputError(f"{self._link.device}: template.read_reply has no group (?P<level>…)")

    def _check_verb(self, verb: str) -> None:
        try:
            if verb in self._words:
                self._command(verb, 1, 0)
            if f"{verb}_reply" in self._words:
                pattern = self._words[f"{verb}_reply"].encode("latin-1")
                self._patterns[verb] = re.compile(pattern, re.DOTALL)
        except (KeyError, IndexError, ValueError, re.error) as error:
            raise InputError(f"{self._link.device}: template.{verb} cannot be used: {error}") from None

    def _command(self, verb: str, channel: int, level: int) -> bytes:
        text = self._words[verb].format(
            channel=channel, channel0=channel - 1, letter=chr(ord("A") + channel - 1), level=level
        )
        return text.encode("latin-1")

    def _read(self, channel: int) -> int:
        return self._persistence.ask(lambda: self._read_once(channel))

    def _read_once(self, channel: int) -> int:
        digits = self._say("read", channel, 0)["level"]
        try:
            return int(digits)
        except ValueError:
            raise ReplyError(self._link.words("the reply's level is no number", reply=digits)) from None

    def _say(self, verb: str, channel: int, level: int) -> dict[str, bytes]:
        """Send a command and match its reply; the pattern's groups."""
        frame = self._command(verb, channel, level)
        pattern = self._patterns.get(verb)
        if pattern is None:
            self._link.send(frame)
            return {}
        reply = self._link.query(frame, end=self._end or None)
        match = pattern.fullmatch(reply[: len(reply) - len(self._end)])
        if match is None:
            what = f"the reply does not match template.{verb}_reply"
            raise ReplyError(self._link.words(what, sent=frame, reply=reply))
        return match.groupdict()


def open_template(settings: LightSettings, log: SerialLog | None = None) -> TemplateController:
    """Open a controller that the rig file describes.

    Raises
    ------
    lightopt.errors.InputError
        When the port cannot be opened, or the template cannot be used.
    lightopt.errors.HardwareError
        When the controller does not answer.
    """
    if settings.template is None:
        raise InputError(f"light controller {settings.name} (template): there is no template")
    link = SerialLink(
        settings.port,
        device=f"light controller {settings.name} (template)",
        baud=settings.baud or _BAUD,
        timeout_s=settings.timeout_s,
        log=log,
    )
    try:
        return TemplateController(
            link,
            settings.template,
            channels=settings.channels,
            top_level=settings.top_level,
            max_levels=settings.max_levels,
        )
    except BaseException:
        link.close()
        raise
