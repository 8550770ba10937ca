"""The one tree of errors, and the words and numbers of their messages.

Library code raises them; only :mod:`lightopt.cli` turns them into messages and an exit status.
"""

from collections.abc import Generator, Iterable
from contextlib import contextmanager
from difflib import get_close_matches

_NOISE = 1e-9  # shares that differ by less are the same


def counted(number: int, noun: str) -> str:
    """A number of things, in words that agree.

    Examples
    --------
    >>> counted(1, "image"), counted(2419, "image")
    ('1 image', '2,419 images')
    """
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def percent(share: float, digits: int = 1, *, short_of: float = 1.0) -> str:
    """A share in hundredths, to so many decimals; to more where it would else be rounded up to what it is short of.

    short_of: What a lower share must not be mistaken for, such as a target; no other below 1 is mistaken for all

    Examples
    --------
    >>> percent(0.9217), percent(1.0, 0), percent(0.9997), percent(-1e-9)
    ('92.2 %', '100 %', '99.97 %', '0.0 %')
    >>> percent(0.94996, short_of=0.95), percent(0.9997, short_of=0.95)
    ('94.996 %', '99.97 %')
    """
    most = digits
    limit = short_of if short_of - share > _NOISE else 1.0
    if limit - share > _NOISE:
        while most < digits + 6 and float(f"{100.0 * share:.{most}f}") >= 100.0 * limit - _NOISE:
            most += 1
    return f"{round(100.0 * share, most) + 0.0:.{most}f} %"  # no share is −0


def did_you_mean(word: str, words: Iterable[str], cutoff: float = 0.6) -> str:
    """End of a message about an unknown word: the known one that is most alike; empty where none is.

    Examples
    --------
    >>> did_you_mean("rihgt", ["left", "right"])
    '; did you mean "right"?'
    """
    near = get_close_matches(word, list(words), n=1, cutoff=cutoff)
    return f'; did you mean "{near[0]}"?' if near else ""


class LightoptError(Exception):
    """Base of all errors that lightopt raises on purpose.

    *messages: One or more messages for the user: what is wrong and where (file, line, key), what was
        expected, what was found, what to do. Each is shown on a line of its own.
    """

    exit_status = 2

    def __init__(self, *messages: str) -> None:
        super().__init__(*messages)
        self.messages: tuple[str, ...] = messages

    def __str__(self) -> str:
        return "\n".join(self.messages)


def error_text(error: BaseException) -> str:
    """The words for any exception: the messages of one of ours, else its kind and text.

    It never raises. Devices are driven by code of others, and an exception that cannot be turned into text must not
    keep a lamp lit: then it is the kind alone, as it is where there is no text.

    Examples
    --------
    >>> error_text(LightoptError("light1: no answer")), error_text(ValueError("no digit")), error_text(ValueError())
    ('light1: no answer', 'ValueError: no digit', 'ValueError')
    """
    kind = type(error).__name__
    try:
        text = str(error)
    except BaseException:  # noqa: BLE001  (whatever its text raises, `error` is what has to be dealt with)
        return kind
    if isinstance(error, LightoptError):
        return text or kind
    return f"{kind}: {text}" if text.strip() else kind


class InputError(LightoptError):
    """The user's input (a file, an option, a folder) is wrong. Exit status 2."""


def refuse(problems: Iterable[str]) -> None:
    """Raise an :class:`InputError` with all problems, where there are any."""
    if messages := tuple(problems):
        raise InputError(*messages)


@contextmanager
def collected(problems: list[str], *, where: str = "") -> Generator[None]:
    """Collect the messages of an input error, each after its place, instead of raising it."""
    try:
        yield
    except InputError as error:
        problems += [f"{where}: {message}" if where else message for message in error.messages]


class CheckFailed(LightoptError):  # noqa: N818  (the check failed, not the program)
    """A check failed (a difference, a missing golden). Exit status 1."""

    exit_status = 1


class HardwareError(LightoptError):
    """A device failed or did not answer. Exit status 3."""

    exit_status = 3


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or a signal ended the work, in the state that the messages describe. Exit status 130."""

    def __init__(self, *messages: str) -> None:
        super().__init__(*messages)
        self.messages: tuple[str, ...] = messages
