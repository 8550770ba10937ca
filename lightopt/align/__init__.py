"""What a camera measured, laid over the model: images checked against their rig, and the part where it really lies."""

from lightopt.align._in_file import PlacementInFile, placement_in_file
from lightopt.align._least_squares import HUBER, Limits, Problem, Solution, linear_problem, solve
from lightopt.align._mismatch import FLIPS, Agreement, agreement, refuse_mismatch
from lightopt.align._observations import Observation, observed_postures, read_observations
from lightopt.align._pixels import view_of_placed
from lightopt.align._placement import Placement, place_part
from lightopt.align._pose import PoseFrame
from lightopt.align._refinement import DARK_SPREAD, GAIN_SPREAD
from lightopt.align._registration import Registration, refine_placement, register

__all__ = [
    "DARK_SPREAD",
    "FLIPS",
    "GAIN_SPREAD",
    "HUBER",
    "Agreement",
    "Limits",
    "Observation",
    "Placement",
    "PlacementInFile",
    "PoseFrame",
    "Problem",
    "Registration",
    "Solution",
    "agreement",
    "linear_problem",
    "observed_postures",
    "place_part",
    "placement_in_file",
    "read_observations",
    "refine_placement",
    "refuse_mismatch",
    "register",
    "solve",
    "view_of_placed",
]
