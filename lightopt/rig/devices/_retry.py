"""Commands sent again: only such as may be repeated, a bounded number of times, each reported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeVar

from lightopt.rig.devices._errors import ReplyError

ATTEMPTS = 3

Value = TypeVar("Value")


class Repeatable(Protocol):
    """What can be asked again: a serial link, a camera."""

    def drain(self) -> None:
        """Throw away what is still on its way, so that it is not taken for the answer to the next question."""
        ...

    def note(self, what: str, *, retry: bool = False) -> None:
        """Report something out of the ordinary."""
        ...


class Retry:
    """Asks again when a reply is lost or spoilt. Only for what may be repeated: queries, intensities, absolute targets.

    A device that left all attempts unanswered gets one at a time until it answers: switching off the lights of a dead
    controller must not take a minute.
    """

    def __init__(self, link: Repeatable, attempts: int = ATTEMPTS, *, verb: str = "sent") -> None:
        self._link = link
        self._most = attempts
        self._attempts = attempts
        self._verb = verb

    def ask(self, question: Callable[[], Value]) -> Value:
        """Call `question` until it returns, or raise its last :class:`ReplyError`; other errors are raised at once."""
        attempt = 1
        while (outcome := self._try(question, attempt)) is None:
            attempt += 1
        self._attempts = self._most
        return outcome[0]

    def _try(self, question: Callable[[], Value], attempt: int) -> tuple[Value] | None:
        try:
            return (question(),)
        except ReplyError as error:
            if attempt >= self._attempts:
                self._attempts = 1
                raise self._exhausted(error, attempt) from None
            # A late reply must not be taken for the reply to the repeated command.
            self._link.drain()
            self._link.note(
                f"{self._verb} again ({attempt} of {self._attempts - 1}) after: {error}", retry=True
            )
            return None

    def _exhausted(self, error: ReplyError, attempts: int) -> ReplyError:
        return ReplyError(f"{error} ({self._verb} {attempts} times)") if attempts > 1 else error


def frame_limit_s(exposure_us: float, wait_s: float) -> float:
    """How long a camera may take for one frame [s]: every attempt exposes anew, and the waits share `wait_s`.

    exposure_us: Exposure time that the camera holds [µs].
    wait_s: Longest wait beyond the exposures [s].

    Examples
    --------
    >>> frame_limit_s(2e6, 5.0)
    11.0
    """
    return ATTEMPTS * exposure_us / 1e6 + wait_s
