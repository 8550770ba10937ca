"""Commands and patterns of replies that a rig file spells out, checked before they are ever sent."""

from __future__ import annotations

import re
import string
from typing import Annotated

from pydantic import AfterValidator, StringConstraints

from lightopt.config._fields import complaint, expecting

FIELDS = ("channel", "channel0", "letter", "level")
_WIDTH = re.compile(r"(0?[1-9]\d?)?d?")


def _bytes(text: str) -> str:
    wide = next((c for c in text if ord(c) > 255), None)
    if wide is not None:
        raise complaint(f'"{wide}" is no single byte; expected characters up to \\xff')
    return text


def _escaped(text: str) -> str:
    found = re.search(r"\\(?:[rnt0]|x[0-9a-fA-F]{2})", text)
    if found is not None:
        raise complaint(
            f"the characters {found[0]} would be sent as they stand; for the byte that they mean put the text in "
            "double quotes"
        )
    return text


def _filled_in(text: str) -> str:
    try:
        pieces = list(string.Formatter().parse(text))
    except ValueError as error:
        raise complaint(f"not a template: {error}; a brace that is meant is written twice") from None
    for _, name, form, conversion in pieces:
        if name is None:
            continue
        if name not in FIELDS or conversion:
            raise complaint(
                f"no field {{{name}}}; there are {', '.join(f'{{{f}}}' for f in FIELDS)}; a brace that is meant is "
                "written twice"
            )
        if _WIDTH.fullmatch(form or "") is None or (form and name == "letter"):
            raise complaint(f"{{{name}:{form}}}: expected a width such as {{level:03d}}, or none")
    return text


def needs_level(text: str) -> str:
    """Refuse a command to set an intensity that lacks the intensity."""
    if not any(name == "level" for _, name, _, _ in string.Formatter().parse(text)):
        raise complaint("the field {level} is missing: the command would set no intensity")
    return text


def _compiled(text: str) -> str:
    try:
        re.compile(text.encode("latin-1"))
    except re.error as error:
        raise complaint(f"not a regular expression: {error}") from None
    return text


def wrong_pair(read: str | None, reply: str | None) -> None:
    """Refuse a `read` without a reply that has the intensity, and a reply without a `read`."""
    if read is None and reply is not None:
        raise complaint("there is no `read` that it could answer; add it, or leave this out")
    if read is None:
        return
    if reply is None or "level" not in re.compile(reply.encode("latin-1")).groupindex:
        raise complaint("expected a regular expression with a group (?P<level>...) for the intensity")


_LINE = Annotated[str, StringConstraints(min_length=1, max_length=200), AfterValidator(_bytes)]

Command = Annotated[
    _LINE, AfterValidator(_escaped), AfterValidator(_filled_in), expecting("the text of a command")
]
Pattern = Annotated[_LINE, AfterValidator(_compiled), expecting("a regular expression")]
End = Annotated[_LINE, AfterValidator(_escaped), expecting("the bytes that end a reply")]
