"""The lights of a rig file: panels, lights of other shapes with one channel or several; and the programme of images."""

import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_serializer,
    model_serializer,
    model_validator,
)

from lightopt.config import _fields as fields
from lightopt.config._pattern import PatternConfig, pattern_misfits
from lightopt.config._pose import PanelPoseConfig, with_pose

LightKind = Literal[
    "panel",
    "bar",
    "ring",
    "low_angle_ring",
    "dome",
    "flat_dome",
    "tunnel",
    "coaxial",
    "spot",
    "led_array",
    "display",
    "backlight",
]

RANGE_KEYS = ("elevation_range_deg", "azimuth_range_deg", "distance_range_mm", "distance_step_mm")
"""Keys that say where a light can be moved to."""

MOST_CHANNELS = 256
HOUSED = ("panel", "bar", "backlight", "display", "led_array")  # kinds of light in the middle of a flat housing
_AROUND_PART = ("dome", "low_angle_ring", "tunnel")  # kinds of light that may have the origin in their middle

_LightElevation = Annotated[float, Field(ge=-90, lt=180), fields.expecting(fields.ABOVE_TABLE)]
_Segments = Annotated[int, Field(ge=1, le=MOST_CHANNELS), fields.expecting(f"a whole number from 1 to {MOST_CHANNELS}")]
_Tilt = Annotated[float, Field(ge=0, lt=90), fields.expecting("degrees from 0 to less than 90 (a number)")]
_HalfAngle = Annotated[float, Field(gt=0, lt=60), fields.expecting("degrees above 0 and below 60 (a number)")]
_Share = Annotated[float, Field(ge=0, le=1), fields.expecting("a number from 0 to 1")]

_Normalisation = Literal["mean", "sum"]
_Falloff = Literal["none", "inverse_square"]
_Exponent = Annotated[float, Field(ge=0, le=1000), fields.expecting("a number from 0 to 1000")]
_AUTO_SUM = "sum cannot be used with points: auto, a continuous panel; use mean"


def _wrong_shapes(kind: str, raw: Mapping[str, Any]) -> Iterator[fields.Complaint]:
    """Complaints about the sizes of a kind of light that exclude each other."""
    numbers = {key: value for key, value in raw.items() if isinstance(value, (int, float))}
    if numbers.get("rows", 1) * numbers.get("columns", 1) > MOST_CHANNELS:
        key = "rows" if "rows" in numbers else "columns"
        yield (key,), f"expected at most {MOST_CHANNELS} LEDs in all"
    more, found = numbers.get("outer_radius_mm"), numbers.get("inner_radius_mm")
    if more is not None and found is not None and found >= more:
        yield ("inner_radius_mm",), f"expected less than outer_radius_mm ({more:g}), found {found:g}"
    size = [side for side in fields.entries(raw.get("size_mm")) if isinstance(side, (int, float))]
    hole = numbers.get("camera_hole_mm", 0.0)
    widest = {"dome": numbers.get("radius_mm"), "flat_dome": min(size, default=None)}.get(kind)
    if widest is not None and "camera_hole_mm" in numbers and hole >= widest:
        what = "its radius_mm" if kind == "dome" else "the shorter side of size_mm"
        yield ("camera_hole_mm",), f"expected less than {widest:g}, {what}; found {hole:g}"
    elif kind == "dome" and widest is not None and widest > 0.0:
        upper, lower = math.degrees(math.acos(0.5 * max(0.0, hole) / widest)), numbers.get("lower_elevation_deg", 0.0)
        if lower >= upper:
            yield ("lower_elevation_deg",), f"expected less than {upper:.4g}, where the hole is"
    if "slot_mm" in numbers and numbers["slot_mm"] >= 2.0 * numbers.get("radius_mm", 1e9):
        yield ("slot_mm",), "expected less than the tunnel's diameter"
    counts = numbers.get("columns", 0), numbers.get("rows", 0)
    if "led_mm" in numbers and any(numbers["led_mm"] * n > side for side, n in zip(size, counts, strict=False)):
        yield ("led_mm",), "the LEDs overlap; expected at most size_mm by their number"
    for key in ("distance_mm", "distance_range_mm"):
        nearest = next(iter(fields.entries(raw.get(key))), raw.get(key))
        if nearest == 0 and kind not in _AROUND_PART:
            yield (key,), f"a light of kind {kind} cannot stand at the origin"


class LightSourceConfig(fields.Frozen):
    """A rectangular panel of light, and the point lights that stand for it."""

    size_mm: fields.Size
    """Size of the panel along the azimuth and along the elevation [mm]."""
    points: fields.Points
    """Point lights of the panel: a square number (1, 4, 9, 16, ...), or auto for the converged panel."""
    normalisation: _Normalisation = Field(default="mean", validate_default=True)
    """mean: the points share the panel's output; sum: each counts in full, so that more points are brighter."""
    falloff: _Falloff = "none"
    """none: brightness does not depend on the distance; inverse_square: unchanged at reference_distance_mm."""
    reference_distance_mm: fields.Length | None = None
    """inverse_square: distance at which brightness is unchanged [mm]; of the panel's centre to the origin if absent, so
    that a panel moved away is not dimmer there."""
    emission_exponent: _Exponent = 0.0
    """Exponent n of the panel's emission, cosⁿ of the angle to its axis; 0 is uniform."""

    @fields.rule("normalisation")
    def _finite(cls, normalisation: str, info: ValidationInfo) -> Iterator[fields.Fault]:
        if normalisation == "sum" and info.data.get("points") == "auto":
            yield _AUTO_SUM


class LightSizeConfig(fields.Frozen):
    """Another size of a light, as its maker offers it: values in place of the light's own."""

    distance_mm: fields.Distance | None = None
    """Distance from the origin [mm]."""
    size_mm: fields.Size | None = None
    """Size along azimuth and elevation [mm]."""
    radius_mm: fields.Length | None = None
    """Radius [mm]."""
    inner_radius_mm: fields.Length | None = None
    """Radius of the inner edge [mm]."""
    outer_radius_mm: fields.Length | None = None
    """Radius of the outer edge [mm]."""
    ring_tilt_deg: _Tilt | None = None
    """How far the ring's surface leans towards the axis [deg]."""
    height_mm: fields.Length | None = None
    """Height of the ring along its axis [mm]."""
    length_mm: fields.Length | None = None
    """Length along the azimuth [mm]."""
    camera_hole_mm: fields.Length | None = None
    """Diameter of the hole that the camera looks through [mm]."""
    slot_mm: fields.Length | None = None
    """Width of the slot that the camera looks through [mm]."""
    lower_elevation_deg: _Tilt | None = None
    """Elevation of the dome's lower edge [deg]."""
    half_angle_deg: _HalfAngle | None = None
    """Half the angle that the spot's disc takes up, seen from the origin [deg]."""
    led_mm: fields.Length | None = None
    """Side of an LED's square [mm]."""

    @property
    def values(self) -> dict[str, float | tuple[float, float]]:
        """The values that differ from the light's own, by key."""
        return self.model_dump(exclude_none=True)

    @property
    def text(self) -> str:
        """The same, as ``radius_mm 120``."""
        pairs = ((key, value if isinstance(value, tuple) else (value,)) for key, value in self.values.items())
        return ", ".join(f"{key} {' × '.join(f'{side:g}' for side in sides)}" for key, sides in pairs)


class LightConfig(fields.Frozen):
    """One light, which faces the origin or has a measured pose; a panel may have any key of light_source, too."""

    variants = fields.Variants(
        "kind",
        {
            "panel": ((), ("pose", *LightSourceConfig.model_fields)),
            "bar": (("size_mm",), ()),
            "ring": (("inner_radius_mm", "outer_radius_mm"), ("ring_tilt_deg", "segments")),
            "low_angle_ring": (("radius_mm", "height_mm"), ("segments",)),
            "dome": (("radius_mm",), ("camera_hole_mm", "lower_elevation_deg", "leak", "segments", "pattern")),
            "flat_dome": (("size_mm",), ("camera_hole_mm",)),
            "tunnel": (("radius_mm", "length_mm"), ("slot_mm",)),
            "coaxial": (("size_mm",), ("transmission", "reflection")),
            "spot": (("half_angle_deg",), ()),
            "led_array": (("size_mm", "rows", "columns", "led_mm"), ()),
            "display": (("size_mm",), ("pattern",)),
            "backlight": (("size_mm",), ("pattern", "direct_level")),
        },
    )

    name: fields.FileName
    """Name of the light, a file name unlike those of others. Lights of several channels are name-1, name-2, ..."""
    kind: LightKind = "panel"
    """Kind of light. All kinds but panel shine by Lambert's law and fall off with the square of the distance."""
    distance_mm: fields.Distance
    """Distance from the origin to the centre of the panel, ring, dome's sphere or other light [mm]; 0 for a dome."""
    elevation_deg: _LightElevation
    """Elevation of the light's centre above the table plane [deg]; 90 is straight above, which lights other than panels
    have if absent. A backlight may be below the table, down to -90, which it has if absent."""
    azimuth_deg: fields.Azimuth
    """Azimuth of the light's centre about Z, from X [deg]; 270 if absent of lights other than panels."""
    pose: PanelPoseConfig | None = None
    """Measured pose, in place of distance_mm, elevation_deg and azimuth_deg. Where the light has ranges, it moves about
    the origin from there."""
    elevation_range_deg: fields.ElevationRange | None = None
    """Elevations [low, high] that the light can be moved to [deg]; fixed if absent."""
    azimuth_range_deg: fields.AzimuthRange | None = None
    """Azimuths [low, high] that the light can be moved to [deg]; fixed if absent."""
    distance_range_mm: fields.DistanceRange | None = None
    """Distances [low, high] that the light can be moved to [mm]; fixed if absent. The light is as
    bright at the origin at each of them; only a panel with inverse_square and a reference_distance_mm is not."""
    distance_step_mm: fields.Length | None = None
    """Step of the distances that lightopt optimize tries [mm]; a quarter of the range if absent."""
    gain: fields.Coefficient = 1.0
    """Factor on the brightness of this light."""
    size_mm: fields.Size | None = None
    """Size along azimuth and elevation [mm]; for a panel as light_source if absent."""
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

    segments: _Segments | None = None
    """ring, low_angle_ring, dome: channels that it is divided into, counterclockwise seen from above; the first begins
    90° past the light's azimuth, which is along X at the default azimuth of 270; 1 if absent."""
    radius_mm: fields.Length | None = None
    """low_angle_ring, dome, tunnel: radius [mm]."""
    inner_radius_mm: fields.Length | None = None
    """ring: radius of the inner edge [mm]."""
    outer_radius_mm: fields.Length | None = None
    """ring: radius of the outer edge [mm]."""
    ring_tilt_deg: _Tilt | None = None
    """ring: how far its surface leans towards the axis [deg]; 0 if absent."""
    height_mm: fields.Length | None = None
    """low_angle_ring: height of the ring along its axis [mm]."""
    length_mm: fields.Length | None = None
    """tunnel: length along the azimuth [mm]."""
    camera_hole_mm: fields.Length | None = None
    """dome, flat_dome: diameter of the hole that the camera looks through [mm]; none if absent."""
    slot_mm: fields.Length | None = None
    """tunnel: width of the slot that the camera looks through [mm]; none if absent."""
    lower_elevation_deg: _Tilt | None = None
    """dome: elevation of its lower edge, seen from the centre of its sphere [deg]; 0 if absent."""
    leak: _Share | None = None
    """dome: share of a segment's light that the wall scatters all over the dome; 0 if absent."""
    half_angle_deg: _HalfAngle | None = None
    """spot: half the angle that its disc takes up, seen from the origin [deg]."""
    rows: _Segments | None = None
    """led_array: LEDs along the elevation; each is a channel."""
    columns: _Segments | None = None
    """led_array: LEDs along the azimuth."""
    led_mm: fields.Length | None = None
    """led_array: side of an LED's square [mm]."""
    transmission: _Share | None = None
    """coaxial: share of the light that the beam splitter lets pass; 0.5 if absent."""
    reflection: _Share | None = None
    """coaxial: share of the light that the beam splitter reflects; 0.5 if absent."""
    pattern: PatternConfig | None = None
    """display, backlight, dome: stripes, bars or pictures, each image of which is a channel; uniform if absent."""
    direct_level: fields.Coefficient | None = None
    """backlight: level of a pixel that looks straight at its full radiance, at exposure 1 [grey level]: the part is a
    silhouette before it; black if absent."""
    sizes: Annotated[tuple[LightSizeConfig, ...], fields.LIST] | None = None
    """Other sizes that lightopt compare-lighting tries, each with the values that differ; none if absent."""

    _channel: int = PrivateAttr(default=0)
    _entry: int = PrivateAttr(default=0)
    _entry_name: str | None = PrivateAttr(default=None)
    _mixture: tuple[tuple["LightConfig", float], ...] = PrivateAttr(default=())
    _exposures: tuple[float, ...] | None = PrivateAttr(default=None)

    @property
    def mixture(self) -> tuple[tuple["LightConfig", float], ...]:
        """Lights that are on together and their weights, for an image of a programme; none otherwise."""
        return self._mixture

    @property
    def exposures(self) -> tuple[float, ...] | None:
        """Exposures that the programme gives this image; None for those of the command."""
        return self._exposures

    @model_serializer(mode="wrap")
    def _with_mixture(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # what depends on the image depends on its weights
        own: dict[str, Any] = handler(self)
        if self.sizes is None:
            own.pop("sizes", None)
        parts = [{"light": light.model_dump(mode="json"), "weight": weight} for light, weight in self._mixture]
        return own | {"mixture": parts} if parts else own

    @property
    def channel(self) -> int:
        """Number of the channel among those of its entry in the file, from 0."""
        return self._channel

    @property
    def entry(self) -> int:
        """Index of its entry among the lights of the file."""
        return self._entry

    @property
    def entry_name(self) -> str:
        return self._entry_name or self.name

    @property
    def channels(self) -> int:
        """Number of channels of the light: images that it makes."""
        if self.kind == "led_array":
            assert self.rows is not None
            assert self.columns is not None
            return self.rows * self.columns
        if self.pattern is not None:
            return self.pattern.images
        return self.segments or 1

    @field_serializer("pattern")
    def _keys_of_pattern(self, pattern: PatternConfig | None) -> dict[str, Any] | None:
        # the keys of the other kind are none of its own
        return None if pattern is None else pattern.model_dump(exclude_unset=True)

    @model_validator(mode="wrap")
    @classmethod
    def _placed(cls, value: object, handler: fields.Handler) -> Any:
        raw = {key: one for key, one in fields.mapping(value).items() if one is not None}
        kind = raw.get("kind", "panel")
        if kind == "panel" or not isinstance(kind, str):
            return with_pose(value, handler, point="centre_mm", what="the panel's centre")
        filled = {"elevation_deg": -90.0 if kind == "backlight" else 90.0, "azimuth_deg": 270.0}
        # of a kind that is misspelt nothing is missing that it may not need
        known = kind in get_args(LightKind)
        return handler(filled | ({"distance_mm": 0.0} if kind == "dome" or not known else {}) | raw)

    @classmethod
    def misfits(cls, raw: Mapping[str, Any]) -> Iterator[fields.Complaint]:
        """As of every configuration; shapes and patterns that no light can have."""
        yield from super().misfits(raw)
        kind = raw.get("kind") or "panel"
        if isinstance(kind, str) and kind in get_args(LightKind):
            yield from _wrong_shapes(kind, raw)
            yield from pattern_misfits(kind, raw)
        own = {key: value for key, value in raw.items() if key != "sizes"}
        for number, size in enumerate(fields.entries(raw.get("sizes"))):
            changed = fields.mapping(size)
            if isinstance(size, Mapping) and not changed:
                yield ("sizes", number), "expected a value that differs, such as radius_mm: 120"
            for keys, fault in cls.misfits({**own, **changed}) if changed else ():
                yield ("sizes", number, *(keys if keys[0] in changed else ())), fault

    @fields.rule("elevation_deg")
    def _above_table(cls, elevation: float, info: ValidationInfo) -> Iterator[fields.Fault]:
        if elevation <= 0.0 and info.data.get("kind") != "backlight":
            yield f"expected {fields.ABOVE_TABLE}, found {elevation:g}"

    @fields.rule("distance_step_mm")
    def _of_a_range(cls, step: float | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        if step is not None and info.data.get("distance_range_mm", step) is None:
            yield "has no effect without distance_range_mm; leave it out, or add the range"

    @fields.rule("elevation_range_deg", "azimuth_range_deg", "distance_range_mm")
    def _holds_the_light(cls, ends: tuple[float, float] | None, info: ValidationInfo) -> Iterator[fields.Fault]:
        angle = str(info.field_name).replace("_range", "")
        now = info.data.get(angle)
        if ends is not None and now is not None and not ends[0] <= now <= ends[1]:
            outside = f"outside [{ends[0]:g}, {ends[1]:g}]; widen the range or move the light into it"
            yield f"the light is at {angle} {now:g}, {outside}"


def auto_sums(lights: Sequence[object], shared: LightSourceConfig | None) -> Iterator[fields.Complaint]:
    """Complaints about lights whose points and normalisation, their own or the shared ones, exclude each other."""
    for i, light in enumerate(lights):
        own = {key: fields.value_of(light, key) for key in ("points", "normalisation")}
        if shared is None or own == {"points": None, "normalisation": None}:
            continue
        both = {key: getattr(shared, key) if value is None else value for key, value in own.items()}
        if both == {"points": "auto", "normalisation": "sum"}:
            key = "normalisation" if own["normalisation"] is not None else "points"
            yield (i, key), _AUTO_SUM


def expanded(lights: Sequence[LightConfig]) -> tuple[LightConfig, ...]:
    """The channels of all lights, each as a light of its own name."""
    found: list[LightConfig] = []
    for entry, light in enumerate(lights):
        for channel in range(light.channels):
            name = light.name if light.channels == 1 else f"{light.name}-{channel + 1}"
            one = light.model_copy(update={"name": name})
            one._channel, one._entry, one._entry_name = channel, entry, light.name
            found.append(one)
    return tuple(found)


def _fraction(value: object) -> object:
    # "1/16" is text in YAML
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ZeroDivisionError):
        return value


_Weight = Annotated[float, Field(gt=0, le=1), fields.expecting("a weight above 0 up to 1 (full brightness)")]
_Exposure = Annotated[
    float, Field(gt=0, le=1e6), BeforeValidator(_fraction), fields.expecting("a number above 0, such as 1 or 1/16")
]


class ProgrammeImageConfig(fields.Frozen):
    """An image of the programme."""

    name: fields.FileName
    """Name of the image; it becomes a file name and takes the place of the light's name in every command."""
    lights: Annotated[dict[str, _Weight], Field(min_length=1)]
    """Lights that are on together (name-1, name-2, ... of lights of several channels), each with its weight on the
    brightness that the file gives it, above 0 up to 1."""
    exposures: Annotated[tuple[_Exposure, ...], Field(strict=False, min_length=1, max_length=16)] | None = None
    """Exposures of this image, whatever a command's option says; those of the command if absent."""


def programme_misfits(programme: object, lights: Sequence[LightConfig]) -> Iterator[fields.Complaint]:
    """What does not fit together, by the path under ``programme``."""
    images, known = fields.entries(programme), {light.name: light for light in lights}
    yield from fields.same_names(images, "programme", str.lower)
    for i, image in enumerate(images):
        name, weights = fields.value_of(image, "name"), fields.mapping(fields.value_of(image, "lights"))
        clash = {light.lower(): light for light in known}.get(str(name).lower())
        if clash is not None and set(weights) != {clash}:
            alone = f'"{clash}" is a light of the rig, and this image is not of that light alone'
            yield (i, "name"), f"{alone}; choose another name"
        for light in weights:
            yield from (((i, "lights", light), problem) for problem in _image_problems(light, [*weights], known))
        exposures = fields.entries(fields.value_of(image, "exposures"))
        if any(fields.repeated(str(_fraction(one)).removesuffix(".0") for one in exposures)):
            yield (i, "exposures"), "the same exposure was given twice"


def _image_problems(light: str, together: Sequence[str], known: Mapping[str, LightConfig]) -> Iterator[str]:
    """What is wrong with a light in an image of several."""
    if light not in known:
        yield f'no light "{light}"; the rig has {", ".join(known)}'
        return
    own = known[light]
    others = [one for one in together if one in known and known[one].entry != own.entry]
    without = f"without other lights; leave it or {', '.join(others)} out"
    if any(getattr(own, key) is not None for key in RANGE_KEYS):
        yield f'"{light}" has a range, and lights of a programme are fixed; leave the range out'
    if own.pattern is not None and others:
        yield f'"{light}" is of a display with stripes, which images show {without}'
    if own.direct_level is not None and others:
        yield f'"{light}" has a direct_level, and images show it {without}'
    if own.kind == "panel" and len(together) > 1:
        yield f'"{light}" is a panel, which images show alone; write kind: bar, which has an area, or split the image'


def programme_lights(
    programme: Sequence[ProgrammeImageConfig], lights: Sequence[LightConfig]
) -> tuple[LightConfig, ...]:
    """Each image of a programme as a light of its own, which stands where its first light does."""
    known, images = {light.name: light for light in lights}, list[LightConfig]()
    for image in programme:
        mixture = tuple((known[name], weight) for name, weight in image.lights.items())
        images.append(mixture[0][0].model_copy(update={"name": image.name}))
        images[-1]._mixture, images[-1]._exposures = mixture, image.exposures
    return tuple(images)
