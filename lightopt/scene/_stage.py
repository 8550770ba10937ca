"""The stage: how its two axes move a part, and the order of postures in which it travels least."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from lightopt.config import RigConfig, StageDeviceConfig
from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture, rotation_from_vector, rotation_x, rotation_z


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """A rotary axis, along Z at tilt 0, carried by a tilt axis; world frame."""

    pivot: Float64 = field(default_factory=lambda: np.zeros(3))  # a point of the rotary axis at tilt 0 [mm], shape (3,)
    tilt_point: Float64 | None = None  # a point of the tilt axis [mm], shape (3,); None for `pivot`
    tilt_direction: Float64 | None = None  # unit vector of the tilt axis, shape (3,); None for X
    # degrees turned per degree of the reading
    tilt_scale: float = 1.0
    rotary_scale: float = 1.0

    @property
    def tilt_axis(self) -> tuple[Float64, Float64]:
        """A point [mm] and the direction of the tilt axis, each of shape (3,)."""
        direction = np.array([1.0, 0.0, 0.0]) if self.tilt_direction is None else self.tilt_direction
        return self.pivot if self.tilt_point is None else self.tilt_point, direction

    def transform(self, posture: Posture) -> tuple[Float64, Float64]:
        """Part frame to world frame at a posture: x_world = R·x_part + t, of shapes (3, 3) and (3,) [mm]."""
        angle = self.tilt_scale * math.radians(posture.elevation_deg)
        tilt = rotation_x(angle) if self.tilt_direction is None else rotation_from_vector(angle * self.tilt_direction)
        turn = rotation_z(self.rotary_scale * math.radians(posture.rotation_deg))
        rotation = tilt @ turn
        if self.tilt_point is None:
            return rotation, self.pivot - rotation @ self.pivot
        return rotation, self.tilt_point + tilt @ (self.pivot - turn @ self.pivot - self.tilt_point)


VIRTUAL_DEG_PER_S = 90.0
"""Speed of both axes of the virtual bench's stage, which stands in for one that the rig's file does not name [°/s]."""

_EXACT_UP_TO = 7

Time = Callable[[Posture, Posture], float]


def travel_order(postures: Sequence[Posture], *, start: Posture, time: Time) -> tuple[Posture, ...]:
    """Postures in an order that takes the stage little time: the least for up to 7, else a good one.

    postures: In the order that counts where times are equal
    time: Of the move between two postures [s]
    """
    if len(postures) <= _EXACT_UP_TO:
        # ties go to the first permutation, the one nearest to the order given; rounding must not break them
        return min(permutations(postures), key=lambda order: round(_total(order, start, time), 6))
    left, order, here = list(postures), [], start
    while left:
        here = min(left, key=lambda posture: time(here, posture))
        left.remove(here)
        order.append(here)
    return _improved(order, start, time)


def travel_s(stage: StageDeviceConfig | None, start: Posture, end: Posture) -> float:
    """Seconds that a stage, the virtual bench's if None, takes between two postures, both axes at a time."""
    tilt, turn = end.elevation_deg - start.elevation_deg, end.rotation_deg - start.rotation_deg
    if stage is None:
        return max(abs(tilt), abs(turn)) / VIRTUAL_DEG_PER_S
    ways = ((stage.elevation, tilt), (stage.rotation, turn))
    return max((abs(way) / axis.speed_deg_per_s for axis, way in ways if axis is not None), default=0.0)


def pace_text(rig: RigConfig) -> str:
    """How fast the stage of a rig goes by :func:`travel_s`, and who says so."""
    if rig.hardware is None:
        return f"at {VIRTUAL_DEG_PER_S:g}°/s of the virtual bench, since the rig has no hardware section"
    stage = rig.hardware.stage
    if stage is None:
        return "the rig's hardware has no stage"
    axes = (("tilt", stage.elevation), ("rotation", stage.rotation))
    speeds = {name: axis.speed_deg_per_s for name, axis in axes if axis is not None}
    if len(set(speeds.values())) == 1:
        speed_text = f"{next(iter(speeds.values())):g}°/s"
    else:
        speed_text = ", ".join(f"{speed:g}°/s in {name}" for name, speed in speeds.items())
    return f"at {speed_text}, the speed_deg_per_s of the rig's hardware.stage"


def _total(order: Sequence[Posture], start: Posture, time: Time) -> float:
    return sum(time(a, b) for a, b in zip((start, *order), order, strict=False))


def _improved(order: list[Posture], start: Posture, time: Time) -> tuple[Posture, ...]:
    """Reverse stretches while that shortens the way (2-opt)."""
    best, better = _total(order, start, time), True
    while better:
        better = False
        for i in range(len(order) - 1):
            for j in range(i + 2, len(order) + 1):
                turned = order[:i] + order[i:j][::-1] + order[j:]
                total = _total(turned, start, time)
                if total < best - 1e-9:
                    order, best, better = turned, total, True
    return tuple(order)
