"""Calibration of a rig: camera and stage axes from images of a board on the stage.

Entry: ``fit_board(views, board, camera=...) -> BoardFit``.
"""

from lightopt.estimate.rig_calibration._board import Board as Board, BoardView as BoardView
from lightopt.estimate.rig_calibration._board_fit import (
    BoardFit as BoardFit,
    RigUncertainty as RigUncertainty,
    ViewResidual as ViewResidual,
    fit_board as fit_board,
)
from lightopt.estimate.rig_calibration._postures import PostureGain as PostureGain
