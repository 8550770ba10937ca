"""Defects: detections in the images of one posture, merged over the postures that show them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from scipy.spatial import KDTree

from lightopt.core.arrays import Float64
from lightopt.core.transforms import Posture
from lightopt.inspection.detection._named_defects import NamedDefect

Kind = Literal["shape", "stain", "unknown"]

KIND_COLOURS: Final[Mapping[Kind, tuple[int, int, int]]] = {
    "shape": (230, 60, 40),
    "stain": (60, 130, 230),
    "unknown": (240, 170, 30),
}
"""Red, green and blue of each kind, wherever it is drawn."""

NEAR_MM = 1.0
# detections in several postures are of one defect where points of both are within this distance, on surfaces whose
# normals differ by less than 60°
FACING = 0.5


@dataclass(frozen=True, kw_only=True)
class Detection:
    """A defect in the images of one posture."""

    posture: Posture
    pixels: int
    centre_px: tuple[float, float]  # column and row of the middle; pixel centres at +0.5
    box_px: tuple[int, int, int, int]  # first column and row, and those after the last
    # middle of its surface and the normal there, in the coordinates of the mesh file [mm]
    position: tuple[float, float, float]
    normal: tuple[float, float, float]
    size: tuple[float, float]  # extent along its longer and its shorter axis on the surface [mm]
    area: float  # of its surface [mm²]
    score: float  # −log₁₀ of the probability that noise alone looks as much like a defect
    # per light that shows it, greatest deviation as a share of the predicted light, with its sign; where that is darker
    # than one standard deviation of the noise, as a multiple of this
    contrast: dict[str, float]
    # ``shape`` where light and dark lie side by side or change with the light, ``stain`` where all lights lose (or
    # gain) the same share of diffuse light, ``unknown`` else
    kind: Kind
    # of its surface, one per pixel, in the coordinates of the mesh file [mm], shape (pixels, 3)
    points: Float64 = field(compare=False, repr=False)
    # what it is by the part's catalogue; None where the detector does not test for that, or no entry explains it
    named: NamedDefect | None = None

    @cached_property
    def surface(self) -> KDTree:
        """Its points, to measure distances from."""
        return KDTree(self.points)

    @property
    def greatest_contrast(self) -> float:
        """Magnitude of the contrast under the light that shows it best; 0 where no single light does."""
        return max((abs(c) for c in self.contrast.values()), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        return {
            "posture": self.posture.as_dict(),
            "pixels": self.pixels,
            "centre_px": _rounded(self.centre_px, 2),
            "box_px": list(self.box_px),
            "position_mm": _rounded(self.position, 4),
            "normal": _rounded(self.normal, 4),
            "size_mm": _rounded(self.size, 4),
            "area_mm2": round(self.area, 5),
            "score": round(self.score, 2),
            "contrast": {light: round(value, 4) for light, value in self.contrast.items()},
            "kind": self.kind,
            **({} if self.named is None else {"named": self.named.as_dict()}),
        }


@dataclass(frozen=True, kw_only=True)
class FoundDefect:
    """A defect, seen in one posture or in several."""

    number: int  # from 1, the highest score first
    detections: tuple[Detection, ...]

    @property
    def best(self) -> Detection:
        """The detection of the highest score, which gives place and kind."""
        return self.detections[0]

    @property
    def size(self) -> tuple[float, float]:
        """Of the longest detection, along its longer and its shorter axis [mm]."""
        return max(s.size for s in self.detections)

    @property
    def lights(self) -> tuple[str, ...]:
        """Those that show it by themselves in any posture, sorted by name."""
        return tuple(sorted({light for s in self.detections for light in s.contrast}))

    @property
    def area(self) -> float:
        """Of the largest detection [mm²]."""
        return max(s.area for s in self.detections)

    @property
    def greatest_contrast(self) -> float:
        """Of all detections and lights, its magnitude."""
        return max(s.greatest_contrast for s in self.detections)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        best = self.best
        return {
            "number": self.number,
            "kind": best.kind,
            "position_mm": _rounded(best.position, 4),
            "normal": _rounded(best.normal, 4),
            "size_mm": _rounded(self.size, 4),
            "area_mm2": round(self.area, 5),
            "score": round(best.score, 2),
            "greatest_contrast": round(self.greatest_contrast, 4),
            "lights": list(self.lights),
            "sightings": [s.as_dict() for s in self.detections],
        }


def merge_detections(detections: Sequence[Detection]) -> tuple[FoundDefect, ...]:
    """Sightings of the same place in several postures are one defect; the highest score first.

    Regions of one posture are apart in its images and stay so: a defect has one detection of a posture at most. Of
    several in reach of a detection the nearest outline is the same defect.
    """
    order = sorted(detections, key=lambda s: (-s.score, s.position))
    groups: list[list[Detection]] = []
    for detection in order:
        others = [group for group in groups if all(other.posture != detection.posture for other in group)]
        distances = [min(_distance(detection, other) for other in group) for group in others]
        if min(distances, default=math.inf) <= NEAR_MM:
            others[distances.index(min(distances))].append(detection)
        else:
            groups.append([detection])
    return tuple(FoundDefect(number=i + 1, detections=tuple(group)) for i, group in enumerate(groups))


def _distance(a: Detection, b: Detection) -> float:
    # least distance of two outlines [mm]; infinite on surfaces that face elsewhere
    if sum(x * y for x, y in zip(a.normal, b.normal, strict=True)) < FACING:
        return math.inf
    return float(np.min(a.surface.query(b.points, distance_upper_bound=2.0 * NEAR_MM)[0]))


def _rounded(values: Sequence[float], digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
