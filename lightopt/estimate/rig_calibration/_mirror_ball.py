"""What a camera sees of a mirror ball: its outline, and the points of the ball that mirror points of the room."""

from __future__ import annotations

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.scene import PinholeCamera, pixel_directions, project

_MOST_STEPS = 60
_ANGLE_TOLERANCE = 1e-13  # [rad]


def mirror_points(centre: Float64, radius: float, eye: Float64, points: Float64) -> Float64:
    """Points of a ball where an eye sees other points mirrored [mm], shape (..., 3); NaN for a point it cannot mirror.

    In the plane of ball, eye and point, the angle ψ from the eye's direction to the mirror point makes the angles of
    incidence and reflection equal: ``atan2(a·sinψ, a·cosψ − r) = atan2(b·sin(γ−ψ), b·cos(γ−ψ) − r)``, with the
    distances a and b of eye and point from the ball's centre and the angle γ between them (Alhazen's problem).

    centre, eye, points: [mm], shapes (..., 3), of one frame
    """
    to_eye, to_point = eye - centre, points - centre
    a, b = np.linalg.norm(to_eye, axis=-1), np.linalg.norm(to_point, axis=-1)
    first = to_eye / a[..., None]
    across = to_point - np.sum(to_point * first, axis=-1, keepdims=True) * first
    length = np.linalg.norm(across, axis=-1)
    second = across / np.maximum(length, 1e-300)[..., None]
    gamma = np.arctan2(length, np.sum(to_point * first, axis=-1))
    low, high = np.zeros_like(gamma), gamma.copy()
    psi = 0.5 * gamma
    for _ in range(_MOST_STEPS):
        off = _reflected_angle(a, radius, psi) - _reflected_angle(b, radius, gamma - psi)
        low, high = np.where(off < 0.0, psi, low), np.where(off < 0.0, high, psi)
        slope = _slope(a, radius, psi) + _slope(b, radius, gamma - psi)
        step = psi - off / slope
        # Newton's step where it stays between the bounds, half of them elsewhere
        step = np.where((step >= low) & (step <= high), step, 0.5 * (low + high))
        done = np.abs(step - psi) <= _ANGLE_TOLERANCE
        psi = step
        if done.all():
            break
    seen = (a * np.cos(psi) > radius) & (b * np.cos(gamma - psi) > radius)
    psi = np.where(seen, psi, np.nan)[..., None]
    return centre + radius * (np.cos(psi) * first + np.sin(psi) * second)


def _reflected_angle(distance: Float64, radius: float, psi: Float64) -> Float64:
    return np.arctan2(distance * np.sin(psi), distance * np.cos(psi) - radius)


def _slope(distance: Float64, radius: float, psi: Float64) -> Float64:
    cosine = np.cos(psi)
    square = distance * distance - 2.0 * distance * radius * cosine + radius * radius
    return (distance * distance - distance * radius * cosine) / square


def mirrored_image(camera: PinholeCamera, centre: Float64, radius: float, points: Float64) -> Float64:
    """Image points (column, row) [px] of points mirrored by a ball, shape (..., 2); NaN where there are none.

    centre, points: [mm], shapes (..., 3), frame of the camera's vectors
    """
    mirror = mirror_points(centre, radius, camera.position, points)
    columns, rows, _ = project(camera, mirror.reshape(-1, 3))
    return np.stack([columns, rows], axis=-1).reshape((*mirror.shape[:-1], 2))


def outline_distances(camera: PinholeCamera, centre: Float64, radius: float, outline: Float64) -> Float64:
    """How far image points are outside a ball's outline [px], shape (n,).

    The outline is the cone ``(x·c)² = (|c|² − r²)·|x|²`` about the direction c of the ball's centre, of half angle
    arcsin(r/|c|): exact for every lens, an ellipse for one without distortion.

    centre: [mm], shape (3,), frame of the camera's vectors
    outline: Image points (column, row) [px], shape (n, 2)
    """
    rays = pixel_directions(camera, *np.ascontiguousarray(outline.T))
    to_centre = centre - camera.position
    away = float(np.linalg.norm(to_centre))
    angle = np.arctan2(np.linalg.norm(np.cross(rays, to_centre), axis=1), rays @ to_centre)
    # a radian is so many pixels in the direction from the centre's image, for which the mean of both directions serves
    scale = camera.image_distance / camera.pixel_size
    off_axis = np.sum(np.square(rays), axis=1)  # 1 + tan²
    return (angle - np.arcsin(radius / away)) * scale * off_axis**0.75
