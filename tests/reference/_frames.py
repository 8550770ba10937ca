"""Where camera, lights and part are: placing by angles, the pinhole with its lens, the stage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


def cosd(a):
    return np.cos(np.deg2rad(a))


def sind(a):
    return np.sin(np.deg2rad(a))


def axes(elevation, azimuth):
    """d, e_phi, e_theta of a direction given in degrees."""
    d = np.array([cosd(elevation) * cosd(azimuth), cosd(elevation) * sind(azimuth), sind(elevation)])
    e_phi = np.array([-sind(azimuth), cosd(azimuth), 0.0])
    e_theta = np.array([-sind(elevation) * cosd(azimuth), -sind(elevation) * sind(azimuth), cosd(elevation)])
    return d, e_phi, e_theta


@dataclass(frozen=True)
class Camera:
    """A pinhole that looks at the origin; distortion is OpenCV's (k1, k2, p1, p2, k3), y down."""

    width: int
    height: int
    distance: float = 550.0
    elevation: float = 90.0
    azimuth: float = 270.0
    roll: float = 0.0
    pixel_um: float = 44.0
    image_distance: float = 55.0
    distortion: tuple = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def focal_px(self):
        return self.image_distance / (self.pixel_um * 1e-3)

    @property
    def position(self):
        return self.distance * axes(self.elevation, self.azimuth)[0]

    def right_up_forward(self):
        d, e_phi, e_theta = axes(self.elevation, self.azimuth)
        right = cosd(self.roll) * e_phi + sind(self.roll) * e_theta
        up = -sind(self.roll) * e_phi + cosd(self.roll) * e_theta
        return right, up, -d

    def distort(self, x, y):
        """Ideal to distorted image coordinates (in focal lengths, y down)."""
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def undistort(self, xd, yd):
        """Inverse of `distort` by fixed-point iteration, to the last bits."""
        x, y = np.copy(xd), np.copy(yd)
        for _ in range(200):
            fx, fy = self.distort(x, y)
            x, y = x + (xd - fx), y + (yd - fy)
        fx, fy = self.distort(x, y)
        assert max(np.abs(fx - xd).max(), np.abs(fy - yd).max()) < 1e-13, "the inverse did not converge"
        return x, y

    def pixel_centres(self):
        """(H·W, 2) of (column, row) coordinates."""
        rows, columns = np.mgrid[0 : self.height, 0 : self.width]
        return np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=1)

    def directions(self, pixels):
        """Unit ray directions (N, 3) through pixel coordinates (N, 2)."""
        right, up, forward = self.right_up_forward()
        xd = (pixels[:, 0] - self.width / 2) / self.focal_px
        yd = (pixels[:, 1] - self.height / 2) / self.focal_px
        x, y = self.undistort(xd, yd)
        rays = forward + x[:, None] * right - y[:, None] * up
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def project(self, points):
        """Pixel coordinates (N, 2) of world points (N, 3)."""
        right, up, forward = self.right_up_forward()
        q = points - self.position
        depth = q @ forward
        x, y = self.distort(q @ right / depth, -(q @ up) / depth)
        return np.stack([x * self.focal_px + self.width / 2, y * self.focal_px + self.height / 2], axis=1)


@dataclass(frozen=True)
class Light:
    """A panel that faces the origin, as k × k points."""

    distance: float = 330.0
    elevation: float = 60.0
    azimuth: float = 45.0
    size: tuple = (60.0, 60.0)
    k: int = 2
    normalisation: str = "mean"
    falloff: str = "none"
    emission: float = 0.0
    gain: float = 1.0

    @property
    def axis(self):
        return axes(self.elevation, self.azimuth)[0]

    def at(self, u, v):
        """World points at panel coordinates u along e_phi and v along e_theta, each in -1/2 … 1/2."""
        d, e_phi, e_theta = axes(self.elevation, self.azimuth)
        u, v = np.asarray(u)[..., None], np.asarray(v)[..., None]
        return self.distance * d + self.size[0] * u * e_phi + self.size[1] * v * e_theta

    def points(self):
        """The point lights (k·k, 3) at the cell centres, and their weights."""
        centres = (np.arange(self.k) + 0.5) / self.k - 0.5
        u, v = np.meshgrid(centres, centres)
        m = self.k * self.k
        weight = {"mean": 1.0 / m, "sum": 1.0}[self.normalisation]
        return self.at(u.ravel(), v.ravel()), np.full(m, weight)


def stage_rotation(elevation, rotation):
    """Rx(elevation)·Rz(rotation): the cradle carries the rotary axis."""
    c, s = cosd(elevation), sind(elevation)
    rx = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    c, s = cosd(rotation), sind(rotation)
    rz = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return rx @ rz


def posed(points, elevation, rotation, pivot=(0.0, 0.0, 0.0)):
    """Points (..., 3) of the part when the stage stands at the posture."""
    pivot = np.asarray(pivot, dtype=float)
    return pivot + np.einsum("ij,...j->...i", stage_rotation(elevation, rotation), points - pivot)


def posed_normals(normals, elevation, rotation):
    return np.einsum("ij,...j->...i", stage_rotation(elevation, rotation), normals)
