"""How a surface reflects: Lambert's diffuse and Torrance–Sparrow's specular component. Pure functions of numbers.

A model is a scalar function compiled as a kernel, called per surface point and point light by the kernels of
:mod:`lightopt.rendering`; it knows neither meshes nor rigs.
"""

from lightopt.optics._reflectance import (
    MAX_LOBE_EXPONENT,
    MIN_COS_VIEW,
    Reflectance,
    half_vector_angle_squared,
    lambert,
    torrance_sparrow,
)
from lightopt.optics._saturated_region import saturated_region
from lightopt.optics._sensor import Sensor, expose, image_rng, saturated

__all__ = [
    "MAX_LOBE_EXPONENT",
    "MIN_COS_VIEW",
    "Reflectance",
    "Sensor",
    "expose",
    "half_vector_angle_squared",
    "image_rng",
    "lambert",
    "saturated",
    "saturated_region",
    "torrance_sparrow",
]
