"""Where the virtual bench differs from what the rig and part files say, for tests of what notices it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class BenchTruth:
    """The world behind the devices.

    seed: Of the noise.
    gains: Factor on the brightness of a light, by its name; 1 where none is given.
    part_offset_mm: How far from its place the part lies, world frame at posture (0, 0) [mm].
    dark_level: Added to the sensor's black level [sensor level].
    ambient_level: Light that is always there, everywhere in the image [grey level at exposure 1].
    triggered: Whether the camera's frames begin when asked for; otherwise they follow one another, and the first after
        a change began before it.
    """

    seed: int = 1
    gains: Mapping[str, float] = field(default_factory=dict[str, float])
    part_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    dark_level: float = 0.0
    ambient_level: float = 0.0
    triggered: bool = True

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return asdict(self)

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> BenchTruth:
        """From its JSON form."""
        x, y, z = data["part_offset_mm"]
        return cls(
            seed=data["seed"],
            gains=data["gains"],
            part_offset_mm=(x, y, z),
            dark_level=data["dark_level"],
            ambient_level=data["ambient_level"],
            triggered=data["triggered"],
        )
