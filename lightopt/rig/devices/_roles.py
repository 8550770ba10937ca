"""The three roles that devices play: a light controller, a stage, a camera.

A driver plays one role. It *has* a serial link and never *is* one, so that two drivers may be tested against the same
wire and a wire replaced without a driver noticing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import UInt8
from lightopt.core.transforms import Posture


@dataclass(frozen=True)
class Identity:
    """Identity of a device.

    driver: Name of the driver, as in the rig file.
    port: Where it is reached: serial port, URL, camera name or folder.
    details: What the device answered about itself (version, serial number), by name; may be empty.
    """

    driver: str
    port: str
    details: dict[str, str] = field(default_factory=dict[str, str])

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {"driver": self.driver, "port": self.port, **self.details}


class LightController(Protocol):
    """Panels behind one controller; channels are counted from 1, as printed on the device.

    Every method raises :class:`~lightopt.core.errors.HardwareError` when the device does not answer, answers no, or
    does not hold what was set.
    """

    @property
    def channels(self) -> int:
        """Number of channels."""
        ...

    @property
    def top_level(self) -> int:
        """Highest intensity."""
        ...

    def identify(self) -> Identity:
        """Ask the device who it is, without changing a light."""
        ...

    def set_level(self, channel: int, level: int) -> int | None:
        """Light a channel at an intensity in 1 … top_level, or darken it with 0.

        Returns the intensity that the device then holds, read back; None where it cannot be read back.
        """
        ...

    @property
    def level_set_s(self) -> float:
        """When [s, monotonic clock] the device had the last intensity; before it was read back."""
        ...

    def read_level(self, channel: int) -> int | None:
        """Intensity that the device holds, 0 when it is off; None where it cannot be read back."""
        ...

    def close(self) -> None:
        """Give up the link; never changes a light, never raises."""
        ...


@dataclass(frozen=True)
class StageState:
    """State of a stage.

    posture: Where it stands [°]; an axis that the stage lacks stands at 0.
    referenced: Whether it knows where its origin is; None where that is unknown.
    alarm: The device's alarm in words; None without one.
    """

    posture: Posture
    moving: bool
    referenced: bool | None
    alarm: str | None = None


class Stage(Protocol):
    """The tilt and rotation axes that hold the part.

    Every method raises :class:`~lightopt.core.errors.HardwareError` as the light controller's do; alarms are reported
    and never cleared by the driver.
    """

    def identify(self) -> Identity:
        """Ask the device who it is, without moving it."""
        ...

    def state(self) -> StageState:
        """Ask where it stands and how it is."""
        ...

    def home(self) -> None:
        """Seek the mechanical origin of all axes and wait for it."""
        ...

    def move_to(self, posture: Posture) -> StageState:
        """Move, wait, and verify; returns where it stands.

        Raises InputError when the posture lies outside the limits or between steps by more than half of one; nothing
        was sent.
        Raises HardwareError when it cannot get there; it is then stopped.
        """
        ...

    def confirm(self) -> StageState:
        """Ask whether it still stands where it was left; moves nothing.

        Raises HardwareError when it stands elsewhere, moves, or has an alarm or lost its origin.
        """
        ...

    def stop(self) -> None:
        """Stop all axes at once."""
        ...

    def close(self) -> None:
        """Give up the link; never moves an axis, never raises."""
        ...


@dataclass(frozen=True)
class Frame:
    """A frame as the camera delivered it.

    levels: Right-aligned sensor levels (H, W), uint8 up to 8 bits and uint16 above.
    exposure_us: Exposure time [µs] as read back for this frame.
    number, timestamp_ns: The camera's own number and time stamp [ns]; None where it has none.
    details: Further properties (gain, temperature, packets lost).
    """

    levels: UInt8 | NDArray[np.uint16]
    exposure_us: float
    number: int | None
    timestamp_ns: int | None = None
    details: dict[str, Any] = field(default_factory=dict[str, Any])


class Camera(Protocol):
    """A monochrome camera.

    Every method raises :class:`~lightopt.core.errors.HardwareError` when the camera does not deliver.
    """

    @property
    def triggered(self) -> bool:
        """Whether a frame begins at the call of `grab` (software trigger), so that none need be thrown away."""
        ...

    @property
    def resolution_px(self) -> tuple[int, int]:
        """Width and height [pixels] of the frames."""
        ...

    @property
    def bit_depth(self) -> int:
        """Bits of a level."""
        ...

    @property
    def exposure_range_us(self) -> tuple[float, float]:
        """Shortest and longest exposure time [µs]."""
        ...

    def identify(self) -> Identity:
        """Ask the camera who it is."""
        ...

    def set_exposure(self, exposure_us: float) -> float:
        """Set the exposure time [µs] and return what the camera holds.

        Raises InputError when it lies outside `exposure_range_us`; nothing was sent.
        """
        ...

    def grab(self, *, timeout_s: float) -> Frame:
        """Take one frame; a camera without a trigger delivers the next that it completes.

        It takes `timeout_s` at most, all attempts of a camera that asks again together.
        """
        ...

    def close(self) -> None:
        """Stop and give up the camera; never raises."""
        ...
