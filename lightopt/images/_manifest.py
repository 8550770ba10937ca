"""The manifest of an image set: what was imaged, under which light, posture and exposure, in which files."""

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any, NoReturn

import numpy as np

from lightopt.core.errors import InputError, refuse
from lightopt.core.transforms import Posture

MANIFEST_NAME = "manifest.json"

ImageKey = tuple[str, Posture, float]


def _number(value: float) -> str:
    """Shortest decimal text that reads back as the same number: 0, 82, −12.5, 0.0625."""
    return np.format_float_positional(float(value) + 0.0, trim="-")


def posture_folder(posture: Posture) -> str:
    return f"posture_{_number(posture.elevation_deg)}_{_number(posture.rotation_deg)}"


def png_name(light: str, posture: Posture, exposure: float) -> str:
    return f"{posture_folder(posture)}/{light}{_exposure_suffix(exposure)}.png"


def dark_name(posture: Posture, exposure: float) -> str:
    return f"{posture_folder(posture)}/dark{_exposure_suffix(exposure)}.png"


def sheet_name(exposure: float) -> str:
    return f"contact-sheet{_exposure_suffix(exposure)}.png"


def _exposure_suffix(exposure: float) -> str:
    return "" if exposure == 1 else f"_x{_number(exposure)}"


def exr_name(light: str, posture: Posture) -> str:
    return f"{posture_folder(posture)}/{light}.exr"


def geometry_name(posture: Posture) -> str:
    return f"{posture_folder(posture)}/geometry.exr"


class FileNames:
    """File names of a run, each reserved by one image: two images must not share a file on any platform."""

    def __init__(self) -> None:
        self._owners: dict[str, str] = {MANIFEST_NAME: "the manifest"}

    def claim(self, name: str, owner: str) -> None:
        """Reserve a file for `owner`; InputError when another has it (case is ignored, as on some platforms)."""
        other = self._owners.setdefault(name.casefold(), owner)
        if other != owner:
            advice = "give the lights names that differ in more than case and that do not end like an exposure (_x2)"
            raise InputError(f"{other} and {owner} would both be written to {name}; {advice}")

    def claim_images(self, keys: Iterable[ImageKey]) -> None:
        """Reserve the files of images and of their postures' geometry; InputError where two would share one."""
        for light, posture, exposure in keys:
            where = posture_folder(posture)
            self.claim(geometry_name(posture), f"the geometry of {where}")
            self.claim(exr_name(light, posture), f"light {light!r} in {where}")
            self.claim(png_name(light, posture, exposure), f"light {light!r} at exposure {exposure:g} in {where}")


def inside_problem(name: str) -> str | None:
    """Why a manifest's path does not name a file inside the set's folder, or None when it does."""
    windows = PureWindowsPath(name)
    if "\\" in name:
        return "expected forward slashes"
    if not name or windows.drive or windows.root or "\x00" in name:
        return "expected a path relative to the manifest's folder"
    if ".." in PurePosixPath(name).parts or PurePosixPath(name) == PurePosixPath():
        return "expected a file inside the manifest's folder"
    return None


_FORMAT = "lightopt-images/1"
_KINDS = ("simulated", "captured")

REPEATABILITY_KEY = "repeatability"  # manifest key of a captured set: result of the repeatability check
EVENTS_KEY = "events"  # manifest key of a captured set: irregularities on the devices' links while no image was taken
DARK_CHECKED_KEY = "ended_dark"
"""Manifest key of a captured set: postures after whose images a frame showed that no light stayed on."""

_RESULT_KEYS = ("images", "geometry", "patches", "files", "warnings", REPEATABILITY_KEY, EVENTS_KEY, DARK_CHECKED_KEY)


@dataclass(frozen=True)
class SourceFile:
    """A rig or part file that the images came from: its name, and the SHA-256 in hex of its content."""

    file: str
    sha256: str


class _Entry:
    posture: Posture
    sha256: Mapping[str, str]
    extra: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        facts = {**vars(self), "posture": self.posture.as_dict(), "sha256": dict(self.sha256) or None, "extra": None}
        return {**{name: value for name, value in facts.items() if value is not None}, **self.extra}


@dataclass(frozen=True)
class ImageEntry(_Entry):
    """One image of a set: light, posture, exposure, and its files; at least one of those in a valid set."""

    light: str
    light_elevation_deg: float
    light_azimuth_deg: float
    posture: Posture
    exposure: float = 1.0  # requested, relative to that of the reflectance's levels
    png: str | None = None  # relative to the set's folder, POSIX style
    exr: str | None = None  # the same
    sha256: Mapping[str, str] = field(default_factory=dict)  # in hex, by png and exr; may be empty in sets of others
    extra: Mapping[str, Any] = field(default_factory=dict)  # unknown keys of the JSON object

    @property
    def key(self) -> tuple[str, Posture, float]:
        """Light, posture and exposure, which identify an image in its set."""
        return self.light, self.posture, self.exposure

    @property
    def files(self) -> tuple[tuple[str, str | None], ...]:
        """Its files with their SHA-256 where it is listed."""
        named = (("png", self.png), ("exr", self.exr))
        return tuple((name, self.sha256.get(kind)) for kind, name in named if name is not None)

    @property
    def held_exposure(self) -> float:
        """Actual exposure of the levels: what the camera held where the set says so, else `exposure`."""
        try:
            times = self.extra["capture"]["exposure_us"]
            share = float(times["read"]) / float(times["requested"])
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            return self.exposure  # a set of others, which has its own words
        return self.exposure * share if 0.0 < share < math.inf else self.exposure


@dataclass(frozen=True)
class GeometryEntry(_Entry):
    """The geometry image of a posture: file relative to the set's folder, SHA-256 in hex under ``exr``."""

    posture: Posture
    exr: str
    sha256: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """The content of ``manifest.json``."""

    kind: str  # simulated or captured
    lightopt: str | None = None  # version that wrote the set; None in sets of other programs
    bit_depth: int
    full_scale: float = 255.0  # grey level of a full-scale sensor level at exposure 1: the scale of the reflectance
    saturation_level: float | None = None  # sensor level from which a pixel counts as saturated; None is full scale
    black_level: float = 0.0  # sensor level without light
    rig: SourceFile | None = None
    part: SourceFile | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)  # as lightopt.core.provenance; of others empty
    images: tuple[ImageEntry, ...] = ()
    geometry: tuple[GeometryEntry, ...] = ()
    patches: str | None = None
    files: Mapping[str, str] = field(default_factory=dict)  # further ones (patch table among them) to SHA-256 in hex
    warnings: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)  # unknown keys of the JSON object, kept as they are

    @property
    def options(self) -> Mapping[str, Any]:
        """Options of the run, as far as they change the images."""
        # sets that were written before there was a provenance have them at the top
        options = self.provenance.get("options", self.extra.get("options"))
        return options if isinstance(options, Mapping) else {}

    @property
    def max_level(self) -> int:
        """Highest sensor level, 2^bit_depth − 1."""
        return (1 << self.bit_depth) - 1

    @property
    def saturated_from(self) -> float:
        return float(self.max_level) if self.saturation_level is None else self.saturation_level

    @property
    def listed_files(self) -> tuple[tuple[str, str | None], ...]:
        """All files of the set with their SHA-256 where it is listed, each once."""
        listed: list[tuple[str, str | None]] = [file for image in self.images for file in image.files]
        listed += [(entry.exr, entry.sha256.get("exr")) for entry in self.geometry]
        if self.patches is not None and self.patches not in self.files:
            listed.append((self.patches, None))
        return tuple(dict.fromkeys((*listed, *self.files.items())))

    def as_dict(self) -> dict[str, Any]:
        """JSON form; carries no time, so the same run gives the same bytes."""
        return {
            "format": _FORMAT,
            **{name: value for name, value in vars(self).items() if name != "extra"},
            "saturation_level": self.saturated_from,
            "rig": self.rig and asdict(self.rig),
            "part": self.part and asdict(self.part),
            "provenance": dict(self.provenance),
            "images": [entry.as_dict() for entry in self.images],
            "geometry": [entry.as_dict() for entry in self.geometry],
            "files": dict(self.files),
            "warnings": list(self.warnings),
            **self.extra,
        }

    @property
    def run_facts(self) -> dict[str, Any]:
        """Of the JSON form what says which run it is of: not what that made and found."""
        return {key: value for key, value in self.as_dict().items() if key not in _RESULT_KEYS}

    def to_json(self) -> str:
        return json.dumps(self.as_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_manifest(path: str | Path) -> Manifest:
    """Read a ``manifest.json``; the files it names are not read.

    Raises InputError with one message per problem: unreadable, no JSON, required keys missing, wrong types or
    values, paths that leave the folder, an image listed twice.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        data = json.loads(text, parse_constant=_no_constant)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}; expected a manifest of images") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{path}:{error.lineno}: not valid JSON: {error.msg}") from error
    except UnicodeDecodeError:
        raise InputError(f"{path}: not text; expected an image set's folder or its manifest.json") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON: {error}") from error
    return parse_manifest(data, path=path)


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number of JSON")


def parse_manifest(data: object, *, path: str | Path) -> Manifest:
    """Make a :class:`Manifest` of a JSON value; InputError with one message per problem."""
    top = _Fields(path, data)
    refuse(top.problems)
    if top.text("format") not in (_FORMAT, ""):
        raise InputError(f"{path}: format: expected {_FORMAT}, found {top.data['format']!r}")
    manifest = _manifest(top)
    refuse(top.problems)
    return manifest


class _Fields:
    """A JSON object whose keys are read with a type; collects what is wrong."""

    def __init__(self, path: str | Path, data: object, where: str = "", problems: list[str] | None = None) -> None:
        self.path, self.where = path, where
        self.problems: list[str] = [] if problems is None else problems
        self.data: Mapping[str, Any] = data if isinstance(data, dict) else {}
        if not isinstance(data, dict):
            self.problem("", "an object", data)

    def inner(self, key: str, value: object) -> "_Fields":
        return _Fields(self.path, value, self.place(key), self.problems)

    def place(self, key: str) -> str:
        return ".".join(filter(None, (self.where, key)))

    def problem(self, key: str, expected: str, found: object) -> None:
        text = "nothing" if found is None else json.dumps(found, default=str)
        found_text = text if len(text) <= 60 else text[:60] + "…"
        place = self.place(key) or "manifest"
        self.problems.append(f"{self.path}: {place}: expected {expected}, found {found_text}")

    def number(self, key: str, default: float | None = None, above: float = -math.inf, upto: float = math.inf) -> float:
        """Read a number in (above, upto]; required when there is no default."""
        value = self.data.get(key, default)
        good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not (good and above < value <= upto):
            lower = f" above {above:g}" if above > -math.inf else ""
            upper = f" up to {upto:g}" if upto < math.inf else ""
            self.problem(key, f"a number{lower}{upper}", value)
            return 1.0
        return value

    def text(self, key: str) -> str:
        """Read a text that is not empty; required."""
        value = self.data.get(key)
        if not isinstance(value, str) or not value:
            self.problem(key, "text", value)
            return ""
        return value

    def optional_text(self, key: str) -> str | None:
        return None if self.data.get(key) is None else self.text(key)

    def file(self, key: str) -> str | None:
        """Read a path inside the set's folder, or None when absent."""
        name = self.optional_text(key)
        if name:
            self.require_inside(key, name)
        return name

    def require_inside(self, key: str, name: str) -> None:
        if problem := inside_problem(name):
            self.problems.append(f"{self.path}: {self.place(key)}: {problem}, found {name!r}")

    def texts(self, key: str) -> dict[str, str]:
        """Read an object of texts, empty when absent."""
        inner = self.inner(key, self.data.get(key) or {})
        return {name: inner.text(name) for name in inner.data}

    def items(self, key: str, *, required: bool = False) -> "Iterator[_Fields]":
        value = self.data.get(key, None if required else [])
        if not isinstance(value, list):
            self.problem(key, "a list", value)
            return
        for i, item in enumerate(value):
            yield self.inner(f"{key}[{i}]", item)

    def unknown(self, kind: type[Manifest | ImageEntry | GeometryEntry]) -> dict[str, Any]:
        """Keys that are no fields of the dataclass that they are read into."""
        known = {field.name for field in fields(kind)} - {"extra"}
        return {key: value for key, value in self.data.items() if key not in known}


def _manifest(top: _Fields) -> Manifest:
    kind = top.text("kind")
    if kind and kind not in _KINDS:
        top.problem("kind", " or ".join(_KINDS), kind)
    bits = top.number("bit_depth", above=0, upto=16)
    if bits != int(bits):
        top.problem("bit_depth", "a whole number", bits)
    max_level = 2.0 ** int(bits) - 1
    images = tuple(_image(item) for item in top.items("images", required=True))
    seen: set[tuple[str, Posture, float]] = set()
    for i, entry in enumerate(images):
        if entry.key in seen:
            top.problem(f"images[{i}]", "each light, posture and exposure once", entry.light)
        seen.add(entry.key)
    warnings = top.data.get("warnings") or []
    if not isinstance(warnings, list) or not all(isinstance(line, str) for line in warnings):
        top.problem("warnings", "a list of texts", warnings)
        warnings = []
    files = top.texts("files")
    for name in files:
        top.require_inside("files", name)
    given = top.data.get("saturation_level") is not None
    saturation = top.number("saturation_level", above=0, upto=max_level) if given else None
    return Manifest(
        kind=kind,
        bit_depth=int(bits),
        full_scale=top.number("full_scale", 255.0, above=0),
        saturation_level=saturation,
        black_level=top.number("black_level", 0.0, upto=max_level),
        lightopt=top.optional_text("lightopt"),
        rig=_source(top, "rig"),
        part=_source(top, "part"),
        provenance=top.inner("provenance", top.data.get("provenance") or {}).data,
        images=images,
        geometry=tuple(_geometry(item) for item in top.items("geometry")),
        patches=top.file("patches"),
        files=files,
        warnings=tuple(warnings),
        extra={key: value for key, value in top.unknown(Manifest).items() if key != "format"},
    )


def _source(top: _Fields, key: str) -> SourceFile | None:
    source = None if top.data.get(key) is None else top.inner(key, top.data[key])
    return source and SourceFile(file=source.text("file"), sha256=source.text("sha256"))


def _posture(entry: _Fields) -> Posture:
    value = entry.data.get("posture")
    posture = entry.inner("posture", value)
    if not isinstance(value, dict):
        return Posture(0.0, 0.0)
    return Posture(posture.number("elevation_deg"), posture.number("rotation_deg"))


def _image(item: _Fields) -> ImageEntry:
    light, angles = item.text("light"), (item.number("light_elevation_deg"), item.number("light_azimuth_deg"))
    posture, exposure = _posture(item), item.number("exposure", above=0)
    png, exr, hashes = item.file("png"), item.file("exr"), item.texts("sha256")
    if png is None and exr is None:
        item.problem("", "png or exr", None)
    return ImageEntry(light, *angles, posture, exposure, png, exr, sha256=hashes, extra=item.unknown(ImageEntry))


def _geometry(item: _Fields) -> GeometryEntry:
    if item.data.get("exr") is None:
        item.problem("exr", "a file", None)
    posture, exr, hashes = _posture(item), item.file("exr") or "", item.texts("sha256")
    return GeometryEntry(posture, exr, sha256=hashes, extra=item.unknown(GeometryEntry))
