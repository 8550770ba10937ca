"""Calibration of a rig from images of targets on its stage, and of its camera's sensor.

Entry: ``plan_calibration(rig, folder)`` says what to capture, ``calibrate_rig(rig, folder)`` reads it,
``write_calibration`` writes the calibrated rig. Its steps:

- Board: ``fit_board(views, board, camera=...) -> BoardFit`` gives camera and stage axes, with views from
  ``find_corners`` (images of a ChArUco board) or a list of corners that another program found.
- Mirror ball: ``_ball_images`` measures the mirrored panels, ``_ball_fit`` gives their poses.
- Matt plate: ``_plate_fit`` gives the panels' light and the lens's vignetting.
- Pairs of frames: ``_photon_transfer`` gives the sensor.
"""

from ._board import (
    Board,
    BoardImage as BoardImage,
    BoardView,
    board_grid as board_grid,
    board_mesh as board_mesh,
    find_corners as find_corners,
    white_areas,
)
from ._board_fit import BoardFit, fit_board as fit_board
from ._calibrate import RigCalibration, calibrate_rig
from ._deviations import Measured, read_covariance, rig_deviations, square_root
from ._files import REPORT_NAME, figures, plan_calibration, write_calibration
