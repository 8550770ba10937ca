"""Calibration of a rig: camera and stage axes from images of a board on the stage.

Entry: ``fit_board(views, board, camera=...) -> BoardFit``, with views from ``find_corners`` (images of a ChArUco board)
or ``read_corners`` (corners that another program found).
"""

from lightopt.estimate.rig_calibration._board import Board as Board, BoardView as BoardView
from lightopt.estimate.rig_calibration._board_fit import BoardFit as BoardFit, fit_board as fit_board
from lightopt.estimate.rig_calibration._board_images import BoardImage as BoardImage, find_corners as find_corners
from lightopt.estimate.rig_calibration._charuco import (
    CharucoBoard as CharucoBoard,
    board_mesh as board_mesh,
    white_areas as white_areas,
)
from lightopt.estimate.rig_calibration._corner_lists import read_corners as read_corners
from lightopt.estimate.rig_calibration._nominal import RigUncertainty as RigUncertainty
