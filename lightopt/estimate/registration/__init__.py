"""What a camera measured, laid over the model: images checked against their rig, and the part where it really lies."""

from lightopt.estimate.registration._observations import Observation, observed_postures, read_observations
from lightopt.estimate.registration._part_file import PlacementInFile, placement_in_file
from lightopt.estimate.registration._pixels import view_of_placed
from lightopt.estimate.registration._placement import Placement, place_part
from lightopt.estimate.registration._pose import PoseFrame
from lightopt.estimate.registration._refinement import DARK_SPREAD, GAIN_SPREAD
from lightopt.estimate.registration._registration import Registration, register
from lightopt.estimate.registration._wrong_images import FLIPS, Agreement, agreement, refuse_mismatch

__all__ = [
    "DARK_SPREAD",
    "FLIPS",
    "GAIN_SPREAD",
    "Agreement",
    "Observation",
    "Placement",
    "PlacementInFile",
    "PoseFrame",
    "Registration",
    "agreement",
    "observed_postures",
    "place_part",
    "placement_in_file",
    "read_observations",
    "refuse_mismatch",
    "register",
    "view_of_placed",
]
