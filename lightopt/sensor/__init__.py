"""The camera's sensor: from grey levels to what the camera delivers, with noise where asked."""

from lightopt.sensor._expose import expose, image_rng, saturated
from lightopt.sensor._region import SaturatedRegion, saturated_region
from lightopt.sensor._sensor import Sensor

__all__ = ["SaturatedRegion", "Sensor", "expose", "image_rng", "saturated", "saturated_region"]
