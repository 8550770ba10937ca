"""A part file: mesh, placement, postures, reflectance and defects."""

import contextlib
import math
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import PurePath
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, ValidatorFunctionWrapHandler, field_validator, model_validator

from lightopt.config import _fields as fields
from lightopt.config._defects import DefectConfig, PlannedDefectConfig
from lightopt.config._fields import LIST, Frozen, complaint, expecting
from lightopt.core.units import step_units_mm, unit_name

_ChordTolerance = Annotated[float, Field(ge=1e-4, le=10), expecting("a number from 0.0001 to 10 (mm)")]
_Catalogue = Annotated[tuple[PlannedDefectConfig, ...], Field(strict=False, min_length=1, max_length=100)]
_Share = Annotated[float, Field(ge=0, le=1), expecting("a number from 0 to 1")]


class InspectionConfig(Frozen):
    """What `lightopt inspect` compares with, and the limits by which it judges OK or NG."""

    most_defects: Annotated[int, Field(ge=0, le=10**6), expecting("a whole number from 0 to 1000000")] = 0
    """A part with more defects than this is NG."""
    least_size_mm: Annotated[float, Field(ge=0, le=1e3), expecting("a number from 0 to 1000 (mm)")] = 0.0
    """Defects shorter than this do not count [mm]."""
    least_contrast: _Share = 0.0
    """Defects that change the light by less than this share, under the light that shows them best, do not count."""
    least_inspected: _Share = 0.0
    """A part is NG if less than this share of its visible surface, over all postures, was inspected. Surface inspected
    only for glints counts."""
    bounces: fields.Bounces = 0
    """How often light goes from the part to the part in the images that measured ones are compared with."""


_UNITLESS = (".stl", ".ply", ".obj")
_STEP = (".step", ".stp")
MESH_SUFFIXES = (*_UNITLESS, ".glb", *_STEP)


class MeshConfig(Frozen):
    """The file with the part's shape, and how its surface is read."""

    file: Annotated[fields.Text, fields.file_of(*MESH_SUFFIXES)]
    """Mesh or CAD file, relative to this file: .stl, .ply, .obj, .glb, .step or .stp."""
    units: Literal["um", "mm", "cm", "m", "inch", "ft"] | None = Field(default=None, validate_default=True)
    """Length unit of the mesh file: um, mm, cm, m, inch or ft. Mandatory for .stl, .ply and .obj, which contain none.
    For .glb (metres) and STEP, only the unit of the file itself."""
    normals: Literal["smooth", "facet"] = "smooth"
    """smooth: normals vary over the facets, except across edges sharper than the crease angle; facet: flat ones."""
    crease_angle_deg: Annotated[float, Field(gt=0, le=180), expecting("a number above 0, up to 180 (degrees)")] = 30.0
    """Edges where the facets' normals differ by more than this stay sharp [deg]."""
    chord_tolerance_mm: _ChordTolerance | None = None
    """STEP: largest distance of the triangles from the CAD surface [mm]. More makes fewer triangles, with the CAD
    surface's normals at their corners; the angle between neighbours follows, from 0.1 rad at 0.01 mm with the square
    root up to 0.5 rad. If absent, the smaller of 0.01 and a fifth of a pixel's footprint."""
    max_triangles: Annotated[int, Field(ge=1, le=2**31 - 1), expecting("a whole number above 0")] = 20_000_000
    """Meshes of more triangles than this are refused."""

    @property
    def of_step(self) -> bool:
        return PurePath(self.file).suffix.lower() in _STEP

    @fields.rule("units")
    def _as_the_format_has_it(cls, units: str | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        if "file" not in info.data:
            return
        file: str = info.data["file"]
        suffix = PurePath(file).suffix.lower()
        if suffix in _UNITLESS and units is None:
            unit = f"give the unit that {PurePath(file).name} was exported in (um, mm, cm, m, inch or ft)"
            yield fields.absent(f'missing key "units": {suffix} files carry no unit; {unit}', "units")
        if suffix == ".glb" and units not in (None, "m"):
            yield f"expected m or nothing (.glb is in metres by its specification), found {units}"
        if suffix in _STEP and units is not None and info.context is not None:
            declared: set[str] = set()
            with contextlib.suppress(OSError):
                declared = set(map(unit_name, step_units_mm((info.context["folder"] / file).read_bytes())))
            if units not in declared:
                unit = f"the file is in {' and '.join(sorted(declared))}" if declared else "no unit is found in it"
                yield f"found {units}, but {unit}; STEP carries its own unit, remove this key"

    @fields.rule("chord_tolerance_mm")
    def _of_step(cls, tolerance: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        suffix = PurePath(str(info.data.get("file", ""))).suffix.lower()
        if tolerance is not None and suffix and suffix not in _STEP:
            yield f"{suffix} files have their triangles already; it belongs to STEP; remove this key"


class PlacementConfig(Frozen):
    """How the part lies in the world at posture (0, 0): turned, then anchored, then shifted."""

    anchor: Literal["as_modelled", "rest_on_table", "centred"] = "rest_on_table"
    """as_modelled: the mesh's own origin; rest_on_table: bounding box centred in X and Y, lowest point at Z = 0;
    centred: bounding box centred at the origin."""
    translate_mm: fields.Coordinates = (0.0, 0.0, 0.0)
    """Shift along X, Y and Z after the anchor [mm]."""
    rotate_deg: Annotated[
        tuple[fields.Azimuth, fields.Azimuth, fields.Azimuth],
        LIST,
        expecting("[x, y, z], three numbers from -360 to 360 (degrees)"),
    ] = (0.0, 0.0, 0.0)
    """Rotation about the fixed X, then Y, then Z axis, before the anchor [deg]."""
    registration: Literal["plane", "full"] = "plane"
    """What a registration searches. plane: the part rests on the stage's plate, and is shifted and rotated on it; full:
    also its height and its tilt."""


_Sigma = Annotated[float, Field(ge=1e-5, le=0.5), expecting("a number from 0.00001 to 0.5 (radians)")]
_Alpha = Annotated[float, Field(ge=2e-5, le=1.0), expecting("a number from 0.00002 to 1")]
_Index = Annotated[float, Field(gt=0, le=50), expecting("a number above 0, up to 50")]

MOST_ACROSS = 50.0  # times as wide across the brushing as along it

LEAST_METAL = 0.02  # share of light that is reflected along the normal: half of what glass does

# what a width or coefficient is compared with: the narrow lobe's, and up to how many times as much; None: at most that
_NARROW: Mapping[str, tuple[str, float | None]] = {
    "R_s_wide": ("R_s", None),
    "sigma_wide_rad": ("sigma_rad", math.inf),
    "sigma_across_rad": ("sigma_rad", MOST_ACROSS),
    "alpha_across": ("alpha", MOST_ACROSS),
}


class AxisConfig(Frozen):
    """An axis in the mesh file's coordinates."""

    point_mm: fields.Coordinates = (0.0, 0.0, 0.0)
    """A point of it, in the mesh file's coordinates [mm]."""
    direction: fields.Direction
    """Its direction, of any length, in the mesh file's coordinates."""


_Curve = Annotated[
    tuple[fields.Coordinates, ...],
    Field(strict=False, min_length=2, max_length=1000),
    fields.that(
        lambda curve: all(a != b for a, b in pairwise(curve)),
        "two corners that follow each other are at the same place; remove one of them",
    ),
]


class BrushingConfig(Frozen):
    """Which way a surface is brushed, by one of four keys; signs and lengths do not count."""

    one_of = ("direction", "around_axis", "along_curve_mm", "along_texture")

    direction: fields.Direction | None = None
    """Along a line, as sheet metal is: its direction in the mesh file's coordinates."""
    around_axis: AxisConfig | None = None
    """Around an axis, as turned parts are."""
    along_curve_mm: _Curve | None = None
    """Along a curve, as it runs where it is nearest: its corners, in the mesh file's coordinates [mm]. The direction
    turns evenly from one corner to the next."""
    along_texture: Literal["u", "v"] | None = None
    """As the mesh file's texture coordinates run (.obj, .glb, .ply): u: as u grows and v stays; v: as v grows."""


class ReflectanceConfig(Frozen):
    """Reflection of the surface: a diffuse component and a specular lobe."""

    variants = fields.Variants(
        "model",
        {
            "torrance-sparrow": (("sigma_rad",), ("sigma_across_rad", "brushing")),
            "ggx": (("alpha",), ("alpha_across", "brushing")),
            "two-lobe": (("sigma_rad", "R_s_wide", "sigma_wide_rad"), ("sigma_across_rad", "brushing")),
            "measured": (("table",), ("width_factor",)),
        },
        usual={"width_factor": 1.0},
    )

    model: Literal["torrance-sparrow", "ggx", "two-lobe", "measured"] = "torrance-sparrow"
    """Form of the specular lobe. torrance-sparrow: Gaussian in the angle between normal and half vector; ggx: with the
    long tails of plated and ground metal; two-lobe: a narrow and a wide Gaussian one, as of chrome; measured: of a
    table."""
    R_d: fields.Coefficient
    """Diffuse coefficient [levels of full_scale]."""
    diffuse_exponent: Annotated[float, Field(ge=0.5, le=5), expecting("a number from 0.5 to 5")] | None = None
    """Power of N·L in the diffuse component, instead of Lambert's 1: above 1 it falls faster as the light leans."""
    oren_nayar_roughness: Annotated[float, Field(ge=0, le=1), expecting("a number from 0 to 1")] | None = None
    """Roughness of Oren and Nayar's diffuse component, instead of Lambert's: 0 is Lambert's, and rougher surfaces are
    brighter where camera and light are on the same side, up to their edges. Not with diffuse_exponent."""
    R_s: fields.Coefficient
    """Specular coefficient [levels of full_scale]."""
    sigma_rad: _Sigma | None = None
    """torrance-sparrow, two-lobe: width σ of the specular lobe [rad]: 0.003 is polished chrome, 0.05 satin plating."""
    alpha: _Alpha | None = None
    """ggx: roughness α of the microfacet model. It is about twice the σ that fits the middle of the lobe: 0.006 is
    polished chrome, 0.1 satin plating."""
    R_s_wide: fields.Coefficient | None = None
    """two-lobe: specular coefficient of the wide lobe, at most R_s [levels of full_scale]."""
    sigma_wide_rad: _Sigma | None = None
    """two-lobe: width of the wide lobe, more than sigma_rad [rad]."""
    table: Annotated[fields.Text, fields.file_of(".csv", ".binary")] | None = None
    """measured: file of the lobe, relative to this file. A .csv with the angle δ between normal and half vector
    [degrees] and the lobe's value, in any unit, in each line; or a material of the MERL database (.binary). R_s is the
    level at δ = 0."""
    width_factor: Annotated[float, Field(ge=0.05, le=20), expecting("a number from 0.05 to 20")] = 1.0
    """measured: factor on the table's angles."""
    refractive_index: Annotated[tuple[_Index, _Index], LIST, expecting("[n, k], two numbers above 0")] | None = None
    """Complex refractive index [n, k] of a metal: its specular reflection follows Fresnel's equations, and grows at
    grazing angles. If absent, it does not depend on the angle of incidence."""
    sigma_across_rad: _Sigma | None = None
    """Brushed surfaces, torrance-sparrow and two-lobe: width of the lobe across the brushing, more than sigma_rad, that
    along it [rad]. Of two lobes, of the narrow one; the wide one is as many times wider."""
    alpha_across: _Alpha | None = None
    """Brushed surfaces, ggx: roughness across the brushing, more than alpha, that along it."""
    brushing: BrushingConfig | None = Field(default=None, validate_default=True)
    """Brushed surfaces: which way they are brushed. Not brushed if absent."""
    full_scale: fields.Positive = 255.0
    """Full scale in which R_d and R_s are expressed [levels]."""
    white_level: fields.Positive | None = None
    """Level of a white diffuse surface that faces a light of gain 1 at the origin [levels of full_scale]. It says which
    share of light the part reflects, for light from the part to itself; such that the part reflects 65 % if absent."""

    @fields.rule("oren_nayar_roughness")
    def _instead_of_an_exponent(cls, value: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        if value is not None and info.data.get("diffuse_exponent") is not None:
            yield "the diffuse component has one form: diffuse_exponent is given, too"

    @field_validator("refractive_index")
    @classmethod
    def _of_a_metal(cls, value: tuple[float, float] | None) -> tuple[float, float] | None:
        if value is not None:
            n, k = value
            share = ((n - 1.0) ** 2 + k * k) / ((n + 1.0) ** 2 + k * k)
            if share < LEAST_METAL:
                reflected = f"at least {LEAST_METAL:.0%} is reflected along the normal, found {share:.1%}"
                raise complaint(f"expected an index by which {reflected}")
        return value

    @property
    def sigma(self) -> float:
        """Width of the lobe where it is brightest [rad]; half of ggx's α."""
        return 0.5 * self.alpha if self.alpha is not None else self.sigma_rad or 0.0

    @property
    def sigma_across(self) -> float | None:
        """Width of the lobe across the brushing [rad]; half of ggx's α; None where the surface is not brushed."""
        return 0.5 * self.alpha_across if self.alpha_across is not None else self.sigma_across_rad

    @fields.rule("R_s_wide", "sigma_wide_rad", "sigma_across_rad", "alpha_across")
    def _against_the_narrow(cls, value: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        narrow, most = _NARROW[str(info.field_name)]
        of = info.data.get(narrow)
        if value is None or of is None:
            return
        if most is None and value > of:
            yield f"expected at most {narrow}, {of:g}, found {value:g}"
        if most is not None and not of < value <= most * of:
            up_to = "" if math.isinf(most) else f", up to {most:g} times as much"
            yield f"expected more than {narrow}, {of:g}{up_to}, found {value:g}"

    @fields.rule("brushing")
    def _with_a_width(cls, value: BrushingConfig | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        key = "alpha_across" if info.data.get("model") == "ggx" else "sigma_across_rad"
        if key in info.data and (value is None) != (info.data[key] is None):
            missing = "brushing" if value is None else key
            yield fields.absent(f'missing key "{missing}": brushed surfaces have {key} and brushing', missing)


_Colour = Annotated[str, Field(pattern=r"^#[0-9A-Fa-f]{6}$"), expecting('a colour such as "#97FFB5", in quotes')]
_Points = Annotated[tuple[fields.Coordinates, ...], Field(strict=False, min_length=1, max_length=1000)]
_Corner = Annotated[tuple[fields.Number, fields.Number], LIST, expecting("two numbers (mm)")]
_Depth = Annotated[_Corner, fields.ASCENDING]


class BoxConfig(Frozen):
    """A box along the axes of the mesh file."""

    low: fields.Coordinates
    """Its lowest X, Y and Z, in the mesh file's coordinates [mm]."""
    high: fields.Coordinates
    """Its highest X, Y and Z, in the mesh file's coordinates [mm]."""

    @fields.rule("high")
    def _above(cls, high: tuple[float, ...], info: ValidationInfo) -> Iterator[fields.Fault]:
        low = info.data.get("low")
        if low is not None and any(a >= b for a, b in zip(low, high, strict=True)):
            yield f"expected three numbers above those of low, {list(low)}, found {list(high)}"


class MaskConfig(Frozen):
    """A black and white picture that is projected onto the part along an axis of the mesh file."""

    file: Annotated[fields.Text, fields.file_of(".png")]
    """PNG file, relative to this file: the region is where it is white (more than half). Columns go along the first of
    the two axes across the projection, rows from the last to the first along the second."""
    onto: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    """Which surface it falls on: +z is what faces up, in the mesh file's coordinates."""
    corner_mm: _Corner
    """Lower left corner of the picture along the two axes across the projection, in the order X, Y, Z [mm]."""
    pixel_mm: Annotated[float, Field(ge=1e-3, le=100), expecting("a number from 0.001 to 100 (mm)")]
    """Side of a pixel on the part [mm]."""
    depth_mm: _Depth | None = None
    """Least and greatest coordinate along the projection of what it falls on [mm]; everything if absent."""


class RegionConfig(Frozen):
    """Surface of a part that reflects in its own way; where it is, one of five keys says."""

    one_of = ("colour", "group", "faces_at_mm", "box_mm", "mask")

    name: fields.Text
    """Name of the region, for people; no two in the list are the same."""
    colour: _Colour | None = None
    """Faces of this colour in the mesh file: #RRGGBB as CAD programs show it (STEP, .glb), or as painted (.ply)."""
    group: fields.Text | None = None
    """Faces of this name in the mesh file: a group, object or material (.obj), a node, mesh or material (.glb), a part
    of an assembly or a body (STEP)."""
    faces_at_mm: _Points | None = None
    """Points in the mesh file's coordinates [mm]: the CAD face at each; of meshes, the surface up to its creases."""
    box_mm: BoxConfig | None = None
    """The surface inside a box; faces are cut where its sides cross them."""
    mask: MaskConfig | None = None
    """The surface that a black and white picture marks."""
    reflectance: ReflectanceConfig
    """Reflection of its surface; full_scale and white_level are those of the part."""

    @classmethod
    def misfits(cls, raw: Mapping[str, Any]) -> Iterator[fields.Complaint]:
        """As of every configuration; a colour that is read as a comment."""
        if "colour" in raw and raw["colour"] is None:
            yield ("colour",), 'expected a colour such as "#97FFB5", in quotes: without them # begins a comment'
            return
        yield from super().misfits(raw)

    @field_validator("reflectance")
    @classmethod
    def _scales_of_the_part(cls, own: ReflectanceConfig) -> ReflectanceConfig:
        given = sorted(own.model_fields_set & {"full_scale", "white_level"})
        if given:
            raise complaint(f"regions have {' and '.join(given)} of the part's own reflectance; remove it here")
        return own


_Waviness = Annotated[float, Field(gt=0, le=5), expecting("a number above 0, up to 5 (degrees)")]
_WaveLength = Annotated[float, Field(ge=0.01, le=100), expecting("a number from 0.01 to 100 (mm)")]


class WavinessConfig(Frozen):
    """Waves of one length on the surface of good parts."""

    waviness_deg: _Waviness
    """Root mean square slope of the surface against the mesh [deg]."""
    waviness_mm: _WaveLength
    """Correlation length of its height [mm]: about a sixth of the distance of its waves."""


class SurfaceConfig(Frozen):
    """Waviness of good parts (orange peel): by how much their surface departs from the mesh."""

    waviness_deg: _Waviness | None = None
    """Root mean square slope of the surface against the mesh [deg]; absent where there are bands."""
    waviness_mm: _WaveLength | None = None
    """Correlation length of its height [mm]: about a sixth of the distance of its waves."""
    bands: Annotated[tuple[WavinessConfig, ...], Field(strict=False, max_length=10)] = ()
    """Waves of several lengths, in place of the two keys above: the power spectrum of the surface, band by band."""

    @model_validator(mode="after")
    def _one_form(self) -> "SurfaceConfig":
        given = self.waviness_deg is not None, self.waviness_mm is not None
        if self.bands and any(given):
            raise complaint("bands are given in place of waviness_deg and waviness_mm; remove one or the other")
        if not self.bands and not all(given):
            raise complaint("expected waviness_deg and waviness_mm, or bands, each with both")
        return self

    @property
    def waves(self) -> tuple[tuple[float, float], ...]:
        """Slope [deg] and correlation length [mm] of each band."""
        if self.waviness_deg is not None and self.waviness_mm is not None:
            return ((self.waviness_deg, self.waviness_mm),)
        return tuple((band.waviness_deg, band.waviness_mm) for band in self.bands)


class PartConfig(fields.FileConfig):
    """A part to inspect: its shape, how it lies, the postures it is seen in, and its surface."""

    format: Literal["lightopt-part/1"]
    """Kind and version of this file: lightopt-part/1."""
    name: fields.Text
    """Name of the part, for people."""
    mesh: MeshConfig
    """The part's shape."""
    placement: PlacementConfig = PlacementConfig()
    """Placement of the part on the table; resting at its centre if absent."""
    postures: Annotated[tuple[fields.PostureConfig, ...], Field(strict=False, min_length=1, max_length=1000)] = (
        fields.PostureConfig(elevation_deg=0.0, rotation_deg=0.0),
    )
    """Postures in which the part is inspected; (0, 0) only if absent."""
    reflectance: ReflectanceConfig
    """Reflection of the part's surface."""
    regions: Annotated[tuple[RegionConfig, ...], Field(strict=False, max_length=100)] = ()
    """Regions of the surface that reflect in other ways; what several have belongs to the first. None if absent."""
    surface: SurfaceConfig | None = None
    """Waviness of good parts: renders show it, and it is noise otherwise. None if absent."""
    defects: Annotated[tuple[DefectConfig, ...], Field(strict=False, max_length=500)] = ()
    """Defects that are on this part; renders show them. None if absent."""
    defect_catalogue: _Catalogue | None = None
    """Kinds of defect for which the inspection is planned; the built-in ones if absent."""
    inspection: InspectionConfig = InspectionConfig()
    """What inspections compare with, and the limits by which they judge OK or NG; no defects allowed if absent."""

    @field_validator("postures", mode="wrap")
    @classmethod
    def _differ(cls, value: object, handler: ValidatorFunctionWrapHandler) -> Any:
        postures = fields.entries(value)
        angles = [tuple(fields.value_of(p, key) for key in ("elevation_deg", "rotation_deg")) for p in postures]
        valid = [pair if all(type(angle) in (int, float) for angle in pair) else None for pair in angles]
        twice = (((i,), f"the same posture as postures[{first}]") for i, first in fields.repeated(valid))
        return fields.with_complaints(value, handler, twice)

    @field_validator("regions", "defects", "defect_catalogue", mode="wrap")
    @classmethod
    def _differ_in_name(cls, value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> Any:
        return fields.with_complaints(value, handler, fields.same_names(fields.entries(value), str(info.field_name)))
