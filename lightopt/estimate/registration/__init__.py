"""Registration: read measured images, check them against rig and part, and find the part's placement on the stage.

Entry: ``register(scene, observations, caster=...) -> Registration``, with observations from ``read_observations``.
"""

from lightopt.estimate.registration._image_checks import FLIPS, LEVEL_CAP, Agreement, agreement, refuse_mismatch
from lightopt.estimate.registration._observations import Observation, observed_postures, read_observations
from lightopt.estimate.registration._pixels import view_of_placed
from lightopt.estimate.registration._placement import (
    PartFilePlacement,
    Placement,
    PoseFrame,
    part_file_placement,
    place_part,
)
from lightopt.estimate.registration._refinement import DARK_SPREAD, GAIN_SPREAD
from lightopt.estimate.registration._registration import Registration, register

__all__ = [
    "DARK_SPREAD",
    "FLIPS",
    "GAIN_SPREAD",
    "LEVEL_CAP",
    "Agreement",
    "Observation",
    "PartFilePlacement",
    "Placement",
    "PoseFrame",
    "Registration",
    "agreement",
    "observed_postures",
    "part_file_placement",
    "place_part",
    "read_observations",
    "refuse_mismatch",
    "register",
    "view_of_placed",
]
