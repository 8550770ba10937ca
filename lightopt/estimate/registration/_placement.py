"""The placement of a part on the stage relative to its part file, and as the part file's own values."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lightopt.config import PlacementConfig
from lightopt.core.arrays import Float64
from lightopt.core.transforms import rotation_z
from lightopt.scene import Scene, move_part, pixel_footprint

GREATEST_SHIFT_MM = 5.0
GREATEST_TURN_RAD = math.radians(6.0)
# reach of the search from the file placement: along x and y the larger of both, and about the vertical axis
GREATEST_SHIFT_PX = 16.0

MOST_ERROR_PX = 1.0
MOST_TURN_ERROR_RAD = math.radians(0.5)  # a shift or a rotation is determined where its standard error is below this


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


def part_file_placement(scene: Scene, placement: Placement, file: PlacementConfig) -> PlacementConfig:
    """``placement`` of a part file that puts the part at its measured placement, with the anchor that `file` has.

    The anchor uses the bounding box of the rotated part, so that the translation takes back what the anchor moves.

    scene: With the part at its file placement.
    """
    turn = rotation_z(placement.turn)
    turned = scene.mesh.vertices @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    middle = 0.5 * (low + high)
    if file.anchor == "rest_on_table":
        anchored = np.array([middle[0], middle[1], low[2]])
    elif file.anchor == "centred":
        anchored = middle
    else:
        anchored = turn @ np.array(file.translate_mm, dtype=np.float64)
    shift = scene.pivot - turn @ scene.pivot + np.array([placement.x, placement.y, 0.0]) + anchored
    about_x, about_y, about_z = file.rotate_deg
    about_z = math.remainder(about_z + math.degrees(placement.turn), 360.0)
    return file.model_copy(update={"rotate_deg": (about_x, about_y, about_z), "translate_mm": tuple(shift.tolist())})


@dataclass(frozen=True)
class PoseFrame:
    """Poses are shifts in x and y of the part's middle [mm] and a rotation about it [rad], from nominal; shape (3,).

    A placement rotates the part about the stage's axis. About the part's own middle shift and rotation hardly depend on
    each other: of a body of revolution that stands off the axis, the rotation alone is undetermined.

    middle: Of the part from the stage's axis, x and y [mm], shape (2,).
    radius: Of the part about its middle [mm].
    """

    middle: Float64
    radius: float
    pixel: float

    @staticmethod
    def of(scene: Scene) -> PoseFrame:
        """The frame of a scene's part at its file placement."""
        flat = scene.mesh.vertices[:, :2] - scene.pivot[:2]
        middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
        radius = float(np.sqrt(np.max(np.sum(np.square(flat - middle), axis=1))))
        distance = float(np.linalg.norm(scene.camera.position - scene.pivot))
        return PoseFrame(middle.astype(np.float64), max(radius, 1e-3), pixel_footprint(scene.camera, distance))

    @property
    def reach(self) -> Float64:
        """Greatest distance from nominal, shape (3,)."""
        shift = max(GREATEST_SHIFT_MM, GREATEST_SHIFT_PX * self.pixel)
        return np.array([shift, shift, GREATEST_TURN_RAD])

    @property
    def pixel_steps(self) -> Float64:
        """Shifts [mm] and turn [rad] that move the image of the part's rim by a pixel, shape (3,)."""
        return np.array([self.pixel, self.pixel, self.pixel / self.radius])

    @property
    def resolution(self) -> Float64:
        """Standard errors from which on a pose is not determined, shape (3,)."""
        return np.array([MOST_ERROR_PX * self.pixel, MOST_ERROR_PX * self.pixel, MOST_TURN_ERROR_RAD])

    def pose(self, placement: Placement) -> Float64:
        """The pose of a placement, shape (3,)."""
        x, y = self._turned(placement.turn) - self.middle + np.array([placement.x, placement.y])
        return np.array([x, y, placement.turn])

    def placement(self, pose: Float64, covariance: Float64 | None = None) -> Placement:
        """The placement of a pose, with standard errors where the pose's covariance, shape (3, 3), is given."""
        turn = float(pose[2])
        x, y = pose[:2] + self.middle - self._turned(turn)
        place = Placement(x=float(x), y=float(y), turn=turn)
        if covariance is None:
            return place
        slopes = np.eye(3)
        slopes[:2, 2] = -self._turned(turn + 0.5 * math.pi)
        ex, ey, et = np.sqrt(np.maximum(np.diag(slopes @ covariance @ slopes.T), 0.0)).tolist()
        return replace(place, errors=(ex, ey, et))

    def distance_px(self, a: Placement, b: Placement) -> float:
        """How far the part's image moves from one placement to another, at most [px]."""
        off = np.abs(self.pose(a) - self.pose(b)) / self.pixel_steps
        return float(np.hypot(off[0], off[1]) + off[2])

    def _turned(self, turn: float) -> Float64:
        c, s = math.cos(turn), math.sin(turn)
        x, y = self.middle
        return np.array([c * x - s * y, s * x + c * y])
