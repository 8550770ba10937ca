"""What devices of all roles have in common: identity, events, how a dialogue fails, and commands that are sent again.

A driver *has* a link and never *is* one, so that two drivers can be tested on one wire, and a wire replaced without a
driver noticing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Any, TypeVar

from lightopt.core.errors import HardwareError

ATTEMPTS = 3
Value = TypeVar("Value")


@dataclass(frozen=True)
class Event:
    """An irregularity on a link, at a time (UTC, ISO 8601); `retry`: a command was sent again."""

    time: str
    port: str
    what: str
    retry: bool = False


def now() -> str:
    """Now, UTC, ISO 8601 with microseconds."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%S.%fZ")


class ReplyError(HardwareError):
    """A reply is missing, incomplete or to something else; sending the command again may help."""


class RefusedError(HardwareError):
    """The device received the command and refused it. Sending it again cannot help."""


class PreemptedError(HardwareError):
    """A dialogue was broken off, because something that cannot wait needed the wire."""


class LinkLostError(HardwareError):
    """The device is gone: unplugged, switched off, or its connection closed. Sending it again cannot help."""


def printable(data: bytes) -> str:
    r"""Bytes as messages show them: text as it is, everything else as an escape.

    >>> printable(b"@00F25582\r\n")
    '"@00F25582\\r\\n"'
    >>> printable(b"")
    'nothing'
    """
    if not data:
        return "nothing"
    text = "".join(chr(b) if 32 <= b < 127 and b != 92 else repr(bytes([b]))[2:-1] for b in data)
    return f'"{text}"'


class Retry:
    """Sends again when a reply is lost or spoilt; only for what may be repeated: queries, levels, absolute targets.

    A device that left all attempts unanswered gets one at a time until it answers: switching off the lights of a dead
    controller must not take a minute. `link` is a serial link or a camera: it can drain what is on its way, and note.
    """

    def __init__(self, link: Any, *, verb: str = "sent") -> None:
        self._link = link
        self._attempts = ATTEMPTS
        self._verb = verb

    def run(self, exchange: Callable[[], Value]) -> Value:
        """Call `exchange` until it returns, or raise its last :class:`ReplyError`; other errors are raised at once."""
        attempt = 1
        while True:
            try:
                answer = exchange()
            except ReplyError as error:  # noqa: PERF203
                if attempt >= self._attempts:
                    self._attempts = 1
                    raise ReplyError(f"{error} ({self._verb} {attempt} times)") if attempt > 1 else error from None
                self._link.drain()  # a late reply must not be taken for the reply to the repeated command
                self._link.note(f"{self._verb} again ({attempt} of {self._attempts - 1}) after: {error}", retry=True)
                attempt += 1
            else:
                self._attempts = ATTEMPTS
                return answer


def frame_limit_s(exposure_us: float, wait_s: float) -> float:
    """How long a camera may take for one frame [s]: every attempt exposes again, and the waits share `wait_s`.

    >>> frame_limit_s(2e6, 5.0)
    11.0
    """
    return ATTEMPTS * exposure_us / 1e6 + wait_s
