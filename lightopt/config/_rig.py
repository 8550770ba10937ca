"""A rig file: camera, lights, stage and hardware."""

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, ValidatorFunctionWrapHandler, field_validator, model_validator

from lightopt.config import _fields as fields
from lightopt.config._camera import CameraConfig
from lightopt.config._hardware import HardwareConfig, misfits
from lightopt.config._pose import CalibrationConfig, PanelPoseConfig, RotaryAxisConfig, TiltAxisConfig, with_pose

_Normalisation = Literal["mean", "sum"]
_Falloff = Literal["none", "inverse_square"]
_Exponent = Annotated[float, Field(ge=0, le=1000), fields.expecting("a number from 0 to 1000")]
_AUTO_SUM = "sum cannot be used with points: auto, a continuous panel; use mean"


class LightSourceConfig(fields.Frozen):
    """A rectangular panel of light, and the point lights that stand for it."""

    size_mm: fields.Size
    """Size of the panel along the azimuth and along the elevation [mm]."""
    points: fields.Points
    """Point lights of the panel: a square number (1, 4, 9, 16, ...), or auto for the converged panel."""
    normalisation: _Normalisation = Field(default="mean", validate_default=True)
    """mean: the points share the output of the panel; sum: each point counts in full, so brightness grows with the
    number of points."""
    falloff: _Falloff = "none"
    """none: brightness does not depend on the distance; inverse_square: it does, and is unchanged at
    reference_distance_mm."""
    reference_distance_mm: fields.Length | None = None
    """inverse_square: distance at which brightness is unchanged [mm]; of the panel's centre to the origin if absent, so
    that a panel moved away is not dimmer there."""
    emission_exponent: _Exponent = 0.0
    """Exponent n of the panel's emission, cosⁿ of the angle to its axis; 0 is uniform."""

    @field_validator("normalisation")
    @classmethod
    def _finite(cls, normalisation: str, info: ValidationInfo) -> str:
        if normalisation == "sum" and info.data.get("points") == "auto":
            raise fields.complaint(_AUTO_SUM)
        return normalisation


class LightConfig(fields.Frozen):
    """One panel light, which faces the origin or has a measured pose; it may have any key of light_source, too."""

    name: fields.FileName
    """Name of the light; it becomes a file name and differs from the others."""
    distance_mm: fields.Length
    """Distance from the origin to the panel's centre [mm]."""
    elevation_deg: fields.Elevation
    """Elevation of the panel's centre above the table plane [deg]; 90 is straight above."""
    azimuth_deg: fields.Azimuth
    """Azimuth of the panel's centre about Z, from X [deg]."""
    pose: PanelPoseConfig | None = None
    """Measured pose, in place of distance_mm, elevation_deg and azimuth_deg. Where the light has ranges, it moves about
    the origin from there."""
    elevation_range_deg: fields.ElevationRange | None = None
    """Elevations [low, high] that the light can be moved to [deg]; fixed if absent."""
    azimuth_range_deg: fields.AzimuthRange | None = None
    """Azimuths [low, high] that the light can be moved to [deg]; fixed if absent."""
    gain: fields.Coefficient = 1.0
    """Factor on the brightness of this light."""
    size_mm: fields.Size | None = None
    """Size of this panel along azimuth and elevation [mm]; as light_source if absent."""
    points: fields.Points | None = None
    """Point lights of this panel, a square or auto; as light_source if absent."""
    normalisation: _Normalisation | None = None
    """mean or sum for this light; as light_source if absent."""
    falloff: _Falloff | None = None
    """none or inverse_square for this light; as light_source if absent."""
    reference_distance_mm: fields.Length | None = None
    """Distance at which this light's brightness is unchanged [mm]; as light_source."""
    emission_exponent: _Exponent | None = None
    """Emission exponent of this light; as light_source if absent."""

    @model_validator(mode="wrap")
    @classmethod
    def _placed(cls, value: object, handler: ValidatorFunctionWrapHandler) -> Any:
        return with_pose(value, handler, point="centre_mm", what="the panel's centre")

    @field_validator("elevation_range_deg", "azimuth_range_deg")
    @classmethod
    def _holds_the_light(cls, ends: tuple[float, float] | None, info: ValidationInfo) -> tuple[float, float] | None:
        angle = str(info.field_name).replace("_range", "")
        now = info.data.get(angle)
        if ends is not None and now is not None and not ends[0] <= now <= ends[1]:
            outside = f"outside [{ends[0]:g}, {ends[1]:g}]; widen the range or move the light into it"
            raise fields.complaint(f"the light is at {angle} {now:g}, {outside}")
        return ends


def _auto_sums(lights: Sequence[object], shared: LightSourceConfig | None) -> Iterator[fields.Complaint]:
    """Complaints about lights whose points and normalisation, their own or the shared ones, exclude each other."""
    for i, light in enumerate(lights):
        own = {key: fields.value_of(light, key) for key in ("points", "normalisation")}
        if shared is None or own == {"points": None, "normalisation": None}:
            continue
        both = {key: getattr(shared, key) if value is None else value for key, value in own.items()}
        if both == {"points": "auto", "normalisation": "sum"}:
            key = "normalisation" if own["normalisation"] is not None else "points"
            yield (i, key), own[key], fields.complaint(_AUTO_SUM)


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


class VirtualBenchConfig(fields.Frozen):
    """What the virtual bench has in place of what its files say; only lightopt capture reads it."""

    rig: fields.Text | None = None
    """Rig file with the true camera, lights, stage and sensor, of the same light names and resolution; relative to this
    file."""
    seed: Annotated[int, Field(ge=0, le=2**63 - 1), fields.expecting("a whole number from 0 up")] = 1
    """Seed of the noise, and of the waviness of the part's surface."""
    rays: Annotated[int, Field(ge=1, le=8), fields.expecting("a whole number from 1 to 8")] = 1
    """Rays along each side of a pixel, which shows their mean; 1 is the pixel's centre alone."""
    part_offset_mm: fields.Coordinates = (0.0, 0.0, 0.0)
    """How far the part is from its place, world frame at posture (0, 0) [mm]."""
    part_rotation_vector_deg: fields.Coordinates = (0.0, 0.0, 0.0)
    """Rotation of the part from its place about the origin, before the offset: its axis, as long as its angle [deg]."""


class RigConfig(fields.FileConfig):
    """A rig: one camera, the lights around the table, and the stage that holds the part."""

    format: Literal["lightopt-rig/1"]
    """Kind and version of this file: lightopt-rig/1."""
    name: fields.Text
    """Name of the rig, for people."""
    camera: CameraConfig
    """The camera."""
    light_source: LightSourceConfig
    """The panel that all lights share."""
    lights: Annotated[tuple[LightConfig, ...], Field(strict=False, min_length=1, max_length=1000)]
    """The lights, at least one."""
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
    def _fit_together(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        lights, shared = fields.entries(value), info.data.get("light_source")
        complaints = [*fields.same_names(lights, "lights", str.lower), *_auto_sums(lights, shared)]
        return fields.with_complaints(value, handler, complaints)

    @field_validator("hardware", mode="wrap")
    @classmethod
    def _wired(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        lights: tuple[LightConfig, ...] | None = info.data.get("lights")
        names = None if lights is None else tuple(light.name for light in lights)
        return fields.with_complaints(value, handler, misfits(value, names, info.data.get("camera")))
