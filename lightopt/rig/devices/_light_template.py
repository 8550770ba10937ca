r"""Driver of light controllers whose commands the rig file spells out: templates out, patterns of replies in.

``set: "L{channel}{level:03d}\r\n"`` with ``set_reply: OK`` and ``end: "\r\n"`` is a whole protocol. Text is sent as
Latin-1, one byte per character.
"""

import re

from lightopt.rig.devices._device import ReplyError
from lightopt.rig.devices._light import LightController, LightSettings
from lightopt.rig.devices._serial_link import SerialLink


class TemplateController(LightController):
    """A light controller with the commands of a template; opening asks for the intensity of channel 1 where it can.

    Its template has ``set``, ``set_reply``, ``off``, ``off_reply``, ``read``, ``read_reply``, ``end`` as in the rig
    file; what is None or absent does not exist. Fields of commands: ``{channel}`` from 1, ``{channel0}`` from 0,
    ``{letter}``, ``{level}``. Patterns match a reply without its end.
    """

    NAME = "template"
    BAUD = 9600

    def __init__(self, link: SerialLink, settings: LightSettings) -> None:
        super().__init__(link, settings)
        assert settings.template is not None
        self._words = {key: text for key, text in settings.template.items() if text is not None}
        self._end = self._words.get("end", "").encode("latin-1")
        replies = {key: text for key, text in self._words.items() if key.endswith("_reply")}
        self._patterns = {key: re.compile(text.encode("latin-1"), re.DOTALL) for key, text in replies.items()}
        self._reads = "read" in self._words
        self._query_identity()

    def _send_level(self, channel: int, level: int) -> None:
        """Set the intensity, or darken by the template's own command."""
        verb = "off" if level == 0 and "off" in self._words else "set"
        self._retry.run(lambda: self._exchange(verb, channel, level))

    def _query_level(self, channel: int) -> int:
        return self._retry.run(lambda: self._read_once(channel))

    def _read_once(self, channel: int) -> int:
        digits = self._exchange("read", channel, 0)["level"]
        try:
            return int(digits)
        except ValueError:
            raise self._link.failure("the reply's level is no number", reply=digits, kind=ReplyError) from None

    def _exchange(self, verb: str, channel: int, level: int) -> dict[str, bytes]:
        """Send a command and match its reply; the pattern's groups."""
        letter = chr(ord("A") + channel - 1)
        text = self._words[verb].format(channel=channel, channel0=channel - 1, letter=letter, level=level)
        frame = text.encode("latin-1")
        pattern = self._patterns.get(f"{verb}_reply")
        if pattern is None:
            self._link.send(frame)
            return {}
        reply = self._link.query(frame, end=self._end or None)
        match = pattern.fullmatch(reply[: len(reply) - len(self._end)])
        if match is None:
            what = f"the reply does not match template.{verb}_reply"
            raise self._link.failure(what, sent=frame, reply=reply, kind=ReplyError)
        return match.groupdict()
