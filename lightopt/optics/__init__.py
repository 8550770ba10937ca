"""How a surface reflects, what a lens blurs, what a sensor makes of light. Pure functions of numbers.

A model is a scalar function compiled as a kernel, called per surface point and point light by the kernels of
:mod:`lightopt.rendering`; it knows neither meshes nor rigs.
"""

from ._albedo import least_white_level, white_level
from ._exponential import exponential
from ._gaussian_sum import gaussian_sum
from ._lens import airy_diameter, airy_kernel, circle_of_confusion, depth_of_field, pupil_points
from ._reflection_model import (
    EVERYWHERE,
    LAMBERT,
    MAX_LOBE_EXPONENT,
    MIN_COS_VIEW,
    NARROW_CHORD_SQUARED,
    DiffuseForm,
    Lobe,
    ModelName,
    Reflectance,
    SpecularModel,
    diffuse_term,
    farthest_exponent,
    fresnel_factor,
    gaussian_lobe,
    is_lambert,
    lambert,
    light_factor,
    lobe_across,
    lobe_at,
    lobe_beside,
    lobe_of_width,
    narrow_gaussian,
    rough_gaussian,
    round_ggx,
    series_reach,
    specular_divisor,
    specular_lobe,
    square_across,
)
from ._saturated_region import saturated_region
from ._sensor import Sensor, clipped_mean, expose, image_rng, saturated
