"""Evaluate an inspection against ground truth: recall, false alarms, ROC, probability of detection.

Probability of detection against size is a hit/miss analysis as in MIL-HDBK-1823A, appendix G: logit POD = b₀ + b₁·ln
size, by maximum likelihood, and the bound of the size that is found 90 % of the time from the ratio of likelihoods.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import ndimage, optimize, special

from lightopt.config import PartConfig, load_part
from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.errors import InputError, refuse
from lightopt.core.provenance import file_sha256
from lightopt.core.transforms import Posture
from lightopt.defects import PlacedDefect, mark_surface
from lightopt.estimate.registration import Placement
from lightopt.images import ImageSet
from lightopt.inspection._results import InspectedPosture, InspectionResult
from lightopt.inspection.prediction._registered_set import world_to_mesh_file
from lightopt.scene import defect_facts

SLACK_PX = 2  # a region that comes this near to a labelled pixel is that defect's
MOST_TIMES = 10.0
# A region finds a defect only if it has at most this many times the defect's pixels, and this many more: one all over
# the part finds nothing. Defects of few pixels look larger, since they are found in sums over Gaussians.
MOST_MORE_PX = 50
_DISC = np.hypot(*np.mgrid[-SLACK_PX : SLACK_PX + 1, -SLACK_PX : SLACK_PX + 1]) <= SLACK_PX + 0.5
WANTED = 0.9
# twice the fall of the log-likelihood at a one-sided bound of 95 %: the square of the normal quantile 1.645
ONE_SIDED_95 = 2.7055
LEAST_DEFECTS = 8
STEEPEST = 200.0
# bounds beyond this many times the largest size are none; so many sizes are tried to begin with
FURTHEST, PLACES = 30.0, 120


@dataclass(frozen=True)
class TruthSource:
    """The source of ground truth for a set of images."""

    # whose defects are on the part; None where the set has labels, or it was rendered without defects
    part: PartConfig | None = None
    warnings: tuple[str, ...] = ()


def truth_source(image_set: ImageSet, part: PartConfig) -> TruthSource:
    """The source that determines which defects are on the part of a set.

    Its labels; else, of a set that lightopt rendered, that there are none; else the part file that it was taken by,
    which is `part`, or lies beside it with the content that it had. A set without the name of its part file, or taken
    by this file before it was edited, has the defects that `part` names.

    part: That the images are inspected by.
    """
    manifest = image_set.manifest
    if isinstance(manifest.extra.get("defects"), list):
        labelled = {entry.posture for entry in image_set.geometry}
        lacking = {entry.posture: None for entry in image_set.images if entry.posture not in labelled}
        if lacking:
            raise _labels_missing(image_set, lacking)
        return TruthSource()
    if manifest.kind == "simulated" and manifest.lightopt is not None:
        return TruthSource()
    own = manifest.part
    unchanged = own is not None and own.sha256 == part.source.sha256
    if own is not None and not unchanged and own.file != part.source.path.name:
        beside = part.source.path.parent / own.file
        if not beside.is_file() or file_sha256(beside) != own.sha256:
            raise InputError(
                f"{image_set.folder}: no ground truth for this part: the images have no labels, and their part file "
                f"{own.file} is not beside {part.source.path} or has changed; put it there"
            )
        part, unchanged = load_part(beside), True
    if part.defects:
        return TruthSource(part)
    if own is not None and unchanged:
        good = f"ground truth: {own.file}, with which the set was captured, lists no defects; the part counts as good"
        return TruthSource(part, warnings=(good,))
    raise InputError(
        f"{image_set.folder}: no ground truth for this part: the images have no labels, and {part.source.path}, which "
        "has changed since the capture, lists no defects; give the part file that lists those in the images"
    )


def truth_sources(sets: Sequence[ImageSet], part: PartConfig) -> list[TruthSource]:
    """The sources of ground truth of several sets, by :func:`truth_source`.

    Raises InputError: the problems of all sets together.
    """
    problems: list[str] = []

    def source(image_set: ImageSet) -> TruthSource:
        try:
            return truth_source(image_set, part)
        except InputError as error:
            problems.extend(error.messages)
            return TruthSource()

    sources = [source(image_set) for image_set in sets]
    refuse(problems)
    return sources


def true_labels(
    image_set: ImageSet, result: InspectionResult, *, known: Sequence[PlacedDefect]
) -> tuple[Sequence[Mapping[str, Any]], list[Int32], Literal["images", "part file", "no defects"]]:
    """The labels of a set; of one without labels those of known defects where the inspection found the part.

    Returns of each defect what :func:`lightopt.scene.defect_facts` gives, per posture the index of the defect that each
    pixel shows, −1 for none, shape (H, W), and whether the set was rendered with them or they are cast.

    known: defects of the part, in the frame of the inspection's nominal scene (:func:`lightopt.scene.place_defects`);
        empty where it has none.
    """
    listed = image_set.manifest.extra.get("defects")
    if isinstance(listed, list):
        return listed, [_stored(image_set, posture) for posture in result.postures], "images"
    arrays = [_cast(posture, result, known) for posture in result.postures]
    facts = defect_facts(known, result.nominal.placement)
    return facts, arrays, "part file" if known else "no defects"


def _stored(image_set: ImageSet, posture: InspectedPosture) -> Int32:
    entries = [g for g in image_set.geometry if g.posture == posture.view.posture]
    channels = image_set.load_geometry(entries[0]) if entries else {}
    if "defect" not in channels:
        raise _labels_missing(image_set, [posture.view.posture])
    labels = channels["defect"]
    if labels.shape != posture.labels.shape:
        raise InputError(
            f"{image_set.path(entries[0].exr)}: labels of {labels.shape[1]} × {labels.shape[0]} px for images of "
            f"{posture.labels.shape[1]} × {posture.labels.shape[0]} px"
        )
    return labels.astype(np.int32)


def _labels_missing(image_set: ImageSet, postures: Iterable[Posture]) -> InputError:
    return InputError(
        f"{image_set.folder}: no labels of defects for {', '.join(f'posture {p}' for p in postures)}, though the "
        "manifest lists defects; expected a geometry EXR with a channel defect; render the set anew"
    )


def _cast(posture: InspectedPosture, result: InspectionResult, known: Sequence[PlacedDefect]) -> Int32:
    # what the prediction's rays met, taken back to where the part's file has it
    geometry, nominal = posture.view.prediction.images.geometry, result.nominal
    placement, file = result.placement or Placement(), nominal.placement
    row, column = np.nonzero(geometry.hit)

    def to_mesh_file(vectors: Float32, *, direction: bool) -> Float64:
        own = vectors[row, column].astype(np.float64)
        return world_to_mesh_file(own, nominal, placement, posture.view.posture, direction=direction)

    points = to_mesh_file(geometry.points, direction=False) @ file.rotation.T + file.translation
    normals = to_mesh_file(geometry.normals, direction=True) @ file.rotation.T
    labels = np.full(geometry.hit.shape, -1, np.int32)
    marks = mark_surface(known, points, normals)
    if marks is not None:
        labels[row[marks.index], column[marks.index]] = marks.label
    return labels


@dataclass(frozen=True)
class KnownDefect:
    """A defect that the images show, and whether it was found."""

    name: str
    kind: str
    size: float  # square root of length times width of its outline [mm]
    pixels: int  # of it that can be judged, in the posture that shows most of them
    posture: Posture
    found: bool  # whether a region that is not far larger than it touches it in any posture

    def as_dict(self) -> dict[str, Any]:
        facts = {"name": self.name, "kind": self.kind, "size_mm": round(self.size, 5), "pixels": self.pixels}
        return {**facts, "posture": self.posture.as_dict(), "found": self.found}


@dataclass(frozen=True, kw_only=True)
class SetEvaluation:
    """The evaluation of one set of images against ground truth."""

    # those with a pixel that can be judged in some posture, and the names of the others
    defects: tuple[KnownDefect, ...]
    hidden: tuple[str, ...]
    false_alarms: int  # regions that touch no defect, or are far larger than those they touch, over all postures
    postures: int
    areas: tuple[float, ...]  # area under the ROC of the score, pixel by pixel, of each posture that shows a defect
    labels: Literal["images", "part file", "no defects"] = "images"  # the source of ground truth
    name: str = ""

    def as_dict(self) -> dict[str, Any]:
        """JSON form, without its defects."""
        counts = {"defects": len(self.defects), "found": sum(one.found for one in self.defects)}
        rest = {"hidden": list(self.hidden), "false_alarms": self.false_alarms}
        return {"set": self.name, "labels": self.labels, **counts, **rest}


def evaluate_set(image_set: ImageSet, result: InspectionResult, *, known: Sequence[PlacedDefect]) -> SetEvaluation:
    """Compare an inspection with the labels of its images, or with `known` defects where these have none.

    Raises InputError: labels are missing, or they are those of images of another size.
    """
    listed, labels, source = true_labels(image_set, result, known=known)
    pixels = np.zeros((len(result.postures), len(listed)), np.intp)
    found = np.zeros(len(listed), np.bool_)
    false_alarms = 0
    areas: list[float] = []
    for number, (posture, truth) in enumerate(zip(result.postures, labels, strict=True)):
        clean = posture.view.clean
        mine = np.bincount(truth[clean & (truth >= 0)], minlength=len(listed))
        pixels[number] = mine[: len(listed)]
        for hit in region_hits(posture.labels, truth):
            found[hit] = True
            false_alarms += not len(hit)
        if mine.any():
            areas.append(area_under_roc(posture.score[clean].astype(np.float64), truth[clean] >= 0))
    defects: list[KnownDefect] = []
    for one, own, hit in zip(listed, pixels.T, found.tolist(), strict=True):
        name, kind, posture = str(one["name"]), str(one["kind"]), result.postures[int(own.argmax())].view.posture
        defects.append(KnownDefect(name, kind, defect_size(one), int(own.max()), posture, found=hit))
    return SetEvaluation(
        defects=tuple(d for d in defects if d.pixels),
        hidden=tuple(d.name for d in defects if not d.pixels),
        false_alarms=false_alarms,
        postures=len(result.postures),
        areas=tuple(areas),
        labels=source,
        name=image_set.folder.resolve().name,
    )


def defect_size(one: Mapping[str, Any]) -> float:
    """Size of a defect of a set's manifest, for curves of detection: square root of length times width [mm]."""
    return float(np.sqrt(np.prod(one["size_mm"])))


def region_hits(labels: Int32, truth: Int32) -> list[Int32]:
    """For each region the defects that it finds: those that it touches, unless it is far larger than all of them.

    labels: Number of the region of each pixel, from 1, 0 for none, shape (H, W).
    truth: Index of the defect of each pixel, −1 for none, same shape.
    """
    hits: list[Int32] = []
    size = np.bincount(truth[truth >= 0], minlength=1)
    for number, box in enumerate(ndimage.find_objects(labels), start=1):
        if box is None:
            continue
        around = tuple(slice(max(0, side.start - SLACK_PX), side.stop + SLACK_PX) for side in box)
        region = labels[around] == number
        near = np.asarray(ndimage.binary_dilation(region, _DISC), np.bool_)
        touched = np.unique(truth[around][near & (truth[around] >= 0)])
        room = MOST_TIMES * float(size[touched].sum()) + MOST_MORE_PX
        hits.append(touched if np.count_nonzero(region) <= room else touched[:0])
    return hits


def area_under_roc(score: Float64, positive: Bool) -> float:
    """Probability that a positive scores more than a negative, ties counting half (Mann and Whitney)."""
    p = int(positive.sum())
    q = len(positive) - p
    _, which, times = np.unique(score, return_inverse=True, return_counts=True)
    # equal scores share the mean of their ranks
    ranks = (np.cumsum(times) - 0.5 * (times - 1))[which]
    return (float(ranks[positive].sum()) - 0.5 * p * (p + 1)) / (p * q)


def summarise(sets: Sequence[SetEvaluation]) -> dict[str, Any]:
    """Recall by kind and size, false alarms per posture, ROC and detection curves over all sets; JSON form."""
    defects = [defect for one in sets for defect in one.defects]
    kinds = sorted({d.kind for d in defects})
    postures = sum(one.postures for one in sets)
    areas = [area for one in sets for area in one.areas]
    return {
        "defects": len(defects),
        "found": sum(d.found for d in defects),
        "labels": sorted({one.labels for one in sets}),
        "hidden": [name for one in sets for name in one.hidden],
        "false_alarms_per_posture": round(sum(one.false_alarms for one in sets) / max(postures, 1), 4),
        "roc_auc": round(float(np.mean(areas)), 5) if areas else None,
        "recall": [
            {"kind": kind, "size_mm": size, "defects": len(mine), "found": sum(d.found for d in mine)}
            for kind in kinds
            for size in sorted({round(d.size, 3) for d in defects if d.kind == kind})
            for mine in [[d for d in defects if d.kind == kind and round(d.size, 3) == size]]
        ],
        "detection": {
            kind: fit_detection_curve([d.size for d in mine], [d.found for d in mine]).as_dict()
            for kind in ("all", *kinds)
            for mine in [[d for d in defects if kind in ("all", d.kind)]]
        },
        "each": [{"set": one.name, **d.as_dict()} for one in sets for d in one.defects],
        "sets": [one.as_dict() for one in sets],
    }


@dataclass(frozen=True)
class DetectionCurve:
    defects: int
    found: int
    # b₀ and b₁; None where hits and misses do not determine them: too few, all found or missed, or no rise with size
    intercept: float | None = None
    steepness: float | None = None
    a90: float | None = None  # size that is found 90 % of the time [mm]; None likewise
    a90_95: float | None = None  # its upper bound of 95 % confidence [mm]; None likewise, or where there is none

    def as_dict(self) -> dict[str, Any]:
        return {
            name: None if value is None else (value if isinstance(value, int) else float(f"{value:.6g}"))
            for name, value in vars(self).items()
        }


def fit_detection_curve(sizes: Sequence[float], found: Sequence[bool]) -> DetectionCurve:
    """Fit the curve of detection to the sizes of defects [mm] and whether each was found."""
    x, hit = np.log(np.asarray(sizes, np.float64)), np.asarray(found, np.bool_)
    n, k = len(x), int(hit.sum())
    if n < LEAST_DEFECTS or k in (0, n) or np.ptp(x) == 0.0:
        return DetectionCurve(n, k)
    goal = math.log(WANTED / (1.0 - WANTED))

    def likelihood(place: float, steepness: float) -> float:
        # of a curve that is WANTED at ln size `place`
        eta = goal + steepness * (x - place)
        return float(np.sum(np.where(hit, special.log_expit(eta), special.log_expit(-eta))))

    def best_at(place: float) -> tuple[float, float]:
        # the steepness that suits, and its likelihood
        answer = optimize.minimize_scalar(
            lambda s: -likelihood(place, math.exp(s)), bounds=(math.log(1e-2), math.log(STEEPEST)), method="bounded"
        )
        return math.exp(float(answer.x)), -float(answer.fun)  # pyright: ignore[reportAttributeAccessIssue]

    reach = math.log(FURTHEST)
    places = np.linspace(x.min() - reach, x.max() + reach, PLACES)
    values = np.array([best_at(float(place))[1] for place in places])
    top = int(values.argmax())
    if top in (0, len(places) - 1):
        return DetectionCurve(n, k)
    answer = optimize.minimize_scalar(
        lambda place: -best_at(place)[1], bounds=(places[top - 1], places[top + 1]), method="bounded"
    )
    place = float(answer.x)  # pyright: ignore[reportAttributeAccessIssue]
    steepness, most = best_at(place)
    even = k * math.log(k / n) + (n - k) * math.log(1.0 - k / n)
    if most - even < 1e-6:
        return DetectionCurve(n, k)
    inside = (2.0 * (most - values) <= ONE_SIDED_95) & (places >= place)
    bound = None
    if inside.any() and not inside[-1]:
        last = int(np.flatnonzero(inside)[-1])
        ends = float(places[last]), float(places[last + 1])
        root: Any = optimize.bisect(lambda place: 2.0 * (most - best_at(place)[1]) - ONE_SIDED_95, *ends)
        bound = math.exp(root)
    elif not inside.any():
        bound = math.exp(float(places[int(np.searchsorted(places, place))]))
    return DetectionCurve(n, k, goal - steepness * place, steepness, math.exp(place), bound)
