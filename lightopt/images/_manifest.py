"""The manifest of an image set: what was imaged, under which light, posture and exposure, into which file."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lightopt.core.transforms import Posture

FORMAT = "lightopt-images/1"
MANIFEST_NAME = "manifest.json"

REPEATABILITY_KEY = "came_back"
"""Manifest key of a captured set: result of the repeatability check."""

EVENTS_KEY = "events"
"""Manifest key of a captured set: irregularities on the devices' links while no image was taken."""

DARK_CHECKED_KEY = "ended_dark"
"""Manifest key of a captured set: postures after whose images a frame showed that no light stayed on."""


@dataclass(frozen=True)
class SourceFile:
    """A rig or part file that the images came from: its name, and the SHA-256 in hex of its content."""

    file: str
    sha256: str

    def as_dict(self) -> dict[str, str]:
        """JSON form."""
        return {"file": self.file, "sha256": self.sha256}


@dataclass(frozen=True)
class ImageEntry:
    """One image of a set: light, posture, exposure, and its files.

    exposure: Requested exposure, relative to that of the reflectance's levels.
    png, exr: Files relative to the set's folder, POSIX style; at least one in a valid set.
    sha256: SHA-256 in hex by ``png`` and ``exr``; may be empty in sets of other programs.
    extra: Unknown keys of the JSON object, kept as they are.
    """

    light: str
    light_elevation_deg: float
    light_azimuth_deg: float
    posture: Posture
    exposure: float = 1.0
    png: str | None = None
    exr: str | None = None
    sha256: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, Posture, float]:
        """Light, posture and exposure, which identify an image in its set."""
        return self.light, self.posture, self.exposure

    @property
    def held_exposure(self) -> float:
        """Actual exposure of the levels: what the camera held where the set says so, else `exposure`."""
        try:
            times = self.extra["capture"]["exposure_us"]
            share = float(times["read"]) / float(times["asked"])
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            return self.exposure  # a set of others, which has its own words
        return self.exposure * share if 0.0 < share < math.inf else self.exposure

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "light": self.light,
            "light_elevation_deg": self.light_elevation_deg,
            "light_azimuth_deg": self.light_azimuth_deg,
            "posture": self.posture.as_dict(),
            "exposure": self.exposure,
            **({"png": self.png} if self.png is not None else {}),
            **({"exr": self.exr} if self.exr is not None else {}),
            **({"sha256": dict(self.sha256)} if self.sha256 else {}),
            **self.extra,
        }


@dataclass(frozen=True)
class GeometryEntry:
    """The geometry image of a posture: file relative to the set's folder, SHA-256 in hex under ``exr``."""

    posture: Posture
    exr: str
    sha256: Mapping[str, str] = field(default_factory=dict)
    extra: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        hashes = {"sha256": dict(self.sha256)} if self.sha256 else {}
        return {"posture": self.posture.as_dict(), "exr": self.exr, **hashes, **self.extra}


@dataclass(frozen=True)
class Manifest:
    """The content of ``manifest.json``.

    kind: ``simulated`` or ``captured``.
    full_scale: Grey level of a full-scale sensor level at exposure 1: the scale of the reflectance.
    saturation_level: Sensor level from which a pixel counts as saturated; None is full scale.
    black_level: Sensor level without light.
    lightopt: Version that wrote the set; None in sets of other programs.
    provenance: In the layout of :mod:`lightopt.core.provenance`; empty in sets of other programs.
    files: Further files of the set (the patch table among them): name to SHA-256 in hex.
    extra: Unknown keys of the JSON object, kept as they are.
    """

    kind: str
    bit_depth: int
    full_scale: float = 255.0
    saturation_level: float | None = None
    black_level: float = 0.0
    lightopt: str | None = None
    rig: SourceFile | None = None
    part: SourceFile | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    images: tuple[ImageEntry, ...] = ()
    geometry: tuple[GeometryEntry, ...] = ()
    patches: str | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)

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
        """Sensor level from which a pixel counts as saturated."""
        return float(self.max_level) if self.saturation_level is None else self.saturation_level

    @property
    def listed_files(self) -> tuple[tuple[str, str | None], ...]:
        """All files of the set with their SHA-256 where it is listed, each once."""
        listed: list[tuple[str | None, str | None]] = []
        for image in self.images:
            listed += [(image.png, image.sha256.get("png")), (image.exr, image.sha256.get("exr"))]
        listed += [(entry.exr, entry.sha256.get("exr")) for entry in self.geometry]
        if self.patches not in self.files:
            listed.append((self.patches, None))
        listed += self.files.items()
        return tuple(dict.fromkeys((name, digest) for name, digest in listed if name is not None))

    def as_dict(self) -> dict[str, Any]:
        """JSON form; carries no time, so the same run gives the same bytes."""
        return {
            "format": FORMAT,
            "kind": self.kind,
            "lightopt": self.lightopt,
            "bit_depth": self.bit_depth,
            "full_scale": self.full_scale,
            "saturation_level": self.saturated_from,
            "black_level": self.black_level,
            "rig": self.rig and self.rig.as_dict(),
            "part": self.part and self.part.as_dict(),
            "provenance": dict(self.provenance),
            "images": [entry.as_dict() for entry in self.images],
            "geometry": [entry.as_dict() for entry in self.geometry],
            "patches": self.patches,
            "files": dict(self.files),
            "warnings": list(self.warnings),
            **self.extra,
        }

    def to_json(self) -> str:
        """Text of ``manifest.json``."""
        return json.dumps(self.as_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
