"""Measure a mirror ball in images: its outline, and the quadrilateral as which it mirrors each panel.

Edges are where the level is halfway between both sides, to a fraction of a pixel. Of a saturated highlight nothing is
measured: its edge is displaced, and so is its centroid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from lightopt.core.arrays import Bool, Float64
from lightopt.core.errors import InputError
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._ball_fit import BallView, MirroredPanel
from lightopt.optics import Sensor

EDGE_BLUR = 1.2  # of the derivative that finds the outline [px]
SEARCH = 0.06  # how far the outline may be from the expected radius, as a share of it
RAYS = 360
LEAST_CONTRAST = 8.0  # of the outline's slope, in standard deviations of its noise
LEAST_RAYS = 60
OUTLIER = 4.0  # spreads

SMOOTHING = 0.6  # before an edge is interpolated between pixels, which a sharp one is not fit for [px]
# in standard deviations of the blur: from the edge of a highlight to the levels that its halfway level is of, and from
# the corners, which blur rounds off, to where the edge is measured
LEVEL_MARGIN, CORNER_MARGIN = 2.7, 2.7
LEAST_SIDE, LEAST_INNER = 12.0, 20  # of a highlight [px], and of its even middle [px²]
NEIGHBOURS = 2.0  # crossings of an edge that share one pixel's noise, by which the variance of the fit is more
LEAST_EDGE_ERROR = 0.02  # systematic error of a contour point [px]
SECOND = 0.3  # another highlight of this share of the area is one too many
SATURATED_PIXELS = 3
LEAST_SIGNAL = 20.0  # of a highlight above its surroundings, in standard deviations of the read noise


def measure_ball(
    highlights: Mapping[str, NDArray[Any]],
    *,
    posture: Posture,
    sensor: Sensor,
    radius_px: float,
    outline_images: Sequence[NDArray[Any]] = (),
) -> BallView:
    """Outline and mirrored panels of the ball in one posture.

    highlights: Images of the ball by the light that is on, so short that no highlight is saturated, shape (H, W)
        [sensor level]
    radius_px: Expected radius of the outline, image distance / pixel size · radius / distance [px]
    outline_images: Longer exposures, or images before a lit background, that show the outline better than all
        `highlights` together; shape (H, W)
    Raises InputError: Where a highlight is saturated, missing, too small or doubled, or the outline has no contrast;
        with a message for each
    """
    images = outline_images or list(highlights.values())
    total = np.sum([image.astype(np.float64) for image in images], axis=0)
    outline, error = _outline(total, radius_px, f"ball at {posture}")
    centre = outline.mean(axis=0)
    panels: dict[str, MirroredPanel] = {}
    problems: list[str] = []
    for name, image in highlights.items():
        try:
            panels[name] = mirrored_panel(image, sensor, centre, 0.97 * radius_px, where=f"{name} at {posture}")
        except InputError as problem:  # noqa: PERF203  (every light's problem is reported)
            problems += problem.messages
    if problems:
        raise InputError(*problems)
    return BallView(posture=posture, outline=outline, outline_error=error, panels=panels)


def mirrored_panel(
    image: NDArray[Any], sensor: Sensor, centre: Float64, radius_px: float, *, where: str
) -> MirroredPanel:
    """The quadrilateral as which the ball mirrors a panel.

    image: [sensor level], shape (H, W)
    centre, radius_px: Of the part of the image to search, (column, row) [px]
    Raises InputError: As :func:`measure_ball`
    """
    margin = int(np.ceil(radius_px))
    left, top = (max(0, int(value) - margin) for value in centre)
    level = image[top : int(centre[1]) + margin, left : int(centre[0]) + margin].astype(np.float64)
    rows, columns = np.indices(level.shape) + 0.5  # pixel centres
    columns, rows = columns + left, rows + top
    level = np.where(np.hypot(columns - centre[0], rows - centre[1]) <= radius_px, level, sensor.black_level)
    peak = float(ndimage.uniform_filter(level, 3).max())
    body = float(np.median(level))
    if peak - body < LEAST_SIGNAL * max(sensor.read_noise_levels, 0.3):
        raise InputError(f"{where}: no highlight: is the light on? Else expose longer")
    region, number = ndimage.label(level > 0.5 * (peak + body))
    areas = np.asarray(ndimage.sum_labels(np.ones_like(level), region, np.arange(1, number + 1)))
    largest = int(np.argmax(areas)) + 1
    mask: Bool = region == largest
    burnt = int(np.sum(level[mask] >= sensor.saturated_from))
    if burnt >= SATURATED_PIXELS:
        raise InputError(
            f"{where}: {burnt} of {int(areas[largest - 1])} pixels of the highlight are saturated: its edge is not "
            "where the panel's is; expose it shorter, to about 80 % of saturation"
        )
    if np.sum(areas > SECOND * areas[largest - 1]) > 1:
        raise InputError(f"{where}: more than one highlight: is another light on, or does the ball mirror something?")
    points = np.stack([columns[mask], rows[mask]], axis=1)
    quad = _quadrilateral(points)
    if np.sqrt(areas[largest - 1]) < LEAST_SIDE:
        raise InputError(
            f"{where}: the mirrored panel is about {np.sqrt(areas[largest - 1]):.0f} pixels wide, {LEAST_SIDE:.0f} are "
            "needed: take a larger ball"
        )
    level = np.asarray(ndimage.gaussian_filter(level, SMOOTHING))
    # of an edge blurred by a Gaussian two standard deviations are between 16 and 84 %
    depth = np.asarray(ndimage.distance_transform_edt(mask)) - np.asarray(ndimage.distance_transform_edt(~mask))
    share = (level - body) / (float(np.median(level[mask])) - body)
    between = np.sum((share > 0.159) & (share < 0.841) & (np.abs(depth) < 0.3 * np.sqrt(areas[largest - 1])))
    blur = max(0.5, float(between) / (8.0 * np.sqrt(areas[largest - 1])))
    reach = LEVEL_MARGIN * blur + 0.5
    inner, ring = depth >= reach, (depth <= -reach) & (depth >= -reach - 5.0)
    if np.sum(inner) < LEAST_INNER:
        raise InputError(f"{where}: the highlight is blurred as wide as it is: focus on the ball, or take a larger one")
    # a mirrored panel is brighter towards its edges, where more of it is within the same angle
    middle = _surface(level, columns, rows, inner, degree=2) + _surface(level, columns, rows, ring, degree=1)
    contour = _crossings(level - 0.5 * middle, np.abs(depth) <= 3.0) + np.array([left, top])
    return _fit_sides(contour, quad, CORNER_MARGIN * blur, where)


def _surface(level: Float64, columns: Float64, rows: Float64, where: Bool, *, degree: int) -> Float64:
    # the plane or paraboloid through levels, everywhere
    x, y = columns - columns[where].mean(), rows - rows[where].mean()
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    return np.asarray(terms @ np.linalg.lstsq(terms[where], level[where], rcond=None)[0])


def _crossings(excess: Float64, near: Bool) -> Float64:
    # where the excess is 0 between neighbouring pixels near the edge, (column, row) of the cut-out, shape (n, 2)
    found: list[Float64] = []
    for axis in (0, 1):
        one, other = (slice(None, -1), slice(None)), (slice(1, None), slice(None))
        if axis == 1:
            one, other = one[::-1], other[::-1]
        a, b = excess[one], excess[other]
        row, column = np.nonzero(((a > 0.0) != (b > 0.0)) & near[one] & near[other])
        share = a[row, column] / (a[row, column] - b[row, column])
        place = np.stack([column + 0.5, row + 0.5], axis=1).astype(np.float64)
        place[:, 1 - axis] += share
        found.append(place)
    return np.concatenate(found)


def _quadrilateral(points: Float64) -> Float64:
    # rough corners of a convex region in order, shape (4, 2)
    away = points - points.mean(axis=0)
    first = away[np.argmax(np.sum(np.square(away), axis=1))]
    third = away[np.argmax(np.sum(np.square(away - first), axis=1))]
    chord = third - first
    side = (away - first) @ np.array([-chord[1], chord[0]])
    corners = np.array([first, away[np.argmax(side)], third, away[np.argmin(side)]])
    return corners + points.mean(axis=0)


def _fit_sides(contour: Float64, corners: Float64, margin: float, where: str) -> MirroredPanel:
    """Fit a quadrilateral with sides bowed as parabolas, of four corners and four bows, to a contour [px]."""
    shape = np.concatenate([corners.ravel(), np.zeros(4)])
    kept, noise = np.ones(len(contour), np.bool_), np.inf
    for _ in range(4):
        off, side, along, length = _side_distances(contour, shape)
        kept = (along > margin) & (along < length - margin)
        kept &= np.abs(off) < max(OUTLIER * noise, 0.25) if np.isfinite(noise) else kept
        if np.min(np.bincount(side[kept], minlength=4)) < 6:
            raise InputError(f"{where}: the highlight has no four straight sides: is something in front of the panel?")
        points, sides = contour[kept], side[kept]

        def distances(x: Float64, points: Float64 = points, sides: NDArray[Any] = sides) -> Float64:
            return _side_distances(points, x, sides)[0]

        found = least_squares(distances, shape, method="lm", x_scale="jac")
        shape, slope = found.x, found.jac
        noise = 1.4826 * float(np.median(np.abs(found.fun)))
    freedom = max(1, int(kept.sum()) - len(shape))
    variance = max(2.0 * float(found.cost) / freedom, LEAST_EDGE_ERROR**2)
    covariance = NEIGHBOURS * variance * np.linalg.inv(slope.T @ slope)
    return MirroredPanel(corners=shape[:8].reshape(4, 2), covariance=covariance[:8, :8])


def _side_distances(
    points: Float64, shape: Float64, sides: NDArray[Any] | None = None
) -> tuple[Float64, NDArray[Any], Float64, Float64]:
    # of points from their side, or the nearest one: distance, side, place along it and its length [px]
    start, bow = shape[:8].reshape(4, 2), shape[8:]
    chord = np.roll(start, -1, axis=0) - start
    length = np.linalg.norm(chord, axis=1)
    unit = chord / length[:, None]
    away = points[:, None, :] - start
    along = np.sum(away * unit, axis=2)
    share = along / length
    off = away[:, :, 0] * unit[:, 1] - away[:, :, 1] * unit[:, 0] - bow * 4.0 * share * (1.0 - share)
    if sides is None:
        beyond = np.maximum(0.0, np.maximum(-along, along - length))
        sides = np.argmin(np.hypot(off, beyond), axis=1)
    each = np.arange(len(points))
    return off[each, sides], sides, along[each, sides], length[sides]


def _outline(image: Float64, radius: float, where: str) -> tuple[Float64, float]:
    """Points of the ball's outline (column, row) [px], shape (n, 2), and the scatter of each [px]."""
    centre = _vote(image, radius)
    angle = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    fitted = np.full(RAYS, radius)
    reach = SEARCH * radius
    kept, points, scatter = np.zeros(RAYS, np.bool_), np.zeros((RAYS, 2)), np.inf
    for _ in range(4):
        distance, slope, noise = _edges(image, centre, unit, fitted, reach)
        strong = np.abs(slope) > max(LEAST_CONTRAST * noise, 0.2 * float(np.percentile(np.abs(slope), 80)))
        # a circle and an ellipse's second harmonic
        terms = np.stack([np.ones(RAYS), *unit.T, np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=1)
        kept = strong.copy()
        for _ in range(4):
            if kept.sum() < LEAST_RAYS:
                raise InputError(
                    f"{where}: the outline of the ball shows at {int(kept.sum())} of {RAYS} places: light it from "
                    "behind with white paper below it, or expose longer, and check the ball's radius and place"
                )
            shape = np.linalg.lstsq(terms[kept], distance[kept], rcond=None)[0]
            off = distance - terms @ shape
            scatter = 1.4826 * float(np.median(np.abs(off[kept])))
            kept = strong & (np.abs(off) < max(OUTLIER * scatter, 0.05))
        points = centre + distance[:, None] * unit
        centre = centre + shape[1:3]
        fitted = terms[:, [0, 3, 4]] @ shape[[0, 3, 4]]
        reach = max(4.0 * EDGE_BLUR, 5.0 * scatter)
    error = float(np.sqrt(np.mean(np.square(off[kept]))))
    return points[kept], max(error, LEAST_EDGE_ERROR)


def _vote(image: Float64, radius: float) -> Float64:
    """Rough centre: where most slopes of the image point to from a radius away, whichever side is brighter."""
    clipped = np.minimum(image, float(np.percentile(image, 98.0)))
    dy, dx = (np.asarray(ndimage.gaussian_filter(clipped, 2.0, order=order)) for order in ((1, 0), (0, 1)))
    size = np.hypot(dx, dy)
    rows, columns = np.nonzero(size > max(float(np.percentile(size, 97.0)), 1e-9))
    unit = np.stack([dx[rows, columns], dy[rows, columns]], axis=1) / size[rows, columns][:, None]
    place = np.stack([columns, rows], axis=1) + 0.5
    bin_size = max(2.0, 0.02 * radius)
    votes = np.concatenate([place + radius * unit, place - radius * unit])
    edges = [np.arange(-0.5 * radius, side + 0.5 * radius + bin_size, bin_size) for side in image.shape[::-1]]
    counts = np.asarray(ndimage.gaussian_filter(np.histogram2d(*votes.T, bins=edges)[0], 1.0))
    best = np.unravel_index(int(np.argmax(counts)), counts.shape)
    return np.array([axis[k] + 0.5 * bin_size for axis, k in zip(edges, best, strict=True)])


def _edges(
    image: Float64, centre: Float64, unit: Float64, fitted: Float64, reach: float
) -> tuple[Float64, Float64, float]:
    """Distance of the steepest place on rays from a centre [px], its slope, and the noise of slopes; shapes (n,)."""
    step = 0.25
    offset = np.arange(-reach - 4.0 * EDGE_BLUR, reach + 4.0 * EDGE_BLUR + step, step)
    ray = fitted[:, None] + offset
    columns, rows = centre[0] + ray * unit[:, :1], centre[1] + ray * unit[:, 1:]
    # half a ray's sector to both sides is averaged
    level = np.zeros_like(ray)
    sideways = np.linspace(-0.5, 0.5, 5) * (2.0 * np.pi / len(unit)) * fitted.mean()
    for shift in sideways:
        place = [rows + shift * unit[:, :1] - 0.5, columns - shift * unit[:, 1:] - 0.5]
        level += np.asarray(ndimage.map_coordinates(image, place, order=1, mode="nearest")) / len(sideways)
    slope = np.asarray(ndimage.gaussian_filter1d(level, EDGE_BLUR / step, axis=1, order=1)) / step
    inner = slice(round(4.0 * EDGE_BLUR / step), -round(4.0 * EDGE_BLUR / step))
    size = np.abs(slope[:, inner])
    best = np.clip(np.argmax(size, axis=1), 1, size.shape[1] - 2)
    each = np.arange(len(size))
    before, here, after = (size[each, best + k] for k in (-1, 0, 1))
    bend = before - 2.0 * here + after
    share = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    distance = fitted + offset[inner][best] + step * np.clip(share, -0.5, 0.5)
    noise = 1.4826 * float(np.median(np.abs(slope[:, inner] - np.median(slope[:, inner], axis=0))))
    return distance, here, noise
