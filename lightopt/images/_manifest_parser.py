"""Reading manifests of lightopt and of other programs: every problem at once, named by file and key."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.images._file_names import inside_problem
from lightopt.images._manifest import FORMAT, GeometryEntry, ImageEntry, Manifest, SourceFile


class Fields:
    """A JSON object whose keys are read with a type; collects what is wrong."""

    def __init__(self, path: str | Path, data: object, where: str, problems: list[str] | None = None) -> None:
        self.path = path
        self.where = where
        self.problems: list[str] = [] if problems is None else problems
        self.data: Mapping[str, Any] = data if isinstance(data, dict) else {}
        if not isinstance(data, dict):
            self.problem("", "an object", data)

    def place(self, key: str) -> str:
        """Full name of a key in the file."""
        return ".".join(filter(None, (self.where, key)))

    def problem(self, key: str, expected: str, found: object) -> None:
        """Note what is wrong with a key."""
        text = "nothing" if found is None else json.dumps(found, default=str)
        found_text = text if len(text) <= 60 else text[:60] + "…"
        place = self.place(key) or "manifest"
        self.problems.append(f"{self.path}: {place}: expected {expected}, found {found_text}")

    def number(
        self, key: str, default: float | None = None, *, above: float = -math.inf, upto: float = math.inf
    ) -> float:
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
        """Read a text, or None when the key is absent or null."""
        return None if self.data.get(key) is None else self.text(key)

    def file(self, key: str) -> str | None:
        """Read a path inside the set's folder, or None when absent."""
        name = self.optional_text(key)
        if name and (problem := inside_problem(name)):
            self.problems.append(f"{self.path}: {self.place(key)}: {problem}, found {name!r}")
        return name

    def texts(self, key: str) -> dict[str, str]:
        """Read an object of texts, empty when absent."""
        inner = Fields(self.path, self.data.get(key) or {}, self.place(key), self.problems)
        return {name: inner.text(name) for name in inner.data}

    def items(self, key: str, *, required: bool = False) -> Iterator[Fields]:
        """Yield the objects of a list."""
        value = self.data.get(key, None if required else [])
        if not isinstance(value, list):
            self.problem(key, "a list", value)
            return
        for i, item in enumerate(value):
            yield Fields(self.path, item, f"{key}[{i}]", self.problems)

    def unknown(self, kind: type[Manifest | ImageEntry | GeometryEntry]) -> dict[str, Any]:
        """Keys that are no fields of the dataclass that they are read into."""
        known = {field.name for field in dataclasses.fields(kind)} - {"extra"}
        return {key: value for key, value in self.data.items() if key not in known}


_KINDS = ("simulated", "captured")


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
    fields = Fields(path, data, "")
    if fields.problems:
        raise InputError(*fields.problems)
    if fields.text("format") not in (FORMAT, ""):
        raise InputError(f"{path}: format: expected {FORMAT}, found {fields.data['format']!r}")
    manifest = _manifest(fields)
    if fields.problems:
        raise InputError(*fields.problems)
    return manifest


def _manifest(fields: Fields) -> Manifest:
    kind = fields.text("kind")
    if kind and kind not in _KINDS:
        fields.problem("kind", " or ".join(_KINDS), kind)
    bits = fields.number("bit_depth", above=0, upto=16)
    if bits != int(bits):
        fields.problem("bit_depth", "a whole number", bits)
    max_level = 2.0 ** int(bits) - 1
    images = tuple(_image(item) for item in fields.items("images", required=True))
    seen: set[tuple[str, Posture, float]] = set()
    for i, entry in enumerate(images):
        if entry.key in seen:
            fields.problem(f"images[{i}]", "each light, posture and exposure once", entry.light)
        seen.add(entry.key)
    provenance = fields.data.get("provenance") or {}
    if not isinstance(provenance, dict):
        fields.problem("provenance", "an object", provenance)
        provenance = {}
    warnings = fields.data.get("warnings") or []
    if not isinstance(warnings, list) or not all(isinstance(line, str) for line in warnings):
        fields.problem("warnings", "a list of texts", warnings)
        warnings = []
    files = fields.texts("files")
    for name in files:
        if problem := inside_problem(name):
            fields.problems.append(f"{fields.path}: files: {problem}, found {name!r}")
    full_scale = fields.number("full_scale", 255.0, above=0)
    saturation = None
    if fields.data.get("saturation_level") is not None:
        saturation = fields.number("saturation_level", above=0, upto=max_level)
    extra = fields.unknown(Manifest)
    extra.pop("format", None)
    return Manifest(
        kind=kind,
        bit_depth=int(bits),
        full_scale=full_scale,
        saturation_level=saturation,
        black_level=fields.number("black_level", 0.0, upto=max_level),
        lightopt=fields.optional_text("lightopt"),
        rig=_source(fields, "rig"),
        part=_source(fields, "part"),
        provenance=provenance,
        images=images,
        geometry=tuple(_geometry(item) for item in fields.items("geometry")),
        patches=fields.file("patches"),
        files=files,
        warnings=tuple(warnings),
        extra=extra,
    )


def _source(fields: Fields, key: str) -> SourceFile | None:
    if fields.data.get(key) is None:
        return None
    inner = Fields(fields.path, fields.data[key], key, fields.problems)
    return SourceFile(file=inner.text("file"), sha256=inner.text("sha256"))


def _posture(fields: Fields) -> Posture:
    value = fields.data.get("posture")
    inner = Fields(fields.path, value, f"{fields.where}.posture", fields.problems)
    if not isinstance(value, dict):
        return Posture(0.0, 0.0)
    return Posture(inner.number("elevation_deg"), inner.number("rotation_deg"))


def _image(fields: Fields) -> ImageEntry:
    entry = ImageEntry(
        light=fields.text("light"),
        light_elevation_deg=fields.number("light_elevation_deg"),
        light_azimuth_deg=fields.number("light_azimuth_deg"),
        posture=_posture(fields),
        exposure=fields.number("exposure", above=0),
        png=fields.file("png"),
        exr=fields.file("exr"),
        sha256=fields.texts("sha256"),
        extra=fields.unknown(ImageEntry),
    )
    if entry.png is None and entry.exr is None:
        fields.problem("", "png or exr", None)
    return entry


def _geometry(fields: Fields) -> GeometryEntry:
    if fields.data.get("exr") is None:
        fields.problem("exr", "a file", None)
    return GeometryEntry(
        posture=_posture(fields),
        exr=fields.file("exr") or "",
        sha256=fields.texts("sha256"),
        extra=fields.unknown(GeometryEntry),
    )
