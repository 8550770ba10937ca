"""What the driver of a stage implements (:class:`Dialogue`), and its axes: angles of the rig, units of the device."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from lightopt.core.errors import refuse
from lightopt.rig.devices._device import Retry
from lightopt.rig.devices._serial_link import SerialLink

_ROUNDING = 1e-9  # relative; angles that differ by less are the same


def describe_range(range_deg: tuple[float, float]) -> str:
    """A range as messages show it: ``-45° … 45°``."""
    return f"{range_deg[0]:g}° … {range_deg[1]:g}°"


@dataclass(frozen=True)
class Axis:
    """An axis of the stage: how the rig's angle becomes the device's count, and how far and fast it may go."""

    name: str  # elevation or rotation
    device: str  # the axis as the device calls it
    range_deg: tuple[float, float]  # lowest and highest allowed angle [°]
    steps_per_deg: float = 1.0  # device units per degree; negative where the device counts against the rig's sense
    zero: float = 0.0  # device units at which the rig's angle is 0
    speed_deg_per_s: float = 20.0
    home_sense: int = -1  # sense of the count in which the GSC-02 seeks its origin, +1 or -1

    def angle_of(self, units: float) -> float:
        """The rig's angle [°] at a position of the device."""
        return (units - self.zero) / self.steps_per_deg + 0.0  # never -0

    def units_of(self, angle_deg: float) -> float:
        """The device's position at an angle [°] of the rig, not rounded."""
        return self.zero + angle_deg * self.steps_per_deg

    def target(self, angle_deg: float, *, step: float) -> float:
        """Nearest multiple of a `step` [device units] to an angle [°]; an InputError for one outside the range."""
        refuse(self.problems(angle_deg))
        return step * round(self.units_of(angle_deg) / step)

    def problems(self, angle_deg: float) -> list[str]:
        """Messages about what is wrong with an angle [°]; empty where it is allowed."""
        low, high = self.range_deg
        slack = _ROUNDING * max(1.0, abs(low), abs(high))
        if low - slack <= angle_deg <= high + slack:
            return []
        span = describe_range(self.range_deg)
        return [f"stage axis {self.name}: {angle_deg:g}° lies outside the rig's range {span}; nothing was moved"]

    def speed_units(self) -> float:
        return self.speed_deg_per_s * abs(self.steps_per_deg)


@dataclass(frozen=True)
class Reading:
    """State of a stage's device at one moment."""

    units: Mapping[str, float]  # position of each axis by the device's name of it [device units]
    moving: bool
    referenced: bool | None = None  # whether it knows its origin; None where that is unknown
    alarm: str | None = None  # message about the alarm


class Dialogue(ABC):
    """Protocol of a stage, in the device's units and names; HardwareError where it refuses or does not answer."""

    BAUD: ClassVar[int]  # the protocol's usual baud rate
    RTSCTS: ClassVar[bool] = False  # whether the device paces the line by RTS/CTS
    HOMES_TO_END: ClassVar[bool] = False
    """Whether `home` returns when the origins are found, rather than when the search has begun."""

    def __init__(self, link: SerialLink, axes: Sequence[Axis], *, home_timeout_s: float = 180.0) -> None:
        self.link = link
        self._retry = Retry(link)
        self._axes = tuple(axes)
        self.home_timeout_s = home_timeout_s

    @classmethod  # noqa: B027  (some devices tell their speeds only when they are open)
    def check_axes(cls, axes: Sequence[Axis]) -> None:
        """Refuse speeds, and axes together, that the device cannot have, as far as is known without it (InputError)."""

    @abstractmethod
    def identify(self) -> dict[str, str]:
        """What the device reports about itself."""

    @abstractmethod
    def read(self) -> Reading:
        """Query positions and state; may be repeated."""

    def step(self, axis: Axis) -> float:  # noqa: ARG002  (a device that counts in steps)
        """Smallest distance [device units] between two positions of an axis."""
        return 1.0

    def check(self, targets: Mapping[str, float]) -> None:  # noqa: B027  (not all devices have limits)
        """Raise an InputError for targets that the device is known to refuse; sends nothing that moves."""

    def prepare(self) -> None:  # noqa: B027  (not all devices keep speeds)
        """Set speeds; once, before the first move. Nothing where each move carries its speed."""

    @abstractmethod
    def go(self, targets: Mapping[str, float]) -> None:
        """Start a move; never sent twice. A ReplyError means that it is unknown whether the device took it."""

    @abstractmethod
    def home(self) -> None:
        """Start to seek the origins, or seek them to the end, as the protocol has it; never sent twice."""

    def homed(self, reading: Reading) -> str | None:
        """What is wrong with a reading after homing; None when all is well."""
        return reading.alarm

    @abstractmethod
    def halt(self) -> None:
        """Stop all axes at once."""
