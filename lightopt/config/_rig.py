"""A rig file: camera, lights, stage and hardware."""

from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import Field, PrivateAttr, ValidationInfo, field_serializer, field_validator, model_validator

from lightopt.config import _fields as fields, _light
from lightopt.config._camera import CameraConfig
from lightopt.config._hardware import HardwareConfig, misfits
from lightopt.config._pose import CalibrationConfig, RotaryAxisConfig, TiltAxisConfig


class MotionConfig(fields.Frozen):
    """How the part moves while the camera exposes: on a conveyor, or on a table that has not settled."""

    velocity_mm_per_s: fields.Coordinates = (0.0, 0.0, 0.0)
    """Velocity of the part, world frame [mm/s]."""
    rotation_deg_per_s: fields.Number = 0.0
    """Speed of the rotary axis [deg/s]."""


class StageConfig(fields.Frozen):
    """The stage that turns the part: a rotary axis (about Z) carried by a tilt cradle (about X)."""

    pivot_mm: fields.Coordinates = (0.0, 0.0, 0.0)
    """Point that both axes pass through, world frame [mm]."""
    elevation_range_deg: fields.TiltRange = (-180.0, 180.0)
    """Tilts [low, high] that the stage reaches [deg]."""
    rotation_range_deg: fields.AzimuthRange = (-360.0, 360.0)
    """Rotations [low, high] that the stage reaches [deg]."""
    tilt_axis: TiltAxisConfig | None = None
    """Measured axis of the cradle; along X through pivot_mm if absent."""
    rotary_axis: RotaryAxisConfig | None = None
    """Measured scale of the rotary axis."""
    motion: MotionConfig | None = None
    """The part's motion while the camera exposes, for camera.exposure_us at exposure 1; at rest if absent."""


class HousingsConfig(fields.Frozen):
    """Housings of the lights: rectangles in whose middle the flat lights shine."""

    margin_mm: Annotated[float, Field(ge=0, le=1e4), fields.expecting("a length from 0 to 10000 (a number)")]
    """How far a housing reaches beyond the light on each side [mm]."""
    level: fields.Coefficient = 0.0
    """Level of the housings in images of a light of gain 1, whichever light is on [levels of the part's full_scale]."""


class EnvironmentConfig(fields.Frozen):
    """What surrounds part and rig, and is mirrored by the part."""

    level: fields.Coefficient = 0.0
    """Level of the surroundings in images of a light of gain 1, in all directions [levels of the part's full_scale]."""
    housings: HousingsConfig | None = None
    """Housings of panels, bars, backlights, displays and LED arrays, mirrored in place of `level`; none if absent."""


class VirtualBenchConfig(fields.Frozen):
    """What the virtual bench has in place of what its files say; only lightopt capture reads it."""

    rig: fields.Text | None = None
    """Rig file with the true camera, lights, stage and sensor, of the same light names and resolution."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1), fields.expecting("a whole number from 0 up")] = 1
    """Seed of the noise, and of the waviness of the part's surface."""
    rays: Annotated[int, Field(ge=1, le=8), fields.expecting("a whole number from 1 to 8")] = 1
    """Rays along each side of a pixel, which shows their mean; 1 is the pixel's centre alone."""
    bounces: fields.Bounces = 0
    """How often light goes from the part to the part before it reaches the camera; 0 is direct light alone."""
    part_offset_mm: fields.Coordinates = (0.0, 0.0, 0.0)
    """How far the part is from its place, world frame at posture (0, 0) [mm]."""
    part_rotation_vector_deg: fields.Coordinates = (0.0, 0.0, 0.0)
    """Rotation of the part from its place about the origin, before the offset: its axis, as long as its angle [deg]."""


_Programme = Annotated[tuple[_light.ProgrammeImageConfig, ...], Field(strict=False, min_length=1, max_length=1000)]


class RigConfig(fields.FileConfig):
    """A rig: one camera, the lights around the table, and the stage that holds the part."""

    format: Literal["lightopt-rig/1"]
    """Kind and version of this file: lightopt-rig/1."""
    name: fields.Text
    """Name of the rig, for people."""
    camera: CameraConfig
    """The camera."""
    light_source: _light.LightSourceConfig | None = None
    """The panel that all panel lights share."""
    lights: Annotated[tuple[_light.LightConfig, ...], Field(strict=False, min_length=1, max_length=1000)]
    """The lights, at least one."""
    programme: _Programme | None = None
    """Images, each of some of the lights with weights, that take the place of one image per light in every command."""
    environment: EnvironmentConfig = EnvironmentConfig()
    """What surrounds the rig; black if absent."""
    stage: StageConfig = StageConfig()
    """The stage; unlimited about the origin if absent."""
    calibration: CalibrationConfig | None = None
    """Covariance and intervals of measured values, as lightopt calibrate writes them."""
    hardware: HardwareConfig | None = None
    """The devices behind camera, lights and stage; absent is the virtual bench."""

    virtual_bench: VirtualBenchConfig | None = None
    """How the virtual bench differs from this file; as the file says if absent."""

    @field_validator("lights", mode="wrap")
    @classmethod
    def _fit_together(cls, value: object, handler: fields.Handler, info: ValidationInfo) -> Any:
        lights, shared = fields.entries(value), info.data.get("light_source")
        complaints = [*fields.same_names(lights, "lights", str.lower), *_light.auto_sums(lights, shared)]
        if "light_source" in info.data and shared is None:
            panels = (i for i, light in enumerate(lights) if (fields.value_of(light, "kind") or "panel") == "panel")
            reason = 'missing key "light_source": the panel that all panel lights share'
            complaints += [((i,), reason) for i in panels]
        # each channel becomes a light, unless that has been done
        found = fields.with_complaints(value, handler, complaints)
        return found if any(light.channel for light in found) else _light.expanded(found)

    _channels: tuple[_light.LightConfig, ...] = PrivateAttr(default=())

    @property
    def channels(self) -> tuple[_light.LightConfig, ...]:
        """The lights that are switched on one by one or together: `lights`, unless a programme mixes them."""
        return self._channels or self.lights

    def exposures(self, light: str, of_command: tuple[float, ...]) -> tuple[float, ...]:
        """Exposures of a light's images: those that the programme gives it, else those of the command."""
        own = next((one.exposures for one in self.lights if one.name == light), None)
        return of_command if own is None else own

    def without_programme(self) -> "RigConfig":
        alone = self.model_copy(update={"lights": self.channels, "programme": None})
        alone._channels = ()
        alone._source = replace(self._source, entries=tuple(light.entry for light in self.channels))
        return alone

    @model_validator(mode="after")
    def _programmed(self) -> "RigConfig":
        if self.programme is not None:
            # from here on, the images are the lights
            self._channels = self.lights
            object.__setattr__(self, "lights", _light.programme_lights(self.programme, self.lights))
        return self

    @field_validator("programme", mode="wrap")
    @classmethod
    def _of_its_lights(cls, value: object, handler: fields.Handler, info: ValidationInfo) -> Any:
        lights = info.data.get("lights")
        return fields.with_complaints(value, handler, () if lights is None else _light.programme_misfits(value, lights))

    @field_validator("environment", mode="wrap")
    @classmethod
    def _housed(cls, value: object, handler: fields.Handler, info: ValidationInfo) -> Any:
        lights: tuple[_light.LightConfig, ...] | None = info.data.get("lights")
        given = fields.value_of(value, "housings") is not None
        reason = f"no light of the rig has a rectangle for its housing; kinds that have one: {', '.join(_light.HOUSED)}"
        alone = given and lights is not None and not any(light.kind in _light.HOUSED for light in lights)
        return fields.with_complaints(value, handler, [(("housings",), reason)] if alone else ())

    @field_validator("stage", mode="wrap")
    @classmethod
    def _timed(cls, value: object, handler: fields.Handler, info: ValidationInfo) -> Any:
        camera = info.data.get("camera")
        moves = fields.value_of(value, "motion") is not None
        reason = "the rig's camera has no exposure_us; add the exposure time [µs] that counts as exposure 1"
        untimed = moves and camera is not None and camera.exposure_us is None
        return fields.with_complaints(value, handler, [(("motion",), reason)] if untimed else ())

    @field_serializer("lights")
    def _entries(self, _: tuple[_light.LightConfig, ...]) -> list[dict[str, Any]]:
        # as in a file: channels of a light are one entry
        return [{**light.model_dump(), "name": light.entry_name} for light in self.channels if light.channel == 0]

    @field_validator("hardware", mode="wrap")
    @classmethod
    def _wired(cls, value: object, handler: fields.Handler, info: ValidationInfo) -> Any:
        lights: tuple[_light.LightConfig, ...] | None = info.data.get("lights")
        return fields.with_complaints(value, handler, misfits(value, lights, info.data.get("camera")))
