"""Calibration of a rig from images of targets on its stage, and of its camera's sensor.

- Board: ``fit_board(views, board, camera=...) -> BoardFit`` gives camera and stage axes, with views from
  ``find_corners`` (images of a ChArUco board) or ``read_corners`` (corners that another program found).
- Mirror ball: ``fit_ball`` gives the poses of the panels, with views from ``measure_ball``.
- Matt plate: ``fit_plate`` gives the panels' light and the lens's vignetting, with views from ``plate_cells``.
- Pairs of frames: ``photon_transfer`` gives the sensor.
"""

from lightopt.estimate.rig_calibration._ball_fit import (
    PANEL_PARAMETERS as PANEL_PARAMETERS,
    BallFit as BallFit,
    BallView as BallView,
    MirroredPanel as MirroredPanel,
    fit_ball as fit_ball,
)
from lightopt.estimate.rig_calibration._ball_images import measure_ball as measure_ball
from lightopt.estimate.rig_calibration._board import Board as Board, BoardView as BoardView
from lightopt.estimate.rig_calibration._board_fit import BoardFit as BoardFit, fit_board as fit_board
from lightopt.estimate.rig_calibration._board_images import BoardImage as BoardImage, find_corners as find_corners
from lightopt.estimate.rig_calibration._charuco import (
    CharucoBoard as CharucoBoard,
    board_mesh as board_mesh,
    white_areas as white_areas,
)
from lightopt.estimate.rig_calibration._corner_lists import read_corners as read_corners
from lightopt.estimate.rig_calibration._measured import Measured as Measured
from lightopt.estimate.rig_calibration._nominal import RigUncertainty as RigUncertainty
from lightopt.estimate.rig_calibration._photon_transfer import (
    FramePair as FramePair,
    PhotonTransfer as PhotonTransfer,
    photon_transfer as photon_transfer,
)
from lightopt.estimate.rig_calibration._plate_fit import (
    Plate as Plate,
    PlateFit as PlateFit,
    PlateView as PlateView,
    fit_plate as fit_plate,
    plate_cells as plate_cells,
)
