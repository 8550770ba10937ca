"""Connected regions of high scores: found, split where wide Gaussians joined neighbours, measured as detections."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import cast

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Bool, Float32, Float64, Index, Int32
from lightopt.defects import SCALES_PX, SHAPE_KINDS
from lightopt.estimate.registration import Placement
from lightopt.inspection._image_blocks import gaussian_taps
from lightopt.inspection.detection._catalogue_score import ExplainedDefect
from lightopt.inspection.detection._defects import (
    DISC,
    GAP_PX,
    Detection,
    Kind,
    NamedDefect,
    label_connected,
    name_defect,
    triple,
)
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._residual_score import smoothed_deviations
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._registered_set import world_to_mesh_file
from lightopt.scene import Scene

LOW_SHARE = 0.5  # a region spreads from where it is certain to where its score is above this share of the threshold

# of a region remains what is above this share of the greatest score around, and its core: sums over Gaussians spread a
# strong defect beyond its outline …
PEAK_SHARE = 0.08

SPREAD_PX = 10  # … as far as this, the widest

# a defect reaches to where, under any light, the sum over the narrowest Gaussian is this share of the greatest of its
# sign around: what a wall darkens counts beside the glint of the wall across
OUTLINE_SHARE = 0.35

SHOWN_Z = 4.0  # a light shows a defect where a sum over a Gaussian is this many standard deviations off

# lighter and darker places of which the weaker has this share of the stronger's deviation are those of a shape, …
LEAST_OPPOSITE = 0.35

# … and so are those of which the weaker is this many standard deviations off: beside a glint, of hundreds of them, what
# another wall loses is a small share, and no noise
CLEAR_OPPOSITE_Z = 8.0

EVEN_CONTRAST = 0.35  # a stain changes the light of every panel by the same share, within this share of it
MOST_BRIGHTER = 0.5  # what makes a surface brighter than this is no stain: it spreads a highlight


def find_regions(score: Float32, high: float) -> tuple[Int32, int]:
    """Number of the region that each pixel belongs to, 0 for none, shape (H, W), and how many there are.

    Hysteresis: a region has a pixel of at least `high`, and spreads over what is connected to it and lower.
    """
    low = score >= LOW_SHARE * high
    number, count = label_connected(_dilated(low)[GAP_PX:-GAP_PX, GAP_PX:-GAP_PX])
    own = number[low]
    peak = np.zeros(count + 1)
    np.maximum.at(peak, own, score[low])
    certain = 1 + np.flatnonzero(peak[1:] >= high)
    new = np.zeros(count + 1, np.int32)
    new[certain] = np.arange(1, len(certain) + 1, dtype=np.int32)
    labels = np.zeros(score.shape, np.int32)
    labels[low] = new[own]
    return labels, len(certain)


def _dilated(mask: Bool) -> Bool:
    # pixels within GAP_PX of a mask, with a border of as many pixels; of few pixels a small part of SciPy's time
    dilated = np.zeros([side + 2 * GAP_PX for side in mask.shape], np.bool_)
    row, column = np.nonzero(mask)
    for down, right in np.argwhere(DISC):
        dilated[row + down, column + right] = True
    return dilated


def region_pixels(labels: Int32, count: int) -> list[tuple[Index, Index]]:
    """Rows and columns of each region's pixels, the first region first, in one pass over the image."""
    row, column = np.nonzero(labels)
    number = labels[row, column]
    order = np.argsort(number, kind="stable")
    ends = np.searchsorted(number[order], np.arange(1, count + 2))
    return [(row[order[a:b]], column[order[a:b]]) for a, b in pairwise(ends)]


def box_sums(found: Deviations, box: tuple[slice, slice], scales: Sequence[float] = SCALES_PX) -> list[Float32]:
    """Sums over each Gaussian in a box of pixels, shape (lights, rows, columns), from what lies around it in reach."""
    reach = len(gaussian_taps(max(scales))) // 2
    rows, columns = (slice(max(0, side.start - reach), side.stop + reach) for side in box)
    around = found.in_box(rows, columns)
    inner = tuple(
        slice(side.start - wide.start, side.stop - wide.start) for side, wide in zip(box, (rows, columns), strict=True)
    )
    return [smoothed_deviations(around, scale, threads=1)[0][(slice(None), *inner)] for scale in scales]


def core_pixels(region: Bool, fine: Float32) -> Bool:
    """Pixels of a region whose own deviation is not only that of neighbours, spread by sums; shape of the region.

    fine: sums over the narrowest Gaussian in the same box, shape (lights, rows, columns).
    """
    nothing = np.float32(0.0)
    core = np.zeros_like(region)
    for one in (*fine, *-fine):
        size = np.where(region, np.maximum(one, nothing), nothing)
        if float(size.max()) >= SHOWN_Z:
            around = ndimage.maximum_filter(size, 2 * SPREAD_PX + 1)
            core |= (size >= OUTLINE_SHARE * around) & (around >= SHOWN_Z)
    if core.any():
        return core
    # shown by no light alone, but by wider sums or by several lights
    size = np.where(region, np.abs(fine).max(axis=0), nothing)
    return region & (size >= OUTLINE_SHARE * ndimage.maximum_filter(size, 2 * SPREAD_PX + 1))


def split_regions(labels: Int32, count: int, score: Float32, found: Deviations, high: float) -> tuple[Int32, int]:
    """Remove what the sums only spread, and split regions whose cores lie apart, where each core would be a region.

    Returns Labels and number as given, parts of a region one after the other.
    """
    result, number = np.zeros_like(labels), 0
    boxes = cast("list[tuple[slice, slice]]", ndimage.find_objects(labels, count))  # each region has its peak
    for own, box in enumerate(boxes, start=1):
        region = labels[box] == own
        core = core_pixels(region, *box_sums(found, box, SCALES_PX[:1]))
        within = np.where(region, score[box], np.float32(0.0))
        region &= core | (within >= PEAK_SHARE * ndimage.maximum_filter(within, 2 * SPREAD_PX + 1))
        # cores within GAP_PX of each other are one, as in find_regions
        joined, most = label_connected(_dilated(core))
        cores = np.where(core, joined[GAP_PX:-GAP_PX, GAP_PX:-GAP_PX], np.int32(0))
        peak = ndimage.maximum(np.where(region, score[box], 0.0), cores, np.arange(1, most + 1))
        certain = 1 + np.flatnonzero(np.asarray(peak) >= high)
        if len(certain) < 2:
            result[box][region] = number + 1
            number += 1
            continue
        new = np.zeros(most + 1, np.int32)
        new[certain] = number + np.arange(1, len(certain) + 1, dtype=np.int32)
        seeds = new[cores]
        # what is between them goes to the nearest
        nearest = ndimage.distance_transform_edt(seeds == 0, return_distances=False, return_indices=True)
        row, column = cast("tuple[Int32, Int32]", nearest)
        result[box][region] = seeds[row, column][region]
        number += len(certain)
    return result, number


def measure_regions(
    labels: Int32,
    count: int,
    score: Float32,
    view: PostureView,
    found: Deviations,
    *,
    scene: Scene,
    placement: Placement,
    # by number of a region, the defects of the catalogue that it is of: they name it
    owners: Mapping[int, Sequence[ExplainedDefect]] = MappingProxyType({}),
) -> tuple[Detection, ...]:
    geometry = view.prediction.images.geometry
    detections: list[Detection] = []
    for number, box in enumerate(ndimage.find_objects(labels, count), start=1):
        assert box is not None  # each has its peak
        sums = box_sums(found, box)
        region = labels[box] == number
        explained = owners.get(number, ())
        row, column = np.nonzero(region if explained else core_pixels(region, sums[0]))
        z = np.stack([level[:, row, column] for level in sums])
        row, column = row + box[0].start, column + box[1].start
        world, facing = (a[row, column].astype(np.float64) for a in (geometry.points, geometry.normals))
        points = world_to_mesh_file(world, scene, placement, view.posture)
        points.flags.writeable = False
        normals = world_to_mesh_file(facing, scene, placement, view.posture, direction=True)
        area = view.prediction.area[row, column].astype(np.float64)
        normal = normals.mean(axis=0)
        normal /= np.linalg.norm(normal)
        middle = np.average(points, axis=0, weights=area)
        nearest = int(np.argmin(np.sum((points - middle) ** 2, axis=1)))
        contrast = _contrasts(z, row, column, view)
        size = _extents(points, normal, float(np.sqrt(area.mean())))
        kind, named = _kind(z, row, column, view, contrast), None
        if explained:
            named = name_defect(explained, size[0], view, found, scene=scene, placement=placement)
            # where the lights clearly show the other kind, no entry describes the defect
            if {kind, _kind_of(named)} == {"shape", "stain"}:
                named = None
            else:
                kind = _kind_of(named)
        detections.append(
            Detection(
                posture=view.posture,
                pixels=len(row),
                centre_px=(float(column.mean()) + 0.5, float(row.mean()) + 0.5),
                box_px=(int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1),
                position=triple(points[nearest]),
                normal=triple(normal),
                size=size,
                area=float(area.sum()),
                score=float(score[box][region].max()),
                contrast=contrast,
                kind=kind,
                points=points,
                named=named,
            )
        )
    return tuple(detections)


def _kind_of(named: NamedDefect) -> Kind:
    if named.kind in SHAPE_KINDS:
        return "shape"
    return "stain" if named.kind == "stain" else "unknown"


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


def _contrasts(z: Float32, row: Index, column: Index, view: PostureView) -> dict[str, float]:
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
        # a glint on a dark field is compared with the noise, since it would be any share of no light
        result[light] = (seen - model) / max(model, float(view.deviation[i][window].mean()))
    return result


def _kind(z: Float32, row: Index, column: Index, view: PostureView, contrast: dict[str, float]) -> Kind:
    up = np.maximum(z.max(axis=(0, 2)), 0.0)
    down = np.maximum(-z.min(axis=(0, 2)), 0.0)
    shown = np.maximum(up, down) >= SHOWN_Z
    if not shown.any():
        return "unknown"
    weaker, stronger = min(up[shown].max(), down[shown].max()), max(up[shown].max(), down[shown].max())
    if weaker >= SHOWN_Z and weaker >= min(LEAST_OPPOSITE * stronger, CLEAR_OPPOSITE_Z):
        return "shape"
    # stains change diffuse light, all of it by the same share: highlights do not count
    diffuse = view.specular[:, row, column] < 0.2 * view.predicted[:, row, column]
    diffuse &= ~view.saturated[:, row, column]
    both = np.where(diffuse.all(axis=1), np.minimum(up, down), 0.0)
    if np.count_nonzero((both >= SHOWN_Z) & (both >= LEAST_OPPOSITE * np.maximum(up, down))) >= 2:
        return "shape"
    if weaker >= SHOWN_Z:
        return "unknown"
    shares: list[float] = []
    peaks: list[float] = []
    for i in np.flatnonzero(shown):
        if diffuse[i].sum() >= 0.5 * len(row):
            here = diffuse[i]
            model = float(view.predicted[i, row, column][here].sum(dtype=np.float64))
            shares.append(float(view.level[i, row, column][here].sum(dtype=np.float64)) / max(model, 1e-6) - 1.0)
            peaks.append(contrast[view.lights[i]])
    if len(shares) < 2:
        return "unknown"
    brighter = sum(shares) / len(shares) > MOST_BRIGHTER
    return "stain" if _even(shares) and _even(peaks) and not brighter else "unknown"


def _even(shares: Sequence[float]) -> bool:
    mean = sum(shares) / len(shares)
    return max(abs(share - mean) for share in shares) <= EVEN_CONTRAST * abs(mean)
