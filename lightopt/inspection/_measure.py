"""What is known of a region of high scores: where on the part it is, how large, which lights show it, and its kind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import KDTree

from lightopt.align import Placement
from lightopt.inspection._deviation import Deviations
from lightopt.inspection._filter import gaussian_taps
from lightopt.inspection._score import SCALES_PX, smoothed_deviations
from lightopt.inspection._view import PostureView
from lightopt.scene import Scene, view_from_part
from lightopt.transforms import Posture, rotation_z

__all__ = ["FoundDefect", "Sighting", "gather", "measure_regions", "to_file"]

Float64 = NDArray[np.float64]

SHOWN_Z = 4.0
"""A light shows a defect where a sum over a Gaussian is this many standard deviations off."""

LEAST_OPPOSITE = 0.35
"""Lighter and darker places of which the weaker has this share of the stronger's deviation are those of a shape."""

EVEN_CONTRAST = 0.35
"""A stain changes the light of every panel by the same share, within this share of it."""

MOST_BRIGHTER = 0.5
"""What makes a surface brighter than this is no stain: it spreads a highlight."""

OUTLINE_SHARE = 0.35
"""A defect reaches to where the sum over the narrowest Gaussian is this share of its greatest."""

NEAR_MM = 1.0
FACING = 0.5
"""Sightings in several postures are of one defect where points of both are within this distance, on surfaces whose
normals differ by less than 60°."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """A defect in the images of one posture.

    Attributes
    ----------
    posture
        Of the part.
    pixels
        Number of them.
    centre_px
        Column and row of the middle; pixel centres at +0.5.
    box_px
        First column and row, and those after the last.
    position, normal
        Middle of its surface and the normal there, in the coordinates of the mesh file [mm].
    size
        Extent along its longer and its shorter axis on the surface [mm].
    area
        Of its surface [mm²].
    score
        −log₁₀ of the probability that noise alone looks as much like a defect.
    contrast
        Per light that shows it, greatest deviation as a share of the predicted light, with its sign.
    kind
        ``shape`` where light and dark lie side by side or change with the light, ``stain`` where all lights lose (or
        gain) the same share, ``unknown`` else.
    points
        Of its surface, one per pixel, in the coordinates of the mesh file [mm], shape (pixels, 3).
    """

    posture: Posture
    pixels: int
    centre_px: tuple[float, float]
    box_px: tuple[int, int, int, int]
    position: tuple[float, float, float]
    normal: tuple[float, float, float]
    size: tuple[float, float]
    area: float
    score: float
    contrast: dict[str, float]
    kind: Literal["shape", "stain", "unknown"]
    points: Float64 = field(compare=False, repr=False)

    @cached_property
    def surface(self) -> KDTree:
        """Its points, to measure distances from."""
        return KDTree(self.points)

    @property
    def greatest_contrast(self) -> float:
        """Magnitude of the contrast under the light that shows it best; 0 where no single light does."""
        return max((abs(c) for c in self.contrast.values()), default=0.0)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
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
        }


@dataclass(frozen=True, kw_only=True)
class FoundDefect:
    """A defect, seen in one posture or in several.

    Attributes
    ----------
    number
        From 1, the highest score first.
    sightings
        The highest score first.
    """

    number: int
    sightings: tuple[Sighting, ...]

    @property
    def best(self) -> Sighting:
        """The sighting of the highest score, which place and kind are from."""
        return self.sightings[0]

    @property
    def size(self) -> tuple[float, float]:
        """Of the longest sighting, along its longer and its shorter axis [mm]."""
        return max(s.size for s in self.sightings)

    @property
    def area(self) -> float:
        """Of the largest sighting [mm²]."""
        return max(s.area for s in self.sightings)

    @property
    def greatest_contrast(self) -> float:
        """Of all sightings and lights, its magnitude."""
        return max(s.greatest_contrast for s in self.sightings)

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
            "lights": sorted({light for s in self.sightings for light in s.contrast}),
            "sightings": [s.as_dict() for s in self.sightings],
        }


def to_file(
    points: Float64, scene: Scene, placement: Placement, posture: Posture, *, direction: bool = False
) -> Float64:
    """World points of a placed part in a posture, shape (k, 3), in the coordinates of the mesh file [mm].

    Parameters
    ----------
    points
        World frame [mm], or unit vectors with `direction`.
    scene
        Whose mesh lies where its file has it.
    placement
        From there to where the part lies.
    posture
        Of the part.
    direction
        Whether vectors are turned only.
    """
    view = view_from_part(scene, posture)
    turn = rotation_z(placement.turn)
    file = scene.placement
    if direction:
        return points @ view.rotation @ turn @ file.rotation
    on_stage = (points - view.translation) @ view.rotation
    shift = np.array([placement.x, placement.y, 0.0])
    own = (on_stage - scene.pivot - shift) @ turn + scene.pivot
    return (own - file.translation) @ file.rotation


def measure_regions(
    labels: NDArray[np.int32],
    count: int,
    score: NDArray[np.float32],
    view: PostureView,
    found: Deviations,
    *,
    scene: Scene,
    placement: Placement,
) -> tuple[Sighting, ...]:
    """Measure the regions of a posture.

    Parameters
    ----------
    labels, count
        From :func:`lightopt.inspection._regions.find_regions`.
    score
        Shape (H, W).
    view, found
        Of the posture.
    scene, placement
        Where the part's file has it, and where it lies from there.
    """
    if not count:
        return ()
    sightings: list[Sighting] = []
    for number, box in enumerate(ndimage.find_objects(labels, count), start=1):
        assert box is not None  # each has its peak
        sums = _sums(found, box)
        row, column = _outline(labels[box] == number, sums[0])
        z = np.stack([level[:, row, column] for level in sums])
        row, column = row + box[0].start, column + box[1].start
        world = view.prediction.images.geometry.points[row, column].astype(np.float64)
        points = to_file(world, scene, placement, view.posture)
        points.flags.writeable = False
        normals = to_file(
            view.prediction.images.geometry.normals[row, column].astype(np.float64),
            scene,
            placement,
            view.posture,
            direction=True,
        )
        area = view.prediction.area[row, column].astype(np.float64)
        normal = normals.mean(axis=0)
        normal /= np.linalg.norm(normal)
        middle = np.average(points, axis=0, weights=area)
        nearest = int(np.argmin(np.sum((points - middle) ** 2, axis=1)))
        contrast = _contrasts(z, row, column, view)
        sightings.append(
            Sighting(
                posture=view.posture,
                pixels=len(row),
                centre_px=(float(column.mean()) + 0.5, float(row.mean()) + 0.5),
                box_px=(int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1),
                position=_triple(points[nearest]),
                normal=_triple(normal),
                size=_extents(points, normal, float(np.sqrt(area.mean()))),
                area=float(area.sum()),
                score=float(score[row, column].max()),
                contrast=contrast,
                kind=_kind(z, row, column, view, contrast),
                points=points,
            )
        )
    return tuple(sightings)


def gather(sightings: Sequence[Sighting]) -> tuple[FoundDefect, ...]:
    """Sightings of the same place in several postures are one defect; the highest score first.

    Regions of one posture are apart in its images and stay so: a defect has one sighting of a posture at most. Of
    several in reach of a sighting the nearest outline is the same defect.
    """
    order = sorted(sightings, key=lambda s: (-s.score, s.position))
    groups: list[list[Sighting]] = []
    for sighting in order:
        near = [
            (distance, i)
            for i, group in enumerate(groups)
            if all(other.posture != sighting.posture for other in group)
            for distance in [min(_apart(sighting, other) for other in group)]
            if distance <= NEAR_MM
        ]
        if near:
            groups[min(near)[1]].append(sighting)
        else:
            groups.append([sighting])
    return tuple(FoundDefect(number=i + 1, sightings=tuple(group)) for i, group in enumerate(groups))


def _sums(found: Deviations, box: tuple[slice, slice]) -> list[NDArray[np.float32]]:
    # sums over each Gaussian in a box of pixels, from what lies around it as far as the Gaussians reach
    reach = len(gaussian_taps(max(SCALES_PX))) // 2
    rows, columns = (slice(max(0, side.start - reach), side.stop + reach) for side in box)
    around = Deviations(
        found.z[:, rows, columns], found.scale[:, rows, columns], found.usable[:, rows, columns]
    )
    inner = tuple(
        slice(side.start - wide.start, side.stop - wide.start)
        for side, wide in zip(box, (rows, columns), strict=True)
    )
    return [smoothed_deviations(around, scale, threads=1)[0][(slice(None), *inner)] for scale in SCALES_PX]


def _outline(
    region: NDArray[np.bool_], fine: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    # pixels of a region whose own deviation is not only that of neighbours, spread by sums over Gaussians
    row, column = np.nonzero(region)
    size = np.abs(fine[:, row, column]).max(axis=0)
    core = size >= OUTLINE_SHARE * float(size.max())
    return row[core], column[core]


def _apart(a: Sighting, b: Sighting) -> float:
    # least distance of two outlines [mm]; infinite on surfaces that face elsewhere
    if sum(x * y for x, y in zip(a.normal, b.normal, strict=True)) < FACING:
        return math.inf
    return float(np.min(a.surface.query(b.points, distance_upper_bound=2.0 * NEAR_MM)[0]))


def _extents(points: Float64, normal: Float64, pixel: float) -> tuple[float, float]:
    # along the principal axes in the tangent plane, pixels counted whole
    offset = points - points.mean(axis=0)
    offset -= np.outer(offset @ normal, normal)
    _, _, axes = np.linalg.svd(offset, full_matrices=False)
    along = offset @ axes[:2].T
    if len(points) < 2:
        return pixel, pixel
    span = along.max(axis=0) - along.min(axis=0) + pixel
    return float(span.max()), float(span.min())


def _contrasts(
    z: NDArray[np.float32], row: NDArray[np.intp], column: NDArray[np.intp], view: PostureView
) -> dict[str, float]:
    # z of shape (scales, lights, pixels)
    result: dict[str, float] = {}
    for i, light in enumerate(view.lights):
        if float(np.abs(z[:, i]).max()) < SHOWN_Z:
            continue
        at = int(np.abs(z[:, i]).max(axis=0).argmax())
        window = slice(max(0, row[at] - 1), row[at] + 2), slice(max(0, column[at] - 1), column[at] + 2)
        limit = view.limit[i][window]
        seen = float(np.minimum(view.level[i][window], limit).mean())
        model = float(np.clip(view.predicted[i][window], 0.0, limit).mean())
        result[light] = (seen - model) / max(model, 1e-6)
    return result


def _kind(
    z: NDArray[np.float32],
    row: NDArray[np.intp],
    column: NDArray[np.intp],
    view: PostureView,
    contrast: dict[str, float],
) -> Literal["shape", "stain", "unknown"]:
    up = np.maximum(z.max(axis=(0, 2)), 0.0)
    down = np.maximum(-z.min(axis=(0, 2)), 0.0)
    shown = np.maximum(up, down) >= SHOWN_Z
    if not shown.any():
        return "unknown"
    weaker, stronger = min(up[shown].max(), down[shown].max()), max(up[shown].max(), down[shown].max())
    if weaker >= SHOWN_Z and weaker >= LEAST_OPPOSITE * stronger:
        return "shape"
    # stains change diffuse light: highlights do not tell
    diffuse = view.specular[:, row, column] < 0.2 * view.predicted[:, row, column]
    diffuse &= ~view.saturated[:, row, column]
    shares: list[float] = []
    peaks: list[float] = []
    for i in np.flatnonzero(shown):
        if diffuse[i].sum() >= 0.5 * len(row):
            here = diffuse[i]
            model = float(view.predicted[i, row, column][here].sum(dtype=np.float64))
            shares.append(
                float(view.level[i, row, column][here].sum(dtype=np.float64)) / max(model, 1e-6) - 1.0
            )
            peaks.append(contrast[view.lights[i]])
    if len(shares) < 2:
        return "unknown"
    brighter = sum(shares) / len(shares) > MOST_BRIGHTER
    return "stain" if _even(shares) and _even(peaks) and not brighter else "unknown"


def _even(shares: Sequence[float]) -> bool:
    mean = sum(shares) / len(shares)
    return max(abs(share - mean) for share in shares) <= EVEN_CONTRAST * abs(mean)


def _triple(vector: Float64) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])


def _rounded(values: Sequence[float], digits: int) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in values]
