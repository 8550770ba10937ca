"""The nominal rig as the start and the prior of a fit."""

import numpy as np

from lightopt.estimate.rig_calibration._board import Board
from lightopt.estimate.rig_calibration._board_model import AT, NAMES, Origin
from lightopt.estimate.rig_calibration._joint_fit import Prior
from lightopt.scene import PinholeCamera, Stage

# How well the nominal rig is known beforehand, as standard deviations. What images do not determine stays near nominal;
# against what they do determine this has no weight.
_FOCAL_SHARE, _PRINCIPAL_SHARE, _POSITION_SHARE = (
    0.05,
    0.05,
    0.05,
)  # of itself, the image's width, the camera's distance
_ROTATION_DEG, _TILT_AXIS_DEG, _TILT_AXIS_MM = 5.0, 1.0, 5.0


def nominal_prior(board: Board, camera: PinholeCamera, stage: Stage, angle_error_deg: float) -> tuple[Prior, Origin]:
    """What is known beforehand, and the nominal orientations, in the world moved so that the rotary axis is Z."""
    aside = np.array([stage.pivot[0], stage.pivot[1], 0.0])
    point, axis = stage.tilt_axis
    mean, sd = np.zeros(len(NAMES)), np.full(len(NAMES), np.inf)
    reach = _POSITION_SHARE * float(np.linalg.norm(camera.position - stage.pivot))
    focal = camera.image_distance / camera.pixel_size
    lens = camera.distortion
    half = float(np.abs(board.points).max())
    for names, value, spread in [
        ("camera.rotation_x camera.rotation_y camera.rotation_z", 0.0, np.radians(_ROTATION_DEG)),
        ("camera.position_x camera.position_y camera.position_z", camera.position - aside, reach),
        ("camera.focal_px", focal, _FOCAL_SHARE * focal),
        ("camera.principal_x_px camera.principal_y_px", camera.axis_px, _PRINCIPAL_SHARE * camera.width),
        ("camera.aspect", camera.aspect, 0.01),
        ("camera.k1", lens.k1, 0.5),
        ("camera.k2", lens.k2, 5.0),
        ("camera.p1", lens.p1, 0.05),
        ("camera.p2", lens.p2, 0.05),
        ("camera.k3", lens.k3, 50.0),
        ("tilt_axis.elevation", np.arcsin(axis[2]), np.radians(_TILT_AXIS_DEG)),
        ("tilt_axis.position_y tilt_axis.position_z", (point - aside)[1:], _TILT_AXIS_MM),
        ("tilt_axis.scale", stage.tilt_scale, 0.005),
        ("rotary_axis.scale", stage.rotary_scale, 0.005),
        ("board.position_z", board.height, board.height_error),
        ("board.scale", 0.0, board.pitch_error),
        ("board.pitch_ratio", 0.0, 0.01),
        ("board.bow_xx board.bow_xy board.bow_yy", 0.0, 0.02 * half),
    ]:
        at = [AT[name] for name in names.split()]
        mean[at], sd[at] = value, spread
    origin = Origin(np.array([camera.right, -camera.up, camera.forward]), np.eye(3))
    return Prior(mean, sd, float(np.radians(angle_error_deg))), origin
