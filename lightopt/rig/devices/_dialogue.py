"""What the language of a stage must be able to say, and what it hears: device units, axes by the device's names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from lightopt.rig.devices._axes import Axis
from lightopt.rig.devices._link import SerialLink


@dataclass(frozen=True)
class Reading:
    """What a device says of itself at one moment.

    Attributes
    ----------
    units
        Position of each axis by the device's name of it [device units].
    moving
        Whether any axis moves.
    referenced
        Whether it knows its origin; None where it cannot tell.
    alarm
        The alarm in words; None without one.
    """

    units: Mapping[str, float]
    moving: bool
    referenced: bool | None = None
    alarm: str | None = None


class Dialogue(Protocol):
    """What a stage's language must say; one class per protocol. Positions are in device units, axes by device name.

    Each method raises :class:`~lightopt.core.errors.HardwareError` when the device answers no, or not at all.
    """

    @property
    def link(self) -> SerialLink:
        """The wire."""
        ...

    @property
    def homes_to_end(self) -> bool:
        """Whether :meth:`home` returns when the origins are found, rather than when the search has begun."""
        ...

    def says(self) -> dict[str, str]:
        """What the device answers when asked who it is."""
        ...

    def read(self) -> Reading:
        """Ask where it stands and how it is; may be asked again."""
        ...

    def step(self, axis: Axis) -> float:
        """Smallest distance [device units] between two positions of an axis."""
        ...

    def check(self, targets: Mapping[str, float]) -> None:
        """Raise an InputError for targets that the device is known to refuse; sends nothing that moves."""
        ...

    def prepare(self) -> None:
        """Set speeds; once, before the first move."""
        ...

    def go(self, targets: Mapping[str, float]) -> None:
        """Start a move; never sent twice. A ReplyError says that it is unknown whether it was taken."""
        ...

    def home(self) -> None:
        """Start to seek the origins, or seek them to the end, as the protocol has it; never sent twice."""
        ...

    def homed(self, reading: Reading) -> str | None:
        """What is wrong with a reading after homing; None when all is well."""
        ...

    def halt(self) -> None:
        """Stop all axes at once."""
        ...
