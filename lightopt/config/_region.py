"""Where a region of a part's surface is: by what the mesh file says of its faces, by a box or by a mask."""

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from lightopt.config import _fields as fields

_Colour = Annotated[str, Field(pattern=r"^#[0-9A-Fa-f]{6}$"), fields.expecting('a colour such as "#97FFB5", in quotes')]
_Points = Annotated[tuple[fields.Coordinates, ...], Field(strict=False, min_length=1, max_length=1000)]
_Corner = Annotated[tuple[fields.Number, fields.Number], fields.LIST, fields.expecting("two numbers (mm)")]
_Depth = Annotated[
    tuple[fields.Number, fields.Number], fields.LIST, fields.expecting("[least, greatest], two numbers (mm)")
]


class BoxConfig(fields.Frozen):
    """A box along the axes of the mesh file."""

    low: fields.Coordinates
    """Its lowest X, Y and Z, in the mesh file's coordinates [mm]."""
    high: fields.Coordinates
    """Its highest X, Y and Z, in the mesh file's coordinates [mm]."""

    @field_validator("high")
    @classmethod
    def _above(cls, high: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        low = info.data.get("low")
        if low is not None and any(a >= b for a, b in zip(low, high, strict=True)):
            raise fields.complaint(f"expected three numbers above those of low, {list(low)}, found {list(high)}")
        return high


class MaskConfig(fields.Frozen):
    """A black and white picture that is projected onto the part along an axis of the mesh file."""

    file: fields.Text
    """PNG file, relative to this file: the region is where it is white (more than half). Columns go along the first of
    the two axes across the projection, rows from the last to the first along the second."""
    onto: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    """Which surface it falls on: +z is what faces up, in the mesh file's coordinates."""
    corner_mm: _Corner
    """Place of the lower left corner of the picture along the two axes across the projection, in the order X, Y, Z
    [mm]."""
    pixel_mm: Annotated[float, Field(ge=1e-3, le=100), fields.expecting("a number from 0.001 to 100 (mm)")]
    """Side of a pixel on the part [mm]."""
    depth_mm: _Depth | None = None
    """Least and greatest coordinate along the projection of what it falls on [mm]; everything if absent."""

    @field_validator("file")
    @classmethod
    def _exists(cls, file: str, info: ValidationInfo) -> str:
        if not file.lower().endswith(".png"):
            raise fields.complaint(f'expected a file ending in .png, found "{file}"')
        if info.context is not None:
            fields.require_file(info.context["folder"], file)
        return file

    @field_validator("depth_mm")
    @classmethod
    def _ascending(cls, depth: tuple[float, float] | None) -> tuple[float, float] | None:
        if depth is not None and depth[0] >= depth[1]:
            raise fields.complaint(f"expected [least, greatest], found {list(depth)}")
        return depth


PLACES = ("colour", "group", "faces_at_mm", "box_mm", "mask")


class RegionPlaceConfig(fields.Frozen):
    """Where a region is, by exactly one of five keys."""

    name: fields.Text
    """Name of the region, for people; no two in the list are the same."""
    colour: _Colour | None = None
    """Faces of this colour in the mesh file: #RRGGBB as CAD programs show it (STEP, .glb), or as painted (.ply)."""
    group: fields.Text | None = None
    """Faces of this name in the mesh file: a group, object or material (.obj), a node, mesh or material (.glb), a part
    of an assembly (STEP)."""
    faces_at_mm: _Points | None = None
    """Points in the mesh file's coordinates [mm]: the CAD face at each; of meshes, the surface up to its creases."""
    box_mm: BoxConfig | None = None
    """The surface inside a box; faces are cut where its sides cross them."""
    mask: MaskConfig | None = Field(default=None, validate_default=True)
    """The surface that a black and white picture marks."""

    @field_validator("mask")
    @classmethod
    def _one_place(cls, mask: MaskConfig | None, info: ValidationInfo) -> MaskConfig | None:
        if any(key not in info.data for key in PLACES[:-1]):
            return mask
        given = [key for key in PLACES[:-1] if info.data[key] is not None] + ["mask"] * (mask is not None)
        keys = ", ".join(PLACES)
        if not given:
            raise fields.absent(f"missing key: give one of {keys}", *PLACES)
        if len(given) > 1:
            raise fields.absent(f"{' and '.join(given)} are given together; expected only one of {keys}", *given)
        return mask
