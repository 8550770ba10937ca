"""Calibration of the rig from images of targets on its stage, and of the camera's sensor.

A mirror ball shows where the panels are (:func:`fit_ball`), a matt plate how they shine (:func:`fit_plate`), pairs of
frames what the sensor makes of light (:func:`photon_transfer`).
"""

from lightopt.estimate.rig_calibration._ball_fit import (
    PANEL_PARAMETERS as PANEL_PARAMETERS,
    BallFit as BallFit,
    BallView as BallView,
    MirroredPanel as MirroredPanel,
    fit_ball as fit_ball,
)
from lightopt.estimate.rig_calibration._ball_images import measure_ball as measure_ball
from lightopt.estimate.rig_calibration._measured import Measured as Measured
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
