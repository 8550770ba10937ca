"""The command set of SIGMA KOKI / OptoSigma controllers: its words and its status line.

Sources: the docstrings that ``elerac/optosigma`` took from the GSC-01 and GSC-02 manuals, ``ken1row/PyOptoSigma``, and
``SigmaKokiPy``, which agree on what is used here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lightopt.core.errors import InputError
from lightopt.rig.devices._axes import Axis
from lightopt.rig.devices._dialogue import Reading
from lightopt.rig.devices._errors import printable

END = b"\r\n"
RAMP_MS = 200  # acceleration and deceleration; the controllers' own value at power-up

_POSITION = re.compile(r"\s*([+-]?)\s*(\d+)\s*")
_LIMITS = {"L": "axis 1", "M": "axis 2", "W": "both axes"}


@dataclass(frozen=True)
class Status:
    """The answer to ``Q:``.

    Attributes
    ----------
    positions
        Count of each axis [pulses].
    accepted
        Whether the last command was taken (ACK1).
    limit
        Which axis was stopped by its limit switch (ACK2), in words; None where none was.
    busy
        Whether an axis moves (ACK3).
    """

    positions: tuple[int, ...]
    accepted: bool
    limit: str | None
    busy: bool


def command(text: str) -> bytes:
    """A command on the wire."""
    return text.encode("ascii") + END


def signed(pulses: int) -> str:
    """A distance or position as the commands write it.

    Examples
    --------
    >>> signed(-2000)
    '-P2000'
    >>> signed(0)
    '+P0'
    """
    return f"{'-' if pulses < 0 else '+'}P{abs(pulses)}"


def axis_words(verb: str, values: Mapping[str, str]) -> str:
    """A command for one axis or for both, from the words of each.

    Examples
    --------
    >>> axis_words("A", {"1": "+P9000"})
    'A:1+P9000'
    >>> axis_words("A", {"2": "-P2000", "1": "+P1800"})
    'A:W+P1800-P2000'
    """
    if len(values) == 1:
        ((axis, value),) = values.items()
        return f"{verb}:{axis}{value}"
    return f"{verb}:W{values['1']}{values['2']}"


def parse_status(line: bytes) -> Status:
    r"""Read the answer to ``Q:``.

    Raises
    ------
    ValueError
        When it is not one; the message says why.

    Examples
    --------
    >>> parse_status(b"        100,-       20,K,K,R\r\n")
    Status(positions=(100, -20), accepted=True, limit=None, busy=False)
    """
    fields = line.decode("ascii", "replace").rstrip("\r\n").split(",")
    if len(fields) < 4:
        raise ValueError(f"expected positions and three letters, got {printable(line)}")
    *places, ack1, ack2, ack3 = fields
    positions: list[int] = []
    for place in places:
        # the sign may stand apart from the digits: "-    1000"
        match = _POSITION.fullmatch(place)
        if match is None:
            raise ValueError(f"expected a position, got {printable(place.encode('ascii', 'replace'))}")
        positions.append(int(match[1] + match[2]))
    if ack1 not in ("K", "X") or ack2 not in ("K", *_LIMITS) or ack3 not in ("B", "R"):
        raise ValueError(
            f"expected K or X, K L M or W, B or R, got {printable(','.join(fields[-3:]).encode())}"
        )
    return Status(positions=tuple(positions), accepted=ack1 == "K", limit=_LIMITS.get(ack2), busy=ack3 == "B")


def reading_of(status: Status, axes: Sequence[Axis]) -> Reading:
    """A status as a reading of the axes that the rig uses.

    Raises
    ------
    ValueError
        When the controller has fewer axes than that.
    """
    needed = max(int(axis.device) for axis in axes)
    if len(status.positions) < needed:
        raise ValueError(f"tells of {len(status.positions)} axes, and the rig uses axis {needed}")
    alarm = None
    if status.limit is not None and not status.busy:
        alarm = f"{status.limit} stopped at the limit switch"
    return Reading(
        units={axis.device: float(status.positions[int(axis.device) - 1]) for axis in axes},
        moving=status.busy,
        alarm=alarm,
    )


def check_axes(axes: Sequence[Axis], *, slowest: int, fastest: int) -> None:
    """Check the names of the axes and that the controller can be set to their speeds [pulses/s].

    Raises
    ------
    lightopt.core.errors.InputError
        For an axis other than 1 and 2, the same axis twice, or a speed that the command set cannot say.
    """
    wrong: list[str] = []
    for axis in axes:
        if axis.device not in ("1", "2"):
            wrong.append(f"stage axis {axis.name}: the controller's axes are 1 and 2, found {axis.device}")
        if not slowest <= round(axis.speed_units()) <= fastest:
            wrong.append(
                f"stage axis {axis.name}: {axis.speed_deg_per_s:g}°/s are {axis.speed_units():g} pulses/s; "
                f"the controller takes {slowest} to {fastest}"
            )
    if len({axis.device for axis in axes}) < len(axes):
        wrong.append("stage: elevation and rotation are the same axis of the controller")
    if wrong:
        raise InputError(*wrong)
