"""A rig file: camera, lights, stage and hardware."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationInfo, ValidatorFunctionWrapHandler, field_validator

from lightopt.config._camera import CameraConfig
from lightopt.config._fields import AzimuthRange, Coordinates, Frozen, Text, TiltRange, expecting, with_complaints
from lightopt.config._hardware import HardwareConfig, misfits
from lightopt.config._lights import LightConfig, LightSourceConfig, auto_sums, same_names
from lightopt.config._source import Source


class StageConfig(Frozen):
    """The stage that turns the part: a rotary axis (about Z) carried by a tilt cradle (about X)."""

    pivot_mm: Coordinates = Field(
        default=(0.0, 0.0, 0.0), description="Point that both axes pass through, world frame [mm]."
    )
    elevation_range_deg: TiltRange = Field(
        default=(-180.0, 180.0), description="Tilts [low, high] that the stage reaches [deg]."
    )
    rotation_range_deg: AzimuthRange = Field(
        default=(-360.0, 360.0), description="Rotations [low, high] that the stage reaches [deg]."
    )


class RigConfig(Frozen):
    """A rig: one camera, the lights around the table, and the stage that holds the part."""

    format: Annotated[Literal["lightopt-rig/1"], expecting("lightopt-rig/1")] = Field(
        description="Kind and version of this file: lightopt-rig/1."
    )
    name: Text = Field(description="Name of the rig, for people.")
    camera: CameraConfig = Field(description="The camera.")
    light_source: LightSourceConfig = Field(description="The panel that all lights share.")
    lights: Annotated[tuple[LightConfig, ...], Field(strict=False, min_length=1, max_length=1000)] = Field(
        description="The lights, at least one."
    )
    stage: StageConfig = Field(default=StageConfig(), description="The stage; unlimited about the origin if absent.")
    hardware: HardwareConfig | None = Field(
        default=None, description="The devices behind camera, lights and stage; absent is the virtual bench."
    )
    _source: Source = PrivateAttr(default=Source(Path("<built in code>"), ""))

    @property
    def source(self) -> Source:
        """The file this rig was read from."""
        return self._source

    @field_validator("lights", mode="wrap")
    @classmethod
    def _fit_together(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        if not isinstance(value, (list, tuple)):
            return handler(value)
        shared = info.data.get("light_source")
        return with_complaints(value, handler, [*same_names(value), *auto_sums(value, shared)])

    @field_validator("hardware", mode="wrap")
    @classmethod
    def _wired(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        lights: tuple[LightConfig, ...] | None = info.data.get("lights")
        names = None if lights is None else tuple(light.name for light in lights)
        return with_complaints(value, handler, misfits(value, names, info.data.get("camera")))
