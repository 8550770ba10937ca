"""The camera's role, and the identity of a device of any role.

Light controllers derive from :class:`~lightopt.rig.devices.LightController` (``_light.py``), stages are a
:class:`~lightopt.rig.devices.Stage` (``_stage.py``). A driver *has* a serial link and never *is* one, so that two
drivers can be tested on one wire, and a wire replaced without a driver noticing.
"""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import UInt8


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

    triggered: Whether a frame begins at the call of `grab` (software trigger), so that none need be thrown away.
    resolution_px: Width and height of the frames [pixels].
    bit_depth: Bits of a level.
    exposure_range_us: Shortest and longest exposure time [µs].
    set_exposure: Set the exposure time [µs] and return what the camera holds. InputError outside `exposure_range_us`;
        nothing was sent then.
    grab: Take one frame; a camera without a trigger delivers the next that it completes. All attempts together take
        `timeout_s` at most.
    close: Stop and give up the camera; never raises.
    """

    @property
    def triggered(self) -> bool: ...
    @property
    def resolution_px(self) -> tuple[int, int]: ...
    @property
    def bit_depth(self) -> int: ...
    @property
    def exposure_range_us(self) -> tuple[float, float]: ...
    def identify(self) -> Identity: ...
    def set_exposure(self, exposure_us: float) -> float: ...
    def grab(self, *, timeout_s: float) -> Frame: ...
    def close(self) -> None: ...
