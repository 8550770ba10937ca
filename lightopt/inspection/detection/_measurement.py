"""Measure a region of high scores: place on the part, size, contrast under each light, kind."""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from lightopt.core.arrays import Float32, Float64, Index, Int32
from lightopt.estimate.registration import Placement
from lightopt.inspection.detection._defects import Detection, Kind
from lightopt.inspection.detection._deviation import Deviations
from lightopt.inspection.detection._regions import SHOWN_Z, box_sums, core_pixels
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.inspection.prediction._registered_set import world_to_mesh_file
from lightopt.scene import Scene

# lighter and darker places of which the weaker has this share of the stronger's deviation are those of a shape, …
LEAST_OPPOSITE = 0.35

# … and so are those of which the weaker is this many standard deviations off: beside a glint, of hundreds of them, what
# another wall loses is a small share, and no noise
CLEAR_OPPOSITE_Z = 8.0

EVEN_CONTRAST = 0.35  # a stain changes the light of every panel by the same share, within this share of it
MOST_BRIGHTER = 0.5  # what makes a surface brighter than this is no stain: it spreads a highlight


def measure_regions(
    labels: Int32,
    count: int,
    score: Float32,
    view: PostureView,
    found: Deviations,
    *,
    scene: Scene,
    placement: Placement,
) -> tuple[Detection, ...]:
    """Measure the regions of a posture.

    score: shape (H, W).
    """
    if not count:
        return ()
    detections: list[Detection] = []
    for number, box in enumerate(ndimage.find_objects(labels, count), start=1):
        assert box is not None  # each has its peak
        sums = box_sums(found, box)
        region = labels[box] == number
        row, column = np.nonzero(core_pixels(region, sums[0]))
        z = np.stack([level[:, row, column] for level in sums])
        row, column = row + box[0].start, column + box[1].start
        world = view.prediction.images.geometry.points[row, column].astype(np.float64)
        points = world_to_mesh_file(world, scene, placement, view.posture)
        points.flags.writeable = False
        normals = world_to_mesh_file(
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
        detections.append(
            Detection(
                posture=view.posture,
                pixels=len(row),
                centre_px=(float(column.mean()) + 0.5, float(row.mean()) + 0.5),
                box_px=(int(column.min()), int(row.min()), int(column.max()) + 1, int(row.max()) + 1),
                position=_triple(points[nearest]),
                normal=_triple(normal),
                size=_extents(points, normal, float(np.sqrt(area.mean()))),
                area=float(area.sum()),
                score=float(score[box][region].max()),
                contrast=contrast,
                kind=_kind(z, row, column, view, contrast),
                points=points,
            )
        )
    return tuple(detections)


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


def _triple(vector: Float64) -> tuple[float, float, float]:
    return float(vector[0]), float(vector[1]), float(vector[2])
