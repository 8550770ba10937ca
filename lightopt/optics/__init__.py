"""How a surface reflects: Lambert's diffuse and Torrance–Sparrow's specular component. Pure functions of numbers.

A model is a scalar function compiled as a kernel, called per surface point and point light by the kernels of
:mod:`lightopt.rendering`; it knows neither meshes nor rigs.
"""

from lightopt.optics._reflection_model import (
    MAX_LOBE_EXPONENT,
    MIN_COS_VIEW,
    Reflectance,
    lambert,
    specular_cosine,
    specular_lobe,
)
from lightopt.optics._saturated_region import saturated_region
from lightopt.optics._sensor import Sensor, expose, image_rng, saturated

__all__ = [
    "MAX_LOBE_EXPONENT",
    "MIN_COS_VIEW",
    "Reflectance",
    "Sensor",
    "expose",
    "image_rng",
    "lambert",
    "saturated",
    "saturated_region",
    "specular_cosine",
    "specular_lobe",
]
