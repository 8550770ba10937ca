"""How a part lies on the stage: shifted by a millimetre, turned by a degree from where its file has it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lightopt.core.transforms import rotation_z
from lightopt.scene import Scene, move_part


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a part lies on the stage, from where rig and part file have it.

    Attributes
    ----------
    x, y
        Shift in the plane of the stage's plate, world axes at posture (0, 0) [mm].
    turn
        About the stage's own axis [rad].
    errors
        Standard errors of the three, in the same order; 0 where not known.
    observable
        Whether the images determine each of the three; what they do not is as in the part file. Where they leave a
        direction between two of them open, these have large errors.
    """

    x: float = 0.0
    y: float = 0.0
    turn: float = 0.0
    errors: tuple[float, float, float] = (0.0, 0.0, 0.0)
    observable: tuple[bool, bool, bool] = (True, True, True)

    def as_dict(self) -> dict[str, float | list[str]]:
        """JSON form."""
        names = ("x", "y", "turn")
        return {
            "observable": [name for name, seen in zip(names, self.observable, strict=True) if seen],
            "x_mm": float(f"{self.x:.6g}"),
            "y_mm": float(f"{self.y:.6g}"),
            "turn_deg": float(f"{math.degrees(self.turn):.6g}"),
            "x_error_mm": float(f"{self.errors[0]:.3g}"),
            "y_error_mm": float(f"{self.errors[1]:.3g}"),
            "turn_error_deg": float(f"{math.degrees(self.errors[2]):.3g}"),
        }


def place_part(scene: Scene, placement: Placement) -> Scene:
    """The scene with its part where it really lies."""
    turn = rotation_z(placement.turn)
    shift = scene.pivot - turn @ scene.pivot + np.array([placement.x, placement.y, 0.0])
    return move_part(scene, turn, shift)
