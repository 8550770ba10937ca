"""A rig file: camera, lights, stage and hardware."""

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, ValidatorFunctionWrapHandler, field_validator

from lightopt.config import _fields as fields
from lightopt.config._camera import CameraConfig
from lightopt.config._hardware import HardwareConfig, misfits
from lightopt.config._lights import LightConfig, LightSourceConfig, auto_sums


class StageConfig(fields.Frozen):
    """The stage that turns the part: a rotary axis (about Z) carried by a tilt cradle (about X)."""

    pivot_mm: fields.Coordinates = Field(
        default=(0.0, 0.0, 0.0), description="Point that both axes pass through, world frame [mm]."
    )
    elevation_range_deg: fields.TiltRange = Field(
        default=(-180.0, 180.0), description="Tilts [low, high] that the stage reaches [deg]."
    )
    rotation_range_deg: fields.AzimuthRange = Field(
        default=(-360.0, 360.0), description="Rotations [low, high] that the stage reaches [deg]."
    )


class RigConfig(fields.FileConfig):
    """A rig: one camera, the lights around the table, and the stage that holds the part."""

    format: Literal["lightopt-rig/1"] = Field(description="Kind and version of this file: lightopt-rig/1.")
    name: fields.Text = Field(description="Name of the rig, for people.")
    camera: CameraConfig = Field(description="The camera.")
    light_source: LightSourceConfig = Field(description="The panel that all lights share.")
    lights: Annotated[tuple[LightConfig, ...], Field(strict=False, min_length=1, max_length=1000)] = Field(
        description="The lights, at least one."
    )
    stage: StageConfig = Field(default=StageConfig(), description="The stage; unlimited about the origin if absent.")
    hardware: HardwareConfig | None = Field(
        default=None, description="The devices behind camera, lights and stage; absent is the virtual bench."
    )

    @field_validator("lights", mode="wrap")
    @classmethod
    def _fit_together(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        lights, shared = fields.entries(value), info.data.get("light_source")
        complaints = [*fields.same_names(lights, "lights", str.lower), *auto_sums(lights, shared)]
        return fields.with_complaints(value, handler, complaints)

    @field_validator("hardware", mode="wrap")
    @classmethod
    def _wired(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        lights: tuple[LightConfig, ...] | None = info.data.get("lights")
        names = None if lights is None else tuple(light.name for light in lights)
        return fields.with_complaints(value, handler, misfits(value, names, info.data.get("camera")))
