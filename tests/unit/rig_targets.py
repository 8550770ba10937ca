"""A rig with four panels and what a mirror ball on its stage shows, by brute force where physics is concerned."""

from __future__ import annotations

import math

import numpy as np

from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._ball_fit import BallView, MirroredPanel, mirrored_image, posed_panel
from lightopt.estimate.rig_calibration._plate_fit import _cosines, _irradiance
from lightopt.lights import panel_corners, place_light
from lightopt.scene import Stage, place_camera, project

RADIUS = 10.0
POSTURES = tuple(Posture(tilt, turn) for tilt in (-20.0, 20.0) for turn in (0.0, 90.0, 180.0, 270.0))
AXIS = np.array([0.0, 0.35, 0.0])
STAGE = Stage(pivot=AXIS, tilt_point=AXIS, tilt_direction=np.array([1.0, 0.0, 0.002]) / math.hypot(1.0, 0.002))
CAMERA = place_camera(
    distance=550.0, elevation=math.pi / 2, azimuth=-math.pi / 2, roll=0.0, width=1600, height=1200, pixel_size=0.0044,
    image_distance=55.0,
)  # fmt: skip
LIGHTS = tuple(
    place_light(
        name=f"light{k + 1}", distance=330.0, elevation=math.radians(60.0), azimuth=math.radians(45.0 + 90.0 * k),
        size=(60.0, 60.0), points="auto",
    )
    for k in range(4)
)  # fmt: skip


def outline_points(centre, radius, count, camera=CAMERA):
    """Where lines of sight touch the ball, of shape (count, 2)."""
    to_ball = centre - camera.position
    away = np.linalg.norm(to_ball)
    ahead = to_ball / away
    side = np.cross(ahead, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = np.arange(count) * 2.0 * np.pi / count
    ring = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(ahead, side)
    sine = radius / away
    touching = camera.position + 500.0 * (math.sqrt(1.0 - sine * sine) * ahead + sine * ring)
    columns, rows, _ = project(camera, touching)
    return np.stack([columns, rows], axis=1)


def moved_panels(rng, *, shift=3.0, turn=0.035, size_error=0.1):
    """Panels that are not where the rig file has them."""
    return tuple(
        posed_panel(
            light, np.concatenate([rng.normal(0, shift, 3), rng.normal(0, turn, 3), rng.normal(60, size_error, 2)])
        )
        for light in LIGHTS
    )


def ball_views(rng, panels, centre, *, postures=POSTURES, corner=0.1, outline=0.05, camera=CAMERA, stage=STAGE):
    """Corners with 0.1 px of noise, and outlines whose noise puts their centre 0.05 px off."""
    views = []
    for posture in postures:
        rotation, translation = stage.transform(posture)
        ball = rotation @ centre + translation
        scatter = outline * math.sqrt(12.0)
        points = outline_points(ball, RADIUS, 24, camera) + rng.normal(0.0, scatter, (24, 2))
        seen = {}
        for light in panels:
            corners = mirrored_image(camera, ball, RADIUS, panel_corners(light)) + rng.normal(0.0, corner, (4, 2))
            # which corner comes first, and in which sense, the images do not tell
            corners = np.roll(corners, int(rng.integers(4)), axis=0)[:: int(rng.choice([1, -1]))]
            seen[light.name] = MirroredPanel(corners=corners, covariance=corner**2 * np.eye(8))
        views.append(BallView(posture=posture, outline=points, outline_error=scatter, panels=seen))
    return views


def panel_errors(fitted, true):
    """By panel: offset along its sides and outward [mm], rotation about them [rad], size [mm]; and world offset."""
    from lightopt.core.transforms import vector_of_rotation

    axes, true_axes = (np.stack([p.across, p.along, p.outward], axis=1) for p in (fitted, true))
    turn = vector_of_rotation(true_axes.T @ axes)
    offset = fitted.centre - true.centre
    return np.concatenate([true_axes.T @ offset, turn, np.subtract(fitted.size, true.size)]), offset


def irradiance(light, points, normal, *, exponent, kappa=0.0):
    """Level of a Lambertian surface with R_d = 1 under a panel with gain 1."""
    cosines = _cosines([light], np.zeros(len(points), np.intp), points, np.broadcast_to(normal, points.shape))
    return _irradiance(*cosines, exponent=exponent, kappa=kappa)[0]
