"""What a camera measured, laid over the model: images checked against their rig, and the part where it really lies."""

from lightopt.align._in_file import PlacementInFile, placement_in_file
from lightopt.align._observations import Observation, observed_postures, read_observations
from lightopt.align._pixels import view_of_placed
from lightopt.align._placement import Placement, find_placement, place_part, refine_placement

__all__ = [
    "Observation",
    "Placement",
    "PlacementInFile",
    "find_placement",
    "observed_postures",
    "place_part",
    "placement_in_file",
    "read_observations",
    "refine_placement",
    "view_of_placed",
]
