"""The placement of a part on the stage relative to its part file, and as the part file's own values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import rotation_z
from lightopt.scene import Scene, move_part


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a part lies on the stage, from where rig and part file have it.

    x, y: Shift in the plane of the stage's plate, world axes at posture (0, 0) [mm].
    turn: About the stage's own axis [rad].
    errors: Standard errors of the three, in the same order; 0 where not known.
    observable: Whether the images determine each of the three; what they do not is as in the part file. Where they
        leave a direction between two of them open, these have large errors.
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
    """Move the part of a scene to its placement."""
    turn = rotation_z(placement.turn)
    shift = scene.pivot - turn @ scene.pivot + np.array([placement.x, placement.y, 0.0])
    return move_part(scene, turn, shift)


@dataclass(frozen=True)
class PartFilePlacement:
    """Values of ``placement`` in a part file that put the part at its measured placement.

    rotate_deg: About the fixed X, then Y, then Z axis, before the anchor [°].
    translate_mm: After the anchor [mm].
    """

    rotate_deg: tuple[float, float, float]
    translate_mm: tuple[float, float, float]


def part_file_placement(
    vertices: NDArray[np.float64],
    placement: Placement,
    *,
    anchor: Literal["as_modelled", "rest_on_table", "centred"],
    rotate_deg: tuple[float, float, float],
    translate_mm: tuple[float, float, float],
    pivot: NDArray[np.float64],
) -> PartFilePlacement:
    """Express a placement as the rotation and translation of a part file.

    The anchor uses the bounding box of the rotated part, so that the translation takes back what the anchor moves.

    Parameters
    ----------
    vertices
        Of the part at its current file placement, world frame at posture (0, 0), shape (n, 3) [mm].
    placement
        Relative to the current file placement.
    anchor, rotate_deg, translate_mm
        Current values of the file.
    pivot
        Of the stage, shape (3,) [mm].
    """
    turn = rotation_z(placement.turn)
    turned = vertices @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = 0.5 * (low + high)
    if anchor == "rest_on_table":
        anchored = np.array([middle[0], middle[1], low[2]])
    elif anchor == "centred":
        anchored = middle
    else:
        anchored = turn @ np.array(translate_mm, dtype=np.float64)
    shift = pivot - turn @ pivot + np.array([placement.x, placement.y, 0.0]) + anchored
    about_z = rotate_deg[2] + math.degrees(placement.turn)
    return PartFilePlacement(
        rotate_deg=(rotate_deg[0], rotate_deg[1], math.remainder(about_z, 360.0)),
        translate_mm=(float(shift[0]), float(shift[1]), float(shift[2])),
    )
