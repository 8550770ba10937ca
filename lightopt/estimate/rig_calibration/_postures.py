"""What a calibration is good for: the pixels that it predicts, and the posture that would improve them most."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from lightopt.core.arrays import Bool, Float64
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._board import Board
from lightopt.estimate.rig_calibration._board_model import predict, sightings
from lightopt.estimate.rig_calibration._joint_fit import JointFit, inverse
from lightopt.scene import PinholeCamera

_TILTS_DEG, _ROTATIONS_DEG = range(-45, 46, 15), range(0, 360, 30)
_LEAST_SINE = 0.3  # of the angle at which the camera sees the board


@dataclass(frozen=True, kw_only=True)
class PostureGain:
    """A posture to take next, and the standard error of predicted pixels with it [px]."""

    posture: Posture
    predicted_rms: float


def judge_postures(
    fit: JointFit, board: Board, taken: Float64, camera: PinholeCamera, postures: Sequence[Posture] | None
) -> tuple[float, PostureGain | None]:
    """Standard error of a pixel predicted for points of the board over all postures that show it [px], and the best.

    taken: Readings of the views [rad], shape (K, 2)
    """
    if postures is None:
        postures = [Posture(float(t), float(r)) for t, r in product(_TILTS_DEG, _ROTATIONS_DEG)]
    points = np.arange(board.columns * board.rows)
    outer = points.reshape(board.rows, board.columns)[[0, 0, -1, -1], [0, -1, -1, 0]]
    outline = predict(fit.x, fit.angles, fit.origin, sightings(board, [outer] * len(taken), taken), slopes=False)[0]
    readings = np.radians([[p.elevation_deg, p.rotation_deg] for p in postures])
    seen = sightings(board, [points] * len(postures), readings)
    pixels, by_x, by_angles = predict(fit.x, np.zeros_like(readings), fit.origin, seen)
    shape = (len(postures), 2 * len(points), -1)
    inside = np.all((pixels >= 0.0) & (pixels <= [camera.width, camera.height]), axis=1).reshape(len(postures), -1)
    facing = _facing(pixels.reshape(*inside.shape, 2)[:, outer], outline.reshape(-1, 4, 2))
    shown = np.flatnonzero(facing & inside.any(axis=1))
    if not len(shown):
        return float("nan"), None
    rows = np.repeat(inside, 2, axis=1)[shown, :, None]  # points outside of the image do not count
    by_free = by_x[:, :, fit.free].reshape(shape)[shown] * rows
    by_angles = by_angles.reshape(*shape[:2], 2)[shown] * rows
    spread = np.einsum("kni,knj->ij", by_free, by_free) / inside[shown].sum()
    now = float(np.sqrt(np.sum(fit.of_free * spread)))
    information = inverse(fit.of_free)
    gains: list[PostureGain] = []
    unit = fit.noise * fit.common
    for number, slopes, own in zip(shown, by_free / unit, by_angles / unit, strict=True):
        inner = own.T @ own + np.eye(2) / fit.angle_sd**2  # the new readings have errors, too
        cross = own.T @ slopes
        gained = slopes.T @ slopes - cross.T @ np.linalg.solve(inner, cross)
        rms = float(np.sqrt(np.sum(inverse(information + gained) * spread)))
        gains.append(PostureGain(posture=postures[int(number)], predicted_rms=rms))
    return now, min(gains, key=lambda gain: gain.predicted_rms)


def _facing(outline: Float64, in_views: Float64) -> Bool:
    # postures at which the camera sees the face of the board that it saw in the views, not at a grazing angle;
    # outlines are pixels of the board's four corners, shape (k, 4, 2)
    def areas(corners: Float64) -> Float64:
        a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    found, known = areas(outline), areas(in_views)
    sign = np.sign(np.median(known))
    return sign * found >= _LEAST_SINE * max(np.max(sign * found), np.max(sign * known))
