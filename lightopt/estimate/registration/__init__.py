"""Registration: read measured images, check them against rig and part, and find the part's placement on the stage.

Entry: ``register(scene, observations, caster=...) -> Registration``, with observations from ``read_observations``.
"""

from ._image_checks import (
    FLIPS,
    LEVEL_CAP,
    Agreement,
    agreement,
    dark_as_predicted,
    refuse_mismatch,
    refuse_useless_images,
)
from ._observations import Observation, observed_postures, read_observations
from ._placement import (
    LEAST_R_D,
    LEAST_R_S,
    PixelSet,
    Placement,
    PoseFrame,
    light_at,
    part_file_placement,
    place_part,
    sensor_scale,
    shares_seen,
    view_of_placed,
)
from ._refinement import DARK_SPREAD, GAIN_SPREAD, random_pixels
from ._registration import Registration, register
