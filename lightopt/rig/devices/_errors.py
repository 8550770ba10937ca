"""The ways in which a dialogue with a device fails: a lost or broken reply, a refusal, a device that is gone."""

from __future__ import annotations

from lightopt.core.errors import HardwareError


class ReplyError(HardwareError):
    """A reply did not come, came in part, or cannot be what was asked for; asking again may help."""


class RefusedError(HardwareError):
    """The device heard the command and said no. Asking again cannot help."""


class PreemptedError(HardwareError):
    """A dialogue was broken off, because something that cannot wait needed the wire."""


class LinkLostError(HardwareError):
    """The device is gone: unplugged, switched off, or its connection closed. Asking again cannot help."""


def printable(data: bytes) -> str:
    r"""Bytes for people: text as it is, everything else as an escape.

    Examples
    --------
    >>> printable(b"@00F25582\r\n")
    '"@00F25582\\r\\n"'
    >>> printable(b"")
    'nothing'
    """
    if not data:
        return "nothing"
    text = "".join(chr(b) if 32 <= b < 127 and b != 92 else repr(bytes([b]))[2:-1] for b in data)
    return f'"{text}"'
