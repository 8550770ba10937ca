"""Measured poses in a rig file: of the camera, of a panel, and the axes of the stage."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field, ValidatorFunctionWrapHandler, field_validator

from lightopt.config import _fields as fields
from lightopt.config._fields import LIST, Frozen, complaint, expecting

LARGEST_TILT_FROM_X_DEG = 30.0

POSE_REPLACES = ("distance_mm", "elevation_deg", "azimuth_deg")
"""Keys that a pose takes the place of, for the camera also its roll."""


class CameraPoseConfig(Frozen):
    """Where the camera is, as it was measured."""

    frame: Literal["world"] = "world"
    """Frame of the pose: world."""
    position_mm: fields.Coordinates
    """The pinhole [mm]."""
    rotation_vector_deg: fields.Coordinates
    """Axis of the rotation from the camera's own axes (x right and y down in the image, z ahead) to the world's, as
    long as its angle [deg]."""


class PanelPoseConfig(Frozen):
    """Where a panel is, as it was measured."""

    frame: Literal["world"] = "world"
    """Frame of the pose: world."""
    centre_mm: fields.Coordinates
    """Centre of the panel [mm]."""
    rotation_vector_deg: fields.Coordinates
    """Axis of the rotation from the panel's own axes (x and y along its sides, z away from where it shines) to the
    world's, as long as its angle [deg]."""


_Scale = fields.Positive
_SCALE = "Degrees that the axis turns per degree of its reading."


class TiltAxisConfig(Frozen):
    """The axis of the tilt cradle, as it was measured."""

    point_mm: fields.Coordinates | None = None
    """A point of the axis, world frame [mm]; pivot_mm if absent."""
    direction: fields.Coordinates = (1.0, 0.0, 0.0)
    """Direction of the axis, of any length; the world's X is its projection."""
    scale: _Scale = Field(default=1.0, description=_SCALE)

    @field_validator("direction")
    @classmethod
    def _about_x(cls, direction: tuple[float, float, float]) -> tuple[float, float, float]:
        length = math.hypot(*direction)
        if length == 0.0 or direction[0] < length * math.cos(math.radians(LARGEST_TILT_FROM_X_DEG)):
            found = ", ".join(f"{c:g}" for c in direction)
            expected = f"a direction within {LARGEST_TILT_FROM_X_DEG:g} degrees of X, such as [1, 0, 0.002]"
            raise complaint(f"expected {expected}, found [{found}]")
        return direction


class RotaryAxisConfig(Frozen):
    """The rotary axis, as it was measured; it defines the world's Z."""

    scale: _Scale = Field(default=1.0, description=_SCALE)


_Interval = Annotated[tuple[fields.Number, fields.Number], LIST, expecting("[low, high]")]


class CalibrationConfig(Frozen):
    """Where the measured values of this file come from."""

    covariance: fields.Text
    """File of the joint covariance of all measured values, .npz; relative to this file."""
    intervals: dict[str, _Interval] = Field(default={})
    """95 % interval [low, high] of each measured value, by its key."""


def standing_at(point: object) -> dict[str, float]:
    """Distance [mm], elevation and azimuth [deg] of a point of a file, seen from the origin; nothing for no point."""
    values = fields.entries(point)
    if len(values) != 3 or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in values):
        return {}
    x, y, z = (float(v) for v in values if isinstance(v, (int, float)))
    elevation, azimuth = math.degrees(math.atan2(z, math.hypot(x, y))), math.degrees(math.atan2(y, x))
    spherical = (math.hypot(x, y, z), elevation, azimuth)
    return {key: round(value, 6) for key, value in zip(POSE_REPLACES, spherical, strict=True)}


def with_pose(
    value: object, handler: ValidatorFunctionWrapHandler, *, point: str, what: str, also: Sequence[str] = ()
) -> Any:
    """Validate a mapping that may have a pose, by the key `point`, instead of other keys, which are filled in."""
    raw = fields.mapping(value)
    if raw.get("pose") is None:
        return handler(value)
    complaints: list[fields.Complaint] = [
        ((key,), "given together with pose; expected only one of them") for key in (*POSE_REPLACES, *also) if key in raw
    ]
    standing = standing_at(fields.mapping(raw["pose"]).get(point))
    if standing and standing["elevation_deg"] <= 0.0:
        complaints.append((("pose", point), f"{what} is not above the table: expected a z above 0"))
        standing = {}
    filled = {"distance_mm": 1.0, "elevation_deg": 90.0, "azimuth_deg": 0.0} | standing
    return fields.with_complaints({**raw, **{k: v for k, v in filled.items() if k not in raw}}, handler, complaints)
