"""How the stage holds the part."""

from __future__ import annotations

from pydantic import Field

from lightopt.config._fields import Azimuth, Frozen, Tilt


class PostureConfig(Frozen):
    """One posture of the stage."""

    elevation_deg: Tilt = Field(description="Tilt of the cradle about X [deg].")
    rotation_deg: Azimuth = Field(description="Rotation of the part about the stage's own axis [deg].")
