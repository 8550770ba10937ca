"""Where the board is on the stage, from one view, to start the fit from.

Each view alone gives a homography and from it two poses of a plane, which mirror each other about the line of sight
(Oberkampf et al. 1996, doi:10.1006/cviu.1996.0037). The nominal rig turns each into a pose on the stage. The one that
explains all views best is the start.
"""

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._board_model import (
    AT,
    BOARD_POSITION,
    CAMERA_POSITION,
    Origin,
    Sightings,
    predict,
    stage_of,
)

_LEAST_POINTS = 6
_MOST_VIEWS = 24  # whose poses are tried
_BEHIND_PX = 1e6  # error of a point that would be behind the camera


def start_from_views(x: Float64, origin: Origin, seen: Sightings, pixels: Float64) -> tuple[Float64, Origin]:
    """Parameters and orientations with the board in its place.

    x, origin: Nominal; those of the board are not used
    pixels: Shape (N, 2)
    Raises InputError: No view has enough points that are not on a line
    """
    f, cx, cy, aspect = x[AT["camera.focal_px"] : AT["camera.k1"]]
    rays = (pixels - [cx, cy]) / [f, f * aspect]
    views = len(seen.readings)
    best: tuple[float, Float64, Origin] | None = None
    for view in np.unique(np.linspace(0, views - 1, min(views, _MOST_VIEWS)).astype(int)):
        mine = seen.view == view
        flat = seen.points[mine] - seen.points[mine].mean(axis=0) if mine.any() else np.zeros((0, 2))
        if len(flat) < _LEAST_POINTS or np.linalg.matrix_rank(flat) < 2:
            continue
        for turned, shift in _plane_poses(seen.points[mine], rays[mine]):
            lift, at_zero = stage_of(x).transform(Posture(*np.degrees(seen.readings[view])))
            world = origin.camera.T
            placed = Origin(origin.camera, lift.T @ world @ turned)
            there = x.copy()
            there[BOARD_POSITION] = lift.T @ (world @ shift + x[CAMERA_POSITION] - at_zero)
            predicted, _, _ = predict(there, np.zeros((views, 2)), placed, seen, slopes=False)
            error = np.nan_to_num(pixels - predicted, nan=_BEHIND_PX)
            # the camera's direction shifts a view as a whole
            for k in np.unique(seen.view):
                error[seen.view == k] -= np.median(error[seen.view == k], axis=0)
            cost = float(np.median(np.linalg.norm(error, axis=1)))
            if best is None or cost < best[0]:
                best = cost, there, placed
    if best is None:
        raise InputError(f"board: no image shows {_LEAST_POINTS} points that are not on a line")
    return best[1], best[2]


def _plane_poses(points: Float64, rays: Float64) -> list[tuple[Float64, Float64]]:
    # rotations and translations of the board's frame into the camera's
    rows = np.zeros((2 * len(points), 9))
    centre, size = rays.mean(axis=0), max(float(rays.std()), 1e-12)
    unit = float(points.std())
    u, v = ((rays - centre) / size).T
    flat = np.column_stack([points / unit, np.ones(len(points))])
    rows[::2, :3], rows[::2, 6:] = flat, -u[:, None] * flat
    rows[1::2, 3:6], rows[1::2, 6:] = flat, -v[:, None] * flat
    h = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    h = (
        np.array([[size, 0.0, centre[0]], [0.0, size, centre[1]], [0.0, 0.0, 1.0]])
        @ h
        @ np.diag([1.0 / unit, 1.0 / unit, 1.0])
    )
    h /= np.copysign(0.5 * (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1])), h[2, 2])
    axes, shift = h[:, :2], h[:, 2]
    sight = shift / np.linalg.norm(shift)
    poses: list[tuple[Float64, Float64]] = []
    for a in (axes, axes - 2.0 * np.outer(sight, sight @ axes)):
        left, _, right = np.linalg.svd(a, full_matrices=False)
        flat_axes = left @ right  # nearest orthonormal pair
        poses.append((np.column_stack([flat_axes, np.cross(flat_axes[:, 0], flat_axes[:, 1])]), shift))
    return poses
