"""A parallel view of the world: what is parallel stays parallel, and lengths along a direction keep their ratio."""

from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.transforms import azimuth_tangent, direction, elevation_tangent


def _fixed(x: float, y: float, z: float) -> Float64:
    vector = np.array([x, y, z])
    vector.flags.writeable = False
    return vector


# the world frame's origin and axes
ORIGIN, X, Y, Z = _fixed(0, 0, 0), _fixed(1, 0, 0), _fixed(0, 1, 0), _fixed(0, 0, 1)


@dataclass(frozen=True, kw_only=True)
class ParallelView:
    """Orthographic view from (elevation, azimuth) [rad]; vectors are in the world frame, shape (3,).

    scale: [px/mm]
    offset: Where the world's origin lies on the picture [px], shape (2,)
    """

    elevation: float
    azimuth: float
    scale: float
    offset: Float64

    @property
    def right(self) -> Float64:
        """Unit vector to the right on the picture."""
        return azimuth_tangent(azimuth=self.azimuth)

    @property
    def up(self) -> Float64:
        """Unit vector up on the picture."""
        return elevation_tangent(elevation=self.elevation, azimuth=self.azimuth)

    @property
    def toward(self) -> Float64:
        """Unit vector towards the viewer."""
        return direction(elevation=self.elevation, azimuth=self.azimuth)

    def place(self, points: Float64) -> Float64:
        """Where world points [mm], shape (..., 3), lie on the picture [px], x right and y down, shape (..., 2)."""
        points = np.asarray(points, dtype=np.float64)
        return self.offset + self.scale * np.stack([points @ self.right, -(points @ self.up)], axis=-1)

    def nearness(self, points: Float64) -> Float64:
        """How near world points [mm], shape (..., 3), are to the viewer [mm], shape (...)."""
        return np.asarray(points, dtype=np.float64) @ self.toward


def fit_view(
    points: Float64, *, elevation: float, azimuth: float, box: tuple[float, float, float, float]
) -> ParallelView:
    """The largest view that shows all points [mm], shape (n, 3), centred in a box (left, top, right, bottom) [px]."""
    unit = ParallelView(elevation=elevation, azimuth=azimuth, scale=1.0, offset=np.zeros(2))
    flat = unit.place(points)
    low, high = flat.min(axis=0), flat.max(axis=0)
    corners = np.array(box).reshape(2, 2)
    room = corners[1] - corners[0]
    scale = float(np.min(room / np.maximum(high - low, 1e-9)))
    return replace(unit, scale=scale, offset=corners.mean(axis=0) - scale * 0.5 * (low + high))


def arc(centre: Float64, start: Float64, towards: Float64, angle: float, radius: float) -> Float64:
    """Points of a circular arc [mm], shape (n, 3): from `start` through `angle` [rad] towards `towards`.

    `start` and `towards` are orthonormal vectors, shape (3,).
    """
    angles = np.linspace(0.0, angle, max(2, int(abs(angle) * 24)))[:, None]
    return centre + radius * (np.cos(angles) * start + np.sin(angles) * towards)
