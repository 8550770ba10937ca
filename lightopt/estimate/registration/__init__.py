"""Registration: read measured images, check them against rig and part, and find the part's placement on the stage.

Entry: ``register(scene, observations, caster=...) -> Registration``, with observations from ``read_observations``.
"""

from lightopt.estimate.registration._image_checks import (
    FLIPS as FLIPS,
    LEVEL_CAP as LEVEL_CAP,
    Agreement as Agreement,
    agreement as agreement,
    refuse_mismatch as refuse_mismatch,
    refuse_useless_images as refuse_useless_images,
)
from lightopt.estimate.registration._observations import (
    Observation as Observation,
    observed_postures as observed_postures,
    read_observations as read_observations,
)
from lightopt.estimate.registration._placement import (
    LEAST_R_D as LEAST_R_D,
    LEAST_R_S as LEAST_R_S,
    PixelSet as PixelSet,
    Placement as Placement,
    PoseFrame as PoseFrame,
    light_at as light_at,
    part_file_placement as part_file_placement,
    place_part as place_part,
    sensor_scale as sensor_scale,
    view_of_placed as view_of_placed,
)
from lightopt.estimate.registration._refinement import (
    DARK_SPREAD as DARK_SPREAD,
    GAIN_SPREAD as GAIN_SPREAD,
    random_pixels as random_pixels,
)
from lightopt.estimate.registration._registration import Registration as Registration, register as register
