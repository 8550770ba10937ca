"""The stage: how a part moves with the readings of its two axes, which need not be perpendicular nor meet."""

import math
from dataclasses import dataclass, field

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture, rotation_from_vector, rotation_x, rotation_z


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """A rotary axis, along Z at tilt 0, carried by a tilt axis; world frame.

    pivot: A point of the rotary axis at tilt 0 [mm], shape (3,)
    tilt_point: A point of the tilt axis [mm], shape (3,); None for `pivot`
    tilt_direction: Unit vector of the tilt axis, shape (3,); None for X
    tilt_scale, rotary_scale: Degrees turned per degree of the reading
    """

    pivot: Float64 = field(default_factory=lambda: np.zeros(3))
    tilt_point: Float64 | None = None
    tilt_direction: Float64 | None = None
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
