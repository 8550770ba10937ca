"""What the virtual bench's camera looks at: files, wiring, and where the bench differs from them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

CAMERA = "camera"  # name of a GigE camera among the devices of a bench
EXPOSURE_RANGE_US = (10.0, 10e6)
"""Shortest and longest exposure time of the virtual camera [µs]; it holds whole microseconds."""


@dataclass(frozen=True, kw_only=True)
class BenchTruth:
    """Where the bench differs from the files: the ground truth of tests."""

    seed: int = 1  # of the noise, and of the waviness of the surface
    gains: Mapping[str, float] = field(default_factory=dict[str, float])  # factors on the lights by name
    part_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from its place, at posture (0, 0) [mm]
    part_rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rotation vector about the origin before that [rad]
    dark_level: float = 0.0  # added to the sensor's black level [sensor level]
    ambient_level: float = 0.0  # light that is always there, everywhere in the image [grey level at exposure 1]
    # whether frames begin on request; otherwise they follow one another, and the first after a change began before it
    triggered: bool = True
    rays: int = 1  # along each side of a pixel, which shows their mean, as a real camera's does; 1: its centre


@dataclass(frozen=True, kw_only=True)
class LightWire:
    """Where a light is plugged in, and the share of the highest intensity at which it is as the rig describes."""

    light: str
    device: str
    channel: int
    share: float


@dataclass(frozen=True, kw_only=True)
class AxisWire:
    """Which axis of a device is the tilt or the rotation, its units per degree, and where 0° is."""

    device: str
    axis: str
    steps_per_deg: float
    zero: float

    def angle_deg(self, positions: Mapping[str, float]) -> float:
        return (positions[self.axis] - self.zero) / self.steps_per_deg


@dataclass(frozen=True, kw_only=True)
class CameraSetup:
    """What the camera looks at: files of rig and part, the wiring of lights and axes, and where the bench differs."""

    rig: str
    part: str
    exposure_us: float  # exposure time of exposure 1 [µs]
    lights: tuple[LightWire, ...]
    elevation: AxisWire | None = None  # None: fixed at 0
    rotation: AxisWire | None = None  # None: fixed at 0
    truth: BenchTruth = field(default_factory=BenchTruth)
    gige: bool = False  # whether it is a GigE Vision camera on the loopback

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> "CameraSetup":
        parts: dict[str, Any] = {
            "lights": tuple(LightWire(**wire) for wire in data["lights"]),
            "truth": BenchTruth(**data["truth"]),
        }
        for name in ("elevation", "rotation"):
            if data.get(name) is not None:
                parts[name] = AxisWire(**data[name])
        return cls(**{**data, **parts})
