"""Asking again where that does no harm: a bounded number of times, each one counted."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from lightopt.hardware._errors import ReplyError
from lightopt.hardware._link import SerialLink

__all__ = ["TRIES", "ask"]

TRIES = 3

Value = TypeVar("Value")


def ask(link: SerialLink, question: Callable[[], Value]) -> Value:
    """Ask until there is an answer, at most `TRIES` times; only for what may be said twice.

    Each repetition is an event of the link. In between the line is left to fall silent, so that a late reply to one
    question is not taken for the answer to the next.

    Raises
    ------
    ReplyError
        When no attempt was answered; the last one's.
    """
    for attempt in range(1, TRIES):
        try:
            return question()
        except ReplyError as error:  # noqa: PERF203  (a serial line is slower)
            link.note(f"{error}; asked again ({attempt + 1} of {TRIES})", retry=True)
            link.drain()
    return question()
