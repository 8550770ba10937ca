"""How a surface reflects, what a lens blurs, what a sensor makes of light. Pure functions of numbers.

A model is a scalar function compiled as a kernel, called per surface point and point light by the kernels of
:mod:`lightopt.rendering`; it knows neither meshes nor rigs.
"""

from lightopt.optics._albedo import least_white_level as least_white_level, white_level as white_level
from lightopt.optics._gaussian_sum import gaussian_sum as gaussian_sum
from lightopt.optics._lens import (
    airy_diameter as airy_diameter,
    airy_kernel as airy_kernel,
    circle_of_confusion as circle_of_confusion,
    depth_of_field as depth_of_field,
    pupil_points as pupil_points,
)
from lightopt.optics._reflection_model import (
    EVERYWHERE as EVERYWHERE,
    LAMBERT as LAMBERT,
    MAX_LOBE_EXPONENT as MAX_LOBE_EXPONENT,
    MIN_COS_VIEW as MIN_COS_VIEW,
    NARROW_CHORD_SQUARED as NARROW_CHORD_SQUARED,
    DiffuseForm as DiffuseForm,
    Lobe as Lobe,
    ModelName as ModelName,
    Reflectance as Reflectance,
    SpecularModel as SpecularModel,
    diffuse_term as diffuse_term,
    farthest_exponent as farthest_exponent,
    gaussian_lobe as gaussian_lobe,
    is_lambert as is_lambert,
    lambert as lambert,
    light_factor as light_factor,
    lobe_across as lobe_across,
    lobe_at as lobe_at,
    lobe_beside as lobe_beside,
    lobe_of_width as lobe_of_width,
    narrow_gaussian as narrow_gaussian,
    specular_divisor as specular_divisor,
    specular_lobe as specular_lobe,
    square_across as square_across,
)
from lightopt.optics._saturated_region import saturated_region as saturated_region
from lightopt.optics._sensor import (
    Sensor as Sensor,
    clipped_mean as clipped_mean,
    expose as expose,
    image_rng as image_rng,
    saturated as saturated,
)
