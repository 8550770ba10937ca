"""The data sheet of a sensor by EMVA Standard 1288, release 4.0."""

from typing import Annotated, Literal

from pydantic import Field

from lightopt.config import _fields as fields

_Electrons = Annotated[float, Field(ge=0, le=1e6), fields.expecting("electrons, from 0 to 1e6")]
_Percent = Annotated[float, Field(ge=0, le=50), fields.expecting("per cent, from 0 to 50")]
Efficiency = Annotated[float, Field(gt=0, le=100), fields.expecting("per cent, above 0 up to 100")]


class SensorSheetConfig(fields.FileConfig):
    """What a sensor's data sheet says, in the standard's units."""

    format: Literal["lightopt-sensor/1"]
    """Kind and version of this file: lightopt-sensor/1."""
    name: fields.Text
    """Name of the sensor, for people."""
    quantum_efficiency_percent: Efficiency
    """Quantum efficiency η at the wavelength of the light [%]."""
    saturation_capacity_e: Annotated[float, Field(ge=1, le=1e9), fields.expecting("electrons, from 1 to 1e9")]
    """Saturation capacity μe.sat [electrons]."""
    dark_noise_e: _Electrons
    """Temporal dark noise σd [electrons]."""
    levels_per_electron: fields.Positive | None = None
    """System gain K at the rig's bit depth and gain [levels per electron]; if absent, such that the saturation capacity
    makes the saturation level."""
    dark_current_e_per_s: Annotated[float, Field(ge=0, le=1e9), fields.expecting("electrons per second")] = 0.0
    """Dark current μI [electrons per second]."""
    dsnu_e: _Electrons = 0.0
    """Dark signal non-uniformity DSNU1288 [electrons]."""
    prnu_percent: _Percent = 0.0
    """Photo response non-uniformity PRNU1288 [%]."""
    linearity_error_percent: Annotated[float, Field(ge=0, le=10), fields.expecting("per cent, from 0 to 10")] = 0.0
    """Linearity error LE [%]."""
