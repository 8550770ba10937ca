"""How a surface reflects: Lambert's diffuse and Torrance–Sparrow's specular component. Pure functions of numbers.

A model is a scalar function compiled as a kernel, called per surface point and point light by the kernels of
:mod:`lightopt.rendering`; it knows neither meshes nor rigs.
"""

from lightopt.optics._albedo import least_white_level as least_white_level, white_level as white_level
from lightopt.optics._reflection_model import (
    MAX_LOBE_EXPONENT as MAX_LOBE_EXPONENT,
    MIN_COS_VIEW as MIN_COS_VIEW,
    NARROW_CHORD_SQUARED as NARROW_CHORD_SQUARED,
    Reflectance as Reflectance,
    lambert as lambert,
    narrow_specular_lobe as narrow_specular_lobe,
    specular_cosine as specular_cosine,
    specular_lobe as specular_lobe,
)
from lightopt.optics._saturated_region import saturated_region as saturated_region
from lightopt.optics._sensor import (
    Sensor as Sensor,
    clipped_mean as clipped_mean,
    expose as expose,
    image_rng as image_rng,
    saturated as saturated,
)
