"""How a surface reflects: Lambert's diffuse and Torrance–Sparrow's specular component. Pure functions of numbers.

A model is a scalar function compiled as a kernel, called per surface point and point light by the kernels of
:mod:`lightopt.rendering`; it knows neither meshes nor rigs.
"""

from lightopt.reflectance._models import (
    MAX_LOBE_EXPONENT,
    MIN_COS_VIEW,
    half_vector_angle_squared,
    lambert,
    torrance_sparrow,
)
from lightopt.reflectance._reflectance import Reflectance

__all__ = [
    "MAX_LOBE_EXPONENT",
    "MIN_COS_VIEW",
    "Reflectance",
    "half_vector_angle_squared",
    "lambert",
    "torrance_sparrow",
]
