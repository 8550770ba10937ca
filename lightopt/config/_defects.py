"""Defects in a part file: the kinds to plan for, and those that are on this part."""

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationInfo

from lightopt import defects
from lightopt.config import _fields as fields

_Extent = Annotated[float, Field(ge=1e-3, le=1e3)]
_Size = Annotated[
    _Extent | Annotated[tuple[_Extent, _Extent], fields.LIST],
    fields.expecting("a diameter, or [length, width], in mm from 0.001 to 1000"),
]
_Slope = Annotated[float, Field(gt=0, le=60), fields.expecting("a number above 0, up to 60 (degrees)")]
_Depth = Annotated[float, Field(gt=0, le=1e3), fields.expecting("a number above 0, up to 1000 (mm)")]
_NOT_1 = fields.that(lambda factor: factor != 1.0, "expected a number other than 1: with 1 there is no defect")
_Factor = Annotated[float, Field(ge=0, le=100), _NOT_1, fields.expecting("a number from 0 to 100")]
_WidthFactor = Annotated[float, Field(ge=0.01, le=100), _NOT_1, fields.expecting("a number from 0.01 to 100")]
_Factor10 = Annotated[float, Field(ge=0.1, le=10)]
_LEAST_GREATEST = "[least, greatest], two numbers from 0.1 to 10, such as [0.5, 2]"
_Range = Annotated[tuple[_Factor10, _Factor10], fields.LIST, fields.ASCENDING, fields.expecting(_LEAST_GREATEST)]
_Turn = Annotated[float, Field(ge=-360, le=360), fields.expecting("a number from -360 to 360 (degrees)")]
_PixelIndex = Annotated[int, Field(ge=0, le=65535)]


class PixelPlaceConfig(fields.Frozen):
    """A place on the part as a pixel of the rig's camera sees it."""

    posture: fields.PostureConfig
    """Posture in which the pixel sees the part."""
    pixel: Annotated[
        tuple[_PixelIndex, _PixelIndex],
        fields.LIST,
        fields.expecting("[column, row], two whole numbers from 0 to 65535; the top left pixel is [0, 0]"),
    ]
    """Column and row of the pixel, counted from 0 at the top left; the defect is at its centre."""


class CatalogueEntryConfig(fields.Frozen):
    """A kind of defect that the inspection is planned for; it may lie anywhere and in any direction."""

    variants = fields.Variants(
        "kind",
        {
            **dict.fromkeys(defects.SHAPE_KINDS, ((), ("slope_deg", "depth_mm"))),
            "stain": (("R_d_factor",), ()),
            "haze": (("sigma_factor",), ()),
        },
    )

    name: fields.Text
    """Name of the defect, for people; no two in the list are the same."""
    kind: defects.DefectKind
    """scratch (a groove), dent, bump, pit (a steep cone), blister (flat-topped), stain (R_d) or haze (sigma)."""
    size_mm: _Size
    """Diameter, or [length, width] with the length along the direction, at least the width [mm]. A scratch has both."""
    slope_deg: _Slope | None = None
    """Steepest slope of the walls [deg], up to 60. Shapes have this or depth_mm; the other follows."""
    depth_mm: _Depth | None = None
    """Depth, or height of bumps and blisters [mm]. Shapes have this or slope_deg; the other follows."""
    R_d_factor: _Factor | None = None
    """Stains: factor on R_d; not 1."""
    sigma_factor: _WidthFactor | None = None
    """Hazes: factor on sigma; not 1. R_s is divided by its square: the lobe reflects as much light as before."""

    @fields.rule("size_mm")
    def _longer_first(cls, size: float | tuple[float, float], info: ValidationInfo) -> Iterator[fields.Fault]:
        if isinstance(size, tuple) and size[0] < size[1]:
            reason = f"expected [length, width] with the length at least the width, found [{size[0]:g}, {size[1]:g}]"
            yield f"{reason}; direction_deg turns it"
        if info.data.get("kind") == "scratch" and (not isinstance(size, tuple) or size[0] == size[1]):
            yield "expected [length, width] of a scratch, the length above the width"

    @fields.rule("depth_mm")
    def _steep(cls, depth: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        kind, size = info.data.get("kind"), info.data.get("size_mm")
        if depth is not None and size is not None and kind in defects.SHAPE_KINDS:
            width = _extents(size)[1]
            slope_found = defects.slope_of_depth(kind, width, depth)
            if slope_found > defects.MAX_SLOPE:
                deepest = defects.depth_of_slope(kind, width, defects.MAX_SLOPE)
                walls = f"has walls of {math.degrees(slope_found):.0f} degrees; expected at most {deepest:.3g} mm"
                yield f"a {kind} {width:g} mm wide and {depth:g} mm deep {walls}, which is 60 degrees"

    @classmethod
    def misfits(cls, raw: Mapping[str, Any]) -> Iterator[fields.Complaint]:
        """As of every configuration; shapes have a slope or a depth."""
        yield from super().misfits(raw)
        if raw.get("kind") in defects.SHAPE_KINDS:
            yield from fields.one_of_misfits(("slope_deg", "depth_mm"), raw)

    @property
    def shape(self) -> defects.DefectShape:
        """The defect without its place, in mm and radians."""
        length, width = _extents(self.size_mm)
        slope = _slope(self.kind, self.size_mm, self.slope_deg, self.depth_mm)
        factors = {"R_d_factor": self.R_d_factor, "sigma_factor": self.sigma_factor}
        given = {name: factor for name, factor in factors.items() if factor is not None}
        return defects.DefectShape(kind=self.kind, length=length, width=width, slope=slope, **given)


class PlannedDefectConfig(CatalogueEntryConfig):
    """A kind of defect in a catalogue, of one size and slope or of ranges of them."""

    size_range: _Range = (1.0, 1.0)
    """Least and greatest size, as multiples of size_mm; all of that size if absent."""
    slope_range: _Range = (1.0, 1.0)
    """Least and greatest slope of the walls, as multiples of slope_deg or depth_mm; that slope if absent."""

    @fields.rule("slope_range")
    def _not_too_steep(cls, value: tuple[float, float], info: ValidationInfo) -> Iterator[fields.Fault]:
        kind, size, slope, depth = (info.data.get(key) for key in ("kind", "size_mm", "slope_deg", "depth_mm"))
        if kind in defects.SHAPE_KINDS:
            steepest, most = value[1] * math.degrees(_slope(kind, size, slope, depth)), math.degrees(defects.MAX_SLOPE)
            if steepest > most + 1e-9:
                yield f"the steepest walls would be {steepest:.0f} degrees; expected at most {most:g}"
        elif kind is not None and value != (1.0, 1.0):
            yield f"a {kind} has no slope; remove this key"

    @property
    def entry(self) -> defects.CatalogueEntry:
        """The kind of defect, in mm and radians."""
        return defects.CatalogueEntry(self.name, self.shape, sizes=self.size_range, slopes=self.slope_range)


class DefectConfig(CatalogueEntryConfig):
    """A defect that is on the part: what it is, and where."""

    one_of = ("at_mm", "at_pixel")

    at_mm: fields.Coordinates | None = None
    """Its centre in the coordinates of the mesh file, in mm; the nearest point of the surface is used, which must be
    close. Give this or at_pixel."""
    at_pixel: PixelPlaceConfig | None = None
    """Its centre as the pixel of a posture that sees it. Give this or at_mm."""
    direction_deg: _Turn = 0.0
    """Direction of its length in the tangent plane, counterclockwise seen from outside, from the mesh file's X axis
    projected onto that plane, or from Y where the surface faces along X [deg]."""


def _extents(size: float | tuple[float, float]) -> tuple[float, float]:
    return size if isinstance(size, tuple) else (size, size)


def _slope(
    kind: defects.DefectKind, size: float | tuple[float, float] | None, slope_deg: float | None, depth_mm: float | None
) -> float:
    # steepest slope [rad] by the keys that are there, else 0
    if depth_mm is not None and size is not None:
        return defects.slope_of_depth(kind, _extents(size)[1], depth_mm)
    return math.radians(slope_deg or 0.0)
