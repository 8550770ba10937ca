"""Defects: detections in the images of one posture, named by the catalogue, merged over the postures that show them.

The catalogue tells kind, size, orientation, slope or depth, with intervals.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from lightopt import defects
from lightopt.core.arrays import Bool, Float64, Int32
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Placement
from lightopt.inspection.detection._catalogue_score import ExplainedDefect
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._registered_set import world_to_mesh_file
from lightopt.scene import Scene

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

NORMAL_95: Final = 1.959964
GAP_PX = 3  # what is this near to each other is one defect: segments of a scratch, or two walls of a dent

# deviations that go beyond explained defects by more than this share of their pixels are not described by them
_DESCRIBED = 1.0

# besides the noise: sizes lie far apart, so that the size between them is off by about this share, and of a narrow
# defect by so much of a pixel, since a narrower and steeper one changes the images nearly alike
SIZE_ERROR, SIZE_ERROR_PX = 0.1, 0.5

OPPOSITE: Final[Mapping[defects.DefectKind, defects.DefectKind]] = {
    "dent": "bump",
    "bump": "dent",
    "blister": "dent",
    "pit": "bump",
}
"""Kind of a defect whose walls lean the other way than the hypothesis' do."""

DISC = np.hypot(*np.mgrid[-GAP_PX : GAP_PX + 1, -GAP_PX : GAP_PX + 1]) <= GAP_PX + 0.5


@dataclass(frozen=True, kw_only=True)
class NamedDefect:
    """What a detection is by the catalogue. Intervals are of 95 %, if it is of this kind; None where unknown."""

    entry: str  # name of the catalogue's entry that explains it best
    kind: defects.DefectKind  # of that entry, or the opposite: where a bump's walls lean the other way, it is a dent
    # [mm], with intervals
    length: tuple[float, float, float]
    width: tuple[float, float, float]
    direction: float | None  # of the length, as part files count it [rad]; None for a round one
    amplitude: tuple[float, float, float] | None  # of its effect, as a multiple of the entry's, with its interval
    # steepest slope of its walls [rad], and depth: [mm], with intervals; None for kinds that have none
    slope: tuple[float, float, float] | None
    depth: tuple[float, float, float] | None
    # by which R_d (stain) or σ (haze) is multiplied, with its interval; None for other kinds
    factor: tuple[float, float, float] | None
    z: float  # the statistic of all images together
    evidence: dict[str, float]  # per light what it adds to `z`

    def as_dict(self) -> dict[str, Any]:
        """JSON form; values before their intervals."""

        def shown(value: tuple[float, float, float] | None, degrees: bool = False) -> list[float] | None:
            scale = math.degrees(1.0) if degrees else 1.0
            return None if value is None else [round(scale * one, 4) for one in value]

        return {
            "entry": self.entry,
            "kind": self.kind,
            "length_mm": shown(self.length),
            "width_mm": shown(self.width),
            "direction_deg": None if self.direction is None else round(math.degrees(self.direction), 1),
            "amplitude": shown(self.amplitude),
            "slope_deg": shown(self.slope, degrees=True),
            "depth_mm": shown(self.depth),
            "factor": shown(self.factor),
            "z": round(self.z, 2),
            "evidence": {light: round(value, 2) for light, value in self.evidence.items()},
        }


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


def join_explained(
    labels: Int32, count: int, explained: Sequence[ExplainedDefect]
) -> tuple[Int32, int, dict[int, tuple[ExplainedDefect, ...]]]:
    """Regions of explained defects, and those of other deviations that are apart from them.

    Number of the region of each pixel, how many there are, and by number of the region the defects that it is of. Other
    deviations that touch one region belong to it. Where they go far beyond the defects that they touch, the catalogue
    does not describe what is there: the region has all of them, and is of none of these defects.

    labels, count: Of the other deviations.
    """
    if not explained:
        return labels, count, {}
    mask = np.zeros(labels.shape, np.bool_)
    for one in explained:
        mask[one.rows, one.columns] = True
    wide = np.asarray(ndimage.binary_dilation(mask, DISC), np.bool_)
    near, number = label_connected(wide)
    # regions of either kind that touch are one
    touching = np.unique(np.stack([labels[wide], near[wide]]), axis=1)
    touching = touching[:, touching[0] > 0]
    beyond = np.bincount(labels[~wide], minlength=count + 1)
    within = np.bincount(near[mask], minlength=number + 1)
    group = np.arange(number + 1)
    described = np.ones(number + 1, np.bool_)
    region_of = np.zeros(count + 1, np.intp)
    for label in np.unique(touching[0]).tolist():
        own = np.unique(group[touching[1, touching[0] == label]])
        if len(own) == 1:
            region_of[label] = own[0]
        if beyond[label] > _DESCRIBED * within[np.isin(group, own)].sum():
            region_of[label] = own[0]
            group[np.isin(group, own)] = own[0]
            described[own[0]] = False
    belongs = group[region_of[labels]]
    result = np.where(belongs > 0, belongs, np.where(mask, group[near], 0)).astype(np.int32)
    owners: dict[int, tuple[ExplainedDefect, ...]] = {}
    for one in explained:
        region = int(group[near[one.rows[0], one.columns[0]]])
        if described[region]:
            owners[region] = (*owners.get(region, ()), one)
    apart = np.setdiff1d(np.arange(1, count + 1), touching[0])
    new = np.zeros(count + 1, np.int32)
    new[apart] = number + np.arange(1, len(apart) + 1, dtype=np.int32)
    others = new[labels]
    return _renumbered(np.where(others > 0, others, result), owners)


def _renumbered(
    labels: Int32, owners: Mapping[int, tuple[ExplainedDefect, ...]]
) -> tuple[Int32, int, dict[int, tuple[ExplainedDefect, ...]]]:
    # without gaps, in the same order
    present = np.unique(labels[labels > 0])
    new = np.zeros(int(labels.max(initial=0)) + 1, np.int32)
    new[present] = np.arange(1, len(present) + 1, dtype=np.int32)
    return new[labels], len(present), {int(new[region]): some for region, some in owners.items() if new[region]}


def label_connected(mask: Bool) -> tuple[Int32, int]:
    """Number of the connected component of each pixel, across corners too, 0 for none; and how many there are."""
    number = np.zeros(mask.shape, np.int32)
    return number, int(ndimage.label(mask, np.ones((3, 3)), output=number))  # pyright: ignore[reportArgumentType]


def name_defect(
    explained: Sequence[ExplainedDefect],
    extent: float,  # of the region along its longer axis [mm]: the length of a scratch
    view: PostureView,
    found: Deviations,
    *,
    # where the part's file has it, and where it lies from there
    scene: Scene,
    placement: Placement,
) -> NamedDefect:
    """Name a region by the defects that explain it, the strongest of them first."""
    best = max(explained, key=lambda one: abs(one.z))
    hypotheses, shape = best.templates.hypotheses, best.templates.hypotheses.shapes[best.size]
    # segments of a scratch are measured together
    same = [one for one in explained if one.templates is best.templates and one.z * best.z > 0.0]
    sums, energies = (np.sum([getattr(one, name) for one in same], axis=0) for name in ("sums", "energies"))
    total = math.sqrt(float(energies.sum()))
    size = _size(best)
    opposite = OPPOSITE.get(shape.kind)
    kind = shape.kind if best.z > 0.0 or opposite is None else opposite
    middle = hypotheses.shapes[1]
    width, length = (triple(side * factor for factor in size) for side in (middle.width, middle.length))
    if shape.kind == "scratch":
        length = (extent, max(0.0, extent - shape.length), extent + shape.length)
    amplitude = _amplitude(same, found)
    slope = depth = factor = None
    if amplitude is not None and shape.kind in defects.SHAPE_KINDS:
        steepest, *ends = (math.tan(shape.slope) * a for a in amplitude)
        low, high = sorted(map(abs, ends))
        tangents = (abs(steepest), 0.0 if ends[0] * ends[1] < 0.0 else low, high)
        depth = triple(defects.depth_of_slope(kind, width[0], math.atan(t)) for t in tangents)
        # what is known of the size limits what is known of the slope
        slope = triple(
            math.atan(t * s) for t, s in zip(tangents, (1.0, size[1] / size[0], size[2] / size[0]), strict=True)
        )
    elif amplitude is not None:
        whole = shape.R_d_factor if shape.kind == "stain" else shape.sigma_factor
        # coefficients are not negative
        value, *ends = (max(0.0, 1.0 + a * (whole - 1.0)) for a in amplitude)
        factor = (value, min(ends), max(ends))
    return NamedDefect(
        entry=hypotheses.entry.name,
        kind=kind,
        length=length,
        width=width,
        direction=None if len(hypotheses.turns) == 1 else _direction(best, view, scene, placement),
        amplitude=amplitude,
        slope=slope,
        depth=depth,
        factor=factor,
        z=float(sums.sum()) / total,
        evidence={light: float(u) / total for light, u in zip(view.lights, sums, strict=True)},
    )


def _amplitude(same: Sequence[ExplainedDefect], found: Deviations) -> tuple[float, float, float] | None:
    # as a multiple of the hypotheses', by least squares. Deviations are in units of what the surroundings show, the
    # expected changes in units of what was predicted
    product = square = variance = 0.0
    for one in same:
        place = (slice(None), one.rows, one.columns)
        unit = np.mean(found.scale[place] / one.templates.deviation[place], axis=1, dtype=np.float64)
        product += float(unit @ one.shares[:, 0])
        square += float(one.shares[:, 1].sum())
        variance += float(unit**2 @ one.shares[:, 1])
    if square <= 0.0:
        return None
    half = NORMAL_95 * math.sqrt(variance) / square
    return product / square, product / square - half, product / square + half


def _size(best: ExplainedDefect) -> tuple[float, float, float]:
    # as a multiple of the entry's: where a parabola through Z²/2, the logarithm of the likelihood, over the logarithm
    # of the size is greatest
    z = np.where(best.of_sizes * best.z > 0.0, best.of_sizes, 0.0)
    x = np.log(defects.SIZES)
    bend, slope, _ = np.polyfit(x, 0.5 * z**2, 2)
    if bend >= 0.0:
        middle, error = x[best.size], x[-1] - x[0]
    else:
        middle = float(np.clip(-0.5 * slope / bend, x[0], x[-1]))
        known = SIZE_ERROR_PX / best.templates.width_px
        error = math.hypot(SIZE_ERROR, known, (-2.0 * bend) ** -0.5)
    return triple(math.exp(middle + NORMAL_95 * side * error) for side in (0.0, -1.0, 1.0))


def _direction(best: ExplainedDefect, view: PostureView, scene: Scene, placement: Placement) -> float:
    # of the length, from the X axis of the mesh file in the tangent plane
    geometry = view.prediction.images.geometry
    normal = geometry.normals[best.middle].astype(np.float64)[None]
    towards = scene.camera.position - geometry.points[best.middle].astype(np.float64)[None]
    towards /= np.linalg.norm(towards)
    first = defects.tangent_axis(normal, defects.image_axes(towards, scene.camera.right)[0])[0]
    turn = float(best.templates.hypotheses.turns[best.pose // len(best.templates.halves)])
    along = math.cos(turn) * first + math.sin(turn) * np.cross(normal[0], first)
    vectors = world_to_mesh_file(np.stack([along, normal[0]]), scene, placement, view.posture, direction=True)
    axes = np.eye(3)
    reference = defects.tangent_references(vectors[1:], x_axis=axes[0], y_axis=axes[1])[0]
    angle = math.atan2(float(vectors[0] @ np.cross(vectors[1], reference)), float(vectors[0] @ reference))
    return angle % math.pi


def triple(values: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers, as they are kept and written."""
    value, low, high = values
    return float(value), float(low), float(high)
