"""The pose that registration searches: shift of the part's own middle, and rotation about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.estimate.registration._placement import Placement
from lightopt.scene import Scene, pixel_footprint

Float64 = NDArray[np.float64]

GREATEST_SHIFT_MM = 5.0
GREATEST_TURN_RAD = math.radians(6.0)
GREATEST_SHIFT_PX = 16.0
"""Reach of the search from the file placement: along x and y the larger of both, and about the vertical axis."""

MOST_ERROR_PX = 1.0
MOST_TURN_ERROR_RAD = math.radians(0.5)
"""A shift or a rotation is determined where its standard error is below this."""


@dataclass(frozen=True)
class PoseFrame:
    """Poses are shifts in x and y of the part's middle [mm] and a rotation about it [rad], from nominal; shape (3,).

    A placement rotates the part about the stage's axis. About the part's own middle shift and rotation hardly depend on
    each other: of a body of revolution that stands off the axis, the rotation alone is undetermined.

    middle: Of the part from the stage's axis, x and y [mm], shape (2,).
    radius: Of the part about its middle [mm].
    pixel: Side of a pixel's footprint [mm].
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
        return PoseFrame(
            middle.astype(np.float64), max(radius, 1e-3), pixel_footprint(scene.camera, distance)
        )

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
        turned = self._turned(placement.turn)
        x, y = turned - self.middle + np.array([placement.x, placement.y])
        return np.array([x, y, placement.turn])

    def placement(self, pose: Float64, covariance: Float64 | None = None) -> Placement:
        """The placement of a pose, with standard errors where the pose's covariance, shape (3, 3), is given."""
        turn = float(pose[2])
        x, y = pose[:2] + self.middle - self._turned(turn)
        errors = (0.0, 0.0, 0.0)
        if covariance is not None:
            slopes = np.eye(3)
            slopes[:2, 2] = -self._turned(turn + 0.5 * math.pi)
            variance = np.diag(slopes @ covariance @ slopes.T)
            ex, ey, et = np.sqrt(np.maximum(variance, 0.0))
            errors = (float(ex), float(ey), float(et))
        return Placement(x=float(x), y=float(y), turn=turn, errors=errors)

    def distance_px(self, a: Placement, b: Placement) -> float:
        """How far the part's image moves from one placement to another, at most [px]."""
        off = np.abs(self.pose(a) - self.pose(b)) / self.pixel_steps
        return float(np.hypot(off[0], off[1]) + off[2])

    def _turned(self, turn: float) -> Float64:
        c, s = math.cos(turn), math.sin(turn)
        x, y = self.middle
        return np.array([c * x - s * y, s * x + c * y])
