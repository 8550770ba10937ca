"""Directions, local frames and rotations in the world frame (right-handed, +Z up, column vectors)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64


def direction(*, elevation: float, azimuth: float) -> Float64:
    """Unit vector d from the origin towards (elevation θ, azimuth φ), shape (3,), world frame.

    elevation, azimuth: [rad]. Elevation is measured from the table plane: π/2 is straight above, and it may pass π/2.
    """
    c, s = np.cos(elevation), np.sin(elevation)
    return np.array([c * np.cos(azimuth), c * np.sin(azimuth), s])


def elevation_tangent(*, elevation: float, azimuth: float) -> Float64:
    """Unit vector e_θ = ∂d/∂θ, shape (3,), world frame; angles in [rad]."""
    c, s = np.cos(elevation), np.sin(elevation)
    return np.array([-s * np.cos(azimuth), -s * np.sin(azimuth), c])


def azimuth_tangent(*, azimuth: float) -> Float64:
    """Unit vector e_φ along increasing azimuth, shape (3,), world frame; angle in [rad]. e_φ × e_θ = d."""
    return np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])


def rotation_x(angle: float) -> Float64:
    """Rotation about the X axis by `angle` [rad], shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle: float) -> Float64:
    """Rotation about the Y axis by `angle` [rad], shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle: float) -> Float64:
    """Rotation about the Z axis by `angle` [rad], shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_from_vector(vector: Float64) -> Float64:
    """Rotation by |vector| [rad] about the vector of shape (3,); shape (3, 3) (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)


def vector_of_rotation(rotation: Float64) -> Float64:
    """The vector of :func:`rotation_from_vector`, shape (3,), of a length up to π."""
    from scipy.spatial.transform import Rotation  # which takes longer to load than most commands have to run

    return np.asarray(Rotation.from_matrix(rotation).as_rotvec(), np.float64)


@dataclass(frozen=True)
class Posture:
    """How the stage holds the part: tilt θ_j, then rotation φ_j, in degrees as files and people name them."""

    elevation_deg: float
    rotation_deg: float

    def __str__(self) -> str:
        return f"({self.elevation_deg:g}°, {self.rotation_deg:g}°)"

    @property
    def matrix(self) -> Float64:
        """Rotation R = Rx(θ_j)·Rz(φ_j), shape (3, 3): the tilt cradle carries the rotary axis."""
        return rotation_x(math.radians(self.elevation_deg)) @ rotation_z(math.radians(self.rotation_deg))

    @staticmethod
    def from_dict(facts: Mapping[str, float]) -> "Posture":
        """From what :meth:`as_dict` gives."""
        return Posture(facts["elevation_deg"], facts["rotation_deg"])

    def as_dict(self) -> dict[str, float]:
        """JSON form."""
        return {"elevation_deg": self.elevation_deg, "rotation_deg": self.rotation_deg}
