"""Calibration of a rig: camera and stage axes, panels and their light, the sensor, from images of targets on the stage.

Entry: ``plan_calibration(rig, folder)`` says what to capture, ``calibrate_rig(rig, folder) -> RigCalibration`` reads it.
Each step by itself: ``fit_board`` (camera, stage), ``fit_ball`` (panels), ``fit_plate`` (light), ``photon_transfer``.
"""

from lightopt.estimate.rig_calibration._board import Board as Board, BoardView as BoardView
from lightopt.estimate.rig_calibration._board_fit import BoardFit as BoardFit, fit_board as fit_board
from lightopt.estimate.rig_calibration._board_images import BoardImage as BoardImage, find_corners as find_corners
from lightopt.estimate.rig_calibration._calibrate import (
    RigCalibration as RigCalibration,
    calibrate_rig as calibrate_rig,
)
from lightopt.estimate.rig_calibration._charuco import (
    CharucoBoard as CharucoBoard,
    board_mesh as board_mesh,
    white_areas as white_areas,
)
from lightopt.estimate.rig_calibration._corner_lists import read_corners as read_corners
from lightopt.estimate.rig_calibration._files import (
    REPORT_NAME as REPORT_NAME,
    figures as figures,
    intervals as intervals,
    write_calibration as write_calibration,
)
from lightopt.estimate.rig_calibration._nominal import RigUncertainty as RigUncertainty
from lightopt.estimate.rig_calibration._plan import (
    CalibrationPlan as CalibrationPlan,
    plan_calibration as plan_calibration,
)
