"""Plain scalars as YAML 1.2's core schema reads them (YAML 1.2.2, section 10.3.2).

PyYAML follows YAML 1.1, where `5e7` is text, `yes` is a boolean and `1:30` is ninety.
"""

from __future__ import annotations

import math
import re

_NULL = frozenset({"", "~", "null", "Null", "NULL"})
_TRUE = frozenset({"true", "True", "TRUE"})
_FALSE = frozenset({"false", "False", "FALSE"})
_INT = re.compile(r"[-+]?[0-9]+")
_OCTAL = re.compile(r"0o[0-7]+")
_HEX = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NON_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_LONGEST_INT = 300  # digits; beyond, an integer is not a double any more


class NotFiniteError(ValueError):
    """The scalar is NaN, an infinity, or a number too large for a double."""


def is_number(text: str) -> bool:
    """Whether the text, unquoted, would be a number."""
    return any(p.fullmatch(text) for p in (_INT, _OCTAL, _HEX, _FLOAT))


def plain_scalar(text: str) -> str | int | float | bool | None:
    """Value of an unquoted scalar.

    Raises NotFiniteError: For NaN, infinities and numbers beyond a double
    """
    if text in _NULL:
        return None
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _NON_FINITE.fullmatch(text):
        raise NotFiniteError(f"expected a finite number, found {text}")
    for pattern, base in ((_INT, 10), (_OCTAL, 8), (_HEX, 16)):
        if pattern.fullmatch(text):
            if len(text) > _LONGEST_INT:
                raise NotFiniteError(f"expected a finite number, found one of {len(text)} digits")
            return int(text if base == 10 else text[2:], base)
    if _FLOAT.fullmatch(text):
        value = float(text)
        if math.isinf(value):
            raise NotFiniteError(f"expected a finite number, found {text[:40]}, which is too large")
        return value
    return text
