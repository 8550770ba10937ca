"""The words for exceptions."""

from __future__ import annotations

import pytest

from lightopt.core.errors import HardwareError, LightoptError, error_text


class RaisesError(Exception):
    """One whose text raises what it is given."""

    def __str__(self):
        raise self.args[0]


class WrongKindError(Exception):
    """One whose text is none."""

    def __str__(self):
        return b"no text"  # noqa: PLE0307


class OwnMessageError(LightoptError):
    """A driver's own, with a message that is no text."""

    def __init__(self):
        super().__init__(5)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (HardwareError("light1: no answer", "all lights are off"), "light1: no answer\nall lights are off"),
        (HardwareError(), "HardwareError"),
        (ValueError("no digit"), "ValueError: no digit"),
        (OSError(5, "Input/output error"), "OSError: [Errno 5] Input/output error"),
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (ValueError(" \n"), "ValueError"),
        (RaisesError(RuntimeError("no words")), "RaisesError"),
        (RaisesError(SystemExit(1)), "RaisesError"),
        (RaisesError(RecursionError()), "RaisesError"),
        (WrongKindError(), "WrongKindError"),
        (OwnMessageError(), "OwnMessageError"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_any_exception_has_words(error, text):
    assert error_text(error) == text
