"""What a defect is like, wherever it lies: its kind, size, steepness, and what it does to the coefficients."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

DefectKind = Literal["scratch", "dent", "bump", "pit", "blister", "stain", "haze"]

SHAPE_KINDS: Final = ("scratch", "dent", "bump", "pit", "blister")
"""Kinds that turn the normal; a stain changes R_d, a haze σ."""

DEFECT_KINDS: Final = (*SHAPE_KINDS, "stain", "haze")

MAX_SLOPE: Final = math.radians(60.0)
"""Steeper walls would hide parts of themselves and cast shadows, which defects here do not [rad]."""

BLISTER_TOP: Final = 0.6
"""Share of a blister's radius that is flat."""

BLEND: Final = 0.2
"""Shares of the radius over which the walls of pits and scratches are rounded at the bottom and at the rim."""


@dataclass(frozen=True, kw_only=True)
class DefectShape:
    """A defect without its place.

    Attributes
    ----------
    kind: scratch, dent, bump, pit, blister, stain or haze
    length, width: Of its outline [mm], the length along its direction, at least the width; equal for a round one. The
        outline is an ellipse, for a scratch a strip with round ends.
    slope: Steepest slope of its walls [rad], where they run along the length; 0 for stains and hazes
    R_d_factor: By which it multiplies R_d
    sigma_factor: By which it multiplies σ
    """

    kind: DefectKind
    length: float
    width: float
    slope: float = 0.0
    R_d_factor: float = 1.0
    sigma_factor: float = 1.0

    @property
    def depth(self) -> float:
        """Greatest depth or height [mm]."""
        return depth_of_slope(self.kind, self.width, self.slope) if self.slope > 0.0 else 0.0

    @property
    def area(self) -> float:
        """Of the outline [mm²]."""
        if self.kind == "scratch":
            return self.width * (self.length - self.width) + 0.25 * math.pi * self.width**2
        return 0.25 * math.pi * self.length * self.width


def depth_of_slope(kind: DefectKind, width: float, slope: float) -> float:
    """Depth or height of a defect [mm] from its steepest slope [rad]: tan(slope) · width/2 · the profile's integral.

    kind: One of :data:`SHAPE_KINDS`
    width: Shorter extent of the outline [mm]

    Examples
    --------
    >>> round(depth_of_slope("dent", 2.0, math.radians(2.0)), 4)
    0.0222
    """
    return math.tan(slope) * 0.5 * width * _rise(kind)


def slope_of_depth(kind: DefectKind, width: float, depth: float) -> float:
    """Steepest slope of a defect [rad] from its depth or height [mm]; the inverse of :func:`depth_of_slope`."""
    return math.atan(depth / (0.5 * width * _rise(kind)))


def _rise(kind: DefectKind) -> float:
    # integral of the relative slope from the centre to the rim, in radii
    if kind in ("dent", "bump"):
        return 2.0 / math.pi
    if kind == "blister":
        return (1.0 - BLISTER_TOP) * 2.0 / math.pi
    return 1.0 - BLEND
