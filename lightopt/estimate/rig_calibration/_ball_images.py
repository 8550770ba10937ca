"""Measure a mirror ball in images: its outline, and the quadrilateral as which it mirrors each panel.

Edges are where the level is halfway between both sides, to a fraction of a pixel. Of a saturated highlight nothing is
measured: its edge is displaced, and so is its centroid.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.errors import InputError, collected
from lightopt.core.transforms import Posture
from lightopt.estimate.rig_calibration._ball_fit import BallView, MirroredPanel as Panel
from lightopt.optics import Sensor

EDGE_BLUR = 1.2  # of the derivative that finds the outline [px]
SEARCH = 0.06  # how far the outline may be from the expected radius, as a share of it
RAYS, LEAST_RAYS = 360, 60
LEAST_CONTRAST = 8.0  # of the outline's slope, in standard deviations of its noise
OUTLIER = 4.0  # spreads
SMOOTHING = 0.6  # before an edge is interpolated between pixels, which a sharp one is not fit for [px]
# in standard deviations of the blur: from the edge of a highlight to the levels that its halfway level is of, and from
# the corners, which blur rounds off, to where the edge is measured
LEVEL_MARGIN, CORNER_MARGIN = 2.7, 2.7
LEAST_SIDE, LEAST_INNER = 12.0, 20  # of a highlight [px], and of its even middle [px²]
LEAST_EDGE_POINTS = 6
_Sided = tuple[Float64, Index, Float64, Float64]
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
) -> tuple[BallView, list[str]]:
    """Outline and mirrored panels of the ball in one posture, and what is wrong with panels that are left out.

    highlights: Images of the ball by the light that is on, so short that no highlight is saturated, shape (H, W)
        [sensor level]
    radius_px: Expected radius of the outline, image distance / pixel size · radius / distance [px]
    outline_images: Longer exposures, or images before a lit background, that show the outline better than all
        `highlights` together; shape (H, W)
    Panels are left out whose highlight is saturated, missing, too small or doubled.
    Raises InputError: The outline has no contrast
    """
    images = outline_images or list(highlights.values())
    total = np.sum([image.astype(np.float64) for image in images], axis=0)
    outline, error = _outline(total, radius_px, f"ball at {posture}")
    centre = outline.mean(axis=0)
    panels: dict[str, Panel] = {}
    problems: list[str] = []
    for name, image in highlights.items():
        with collected(problems):
            panels[name] = mirrored_panel(image, sensor, centre, 0.97 * radius_px, where=f"{name} at {posture}")
    return BallView(posture=posture, outline=outline, outline_error=error, panels=panels), problems


def mirrored_panel(image: NDArray[Any], sensor: Sensor, centre: Float64, radius_px: float, *, where: str) -> Panel:
    """The quadrilateral as which the ball mirrors a panel.

    image: [sensor level], shape (H, W)
    centre, radius_px: Of the part of the image to search, (column, row) [px]
    Raises InputError: Saturated, missing, too small or doubled
    """
    margin = int(np.ceil(radius_px))
    corner = np.maximum(0, centre.astype(np.intp) - margin)
    left, top = int(corner[0]), int(corner[1])
    level = image[top : int(centre[1]) + margin, left : int(centre[0]) + margin].astype(np.float64)
    rows, columns = (np.indices(level.shape) + 0.5) + corner[::-1, None, None]  # pixel centres
    level = np.where(np.hypot(columns - centre[0], rows - centre[1]) <= radius_px, level, sensor.black_level)
    peak, body = float(ndimage.uniform_filter(level, 3).max()), float(np.median(level))
    if body >= sensor.saturated_from:
        raise InputError(f"{where}: most of the ball is saturated: expose it shorter")
    if peak - body < LEAST_SIGNAL * max(sensor.read_noise_levels, 0.3):
        raise InputError(f"{where}: no highlight: is the light on? Else expose longer")
    region: Index = ndimage.label(level > 0.5 * (peak + body))[0]  # pyright: ignore[reportIndexIssue, reportAssignmentType]
    areas = np.bincount(region.ravel())[1:]
    area, side = int(areas.max()), math.sqrt(float(areas.max()))
    mask: Bool = region == int(np.argmax(areas)) + 1
    burnt = int(np.sum(level[mask] >= sensor.saturated_from))
    if burnt >= SATURATED_PIXELS:
        raise InputError(f"{where}: {burnt} of {area} pixels of the highlight are saturated: expose it shorter")
    if np.sum(areas > SECOND * area) > 1:
        raise InputError(
            f"{where}: more than one highlight: is another light on, or does the ball mirror something? On the virtual "
            "bench, set points: auto of the panels: a ball shows the points of a grid one by one"
        )
    level = np.asarray(ndimage.gaussian_filter(level, SMOOTHING))
    depth = np.asarray(ndimage.distance_transform_edt(mask)) - np.asarray(ndimage.distance_transform_edt(~mask))
    # of an edge blurred by a Gaussian two standard deviations are between 16 and 84 %
    share = (level - body) / (float(np.median(level[mask])) - body)
    between = np.sum((share > 0.159) & (share < 0.841) & (np.abs(depth) < 0.3 * side))
    blur = max(0.5, float(between) / (8.0 * side))
    reach = LEVEL_MARGIN * blur + 0.5
    inner, ring = depth >= reach, (depth <= -reach) & (depth >= -reach - 5.0)
    if side < LEAST_SIDE or np.sum(inner) < LEAST_INNER:
        raise InputError(
            f"{where}: the mirrored panel is about {side:.0f} pixels wide, blurred by {blur:.1f}: {LEAST_SIDE:.0f} are "
            "needed; focus on the ball, or take a larger one"
        )
    # a mirrored panel is brighter towards its edges, where more of it is within the same angle
    middle = _surface(level, columns, rows, inner, degree=2) + _surface(level, columns, rows, ring, degree=1)
    contour = _crossings(level - 0.5 * middle, np.abs(depth) <= 3.0) + corner
    rough = _rough_corners(np.stack([columns[mask], rows[mask]], axis=1))
    return _fit_sides(contour, rough, CORNER_MARGIN * blur, where)


def _surface(level: Float64, columns: Float64, rows: Float64, where: Bool, *, degree: int) -> Float64:
    # the plane or paraboloid through levels, everywhere
    x, y = columns - columns[where].mean(), rows - rows[where].mean()
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    return np.asarray(terms @ np.linalg.lstsq(terms[where], level[where], rcond=None)[0], np.float64)


def _crossings(excess: Float64, near: Bool) -> Float64:
    # where the excess is 0 between neighbouring pixels near the edge, (column, row) of the cut-out, shape (n, 2)
    found: list[Float64] = []
    for turn, e, n in ((1, excess, near), (-1, excess.T, near.T)):
        row, column = np.nonzero(((e[:-1] > 0.0) != (e[1:] > 0.0)) & n[:-1] & n[1:])
        share = e[row, column] / (e[row, column] - e[row + 1, column])
        found.append(np.stack([column + 0.5, row + 0.5 + share], axis=1, dtype=np.float64)[:, ::turn])
    return np.concatenate(found)


def _rough_corners(points: Float64) -> Float64:
    # of a convex region in order, shape (4, 2)
    first = points[np.argmax(np.sum(np.square(points - points.mean(axis=0)), axis=1))]
    third = points[np.argmax(np.sum(np.square(points - first), axis=1))]
    side = (points - first) @ np.array([first[1] - third[1], third[0] - first[0]])
    return np.array([first, points[np.argmax(side)], third, points[np.argmin(side)]])


def _fit_sides(contour: Float64, corners: Float64, margin: float, where: str) -> Panel:
    """Fit a quadrilateral with sides bowed as parabolas, of four corners and four bows, to a contour [px]."""
    shape, noise = np.concatenate([corners.ravel(), np.zeros(4)]), np.inf
    covariance = np.zeros((12, 12))
    for _ in range(4):
        off, side, along, length = _side_distances(contour, shape)
        kept = (along > margin) & (along < length - margin) & (np.abs(off) < max(OUTLIER * noise, 0.25))
        if np.min(np.bincount(side[kept], minlength=4)) < LEAST_EDGE_POINTS:
            raise InputError(f"{where}: the highlight has no four straight sides: is something in front of the panel?")
        sides = (contour[kept], side[kept])
        found = least_squares(lambda x, p, k: _side_distances(p, x, k)[0], shape, method="lm", args=sides)
        shape, noise = found.x, 1.4826 * float(np.median(np.abs(found.fun)))
        variance = max(2.0 * float(found.cost) / (len(found.fun) - len(shape)), LEAST_EDGE_ERROR**2)
        covariance = NEIGHBOURS * variance * np.linalg.inv(found.jac.T @ found.jac)
    return Panel(corners=shape[:8].reshape(4, 2), covariance=covariance[:8, :8])


def _side_distances(points: Float64, shape: Float64, sides: Index | None = None) -> _Sided:
    # of points from their side, or the nearest one: distance, side, place along it and its length [px]
    start, bow = shape[:8].reshape(4, 2), shape[8:]
    chord = np.roll(start, -1, axis=0) - start
    length = np.linalg.norm(chord, axis=1)
    unit = chord / length[:, None]
    away = points[:, None, :] - start
    along = np.sum(away * unit, axis=2)
    share = along / length
    off = away[:, :, 0] * unit[:, 1] - away[:, :, 1] * unit[:, 0] - bow * 4.0 * share * (1.0 - share)
    beyond = np.maximum(0.0, np.maximum(-along, along - length))
    nearest: Index = np.argmin(np.hypot(off, beyond), axis=1) if sides is None else sides
    each = np.arange(len(points))
    return off[each, nearest], nearest, along[each, nearest], length[nearest]


def _outline(image: Float64, radius: float, where: str) -> tuple[Float64, float]:
    """Points of the ball's outline (column, row) [px], shape (n, 2), and the scatter of each [px]."""
    centre, fitted, reach = _vote(image, radius), np.full(RAYS, radius), SEARCH * radius
    angle = np.arange(RAYS) * (2.0 * np.pi / RAYS)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    # a circle and an ellipse's second harmonic
    terms = np.stack([np.ones(RAYS), *unit.T, np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=1)
    points, error = np.zeros((0, 2)), 0.0
    for _ in range(4):
        distance, slope, noise = _edges(image, centre, unit, fitted, reach)
        shape = np.zeros(5)
        strong = kept = slope > max(LEAST_CONTRAST * noise, 0.2 * float(np.percentile(slope, 80)))
        for _ in range(4):
            if kept.sum() < LEAST_RAYS:
                raise InputError(
                    f"{where}: the outline of the ball shows at {int(kept.sum())} of {RAYS} places: light it from "
                    "behind with white paper below it, or expose longer, and check the ball's radius and place"
                )
            shape = np.linalg.lstsq(terms[kept], distance[kept], rcond=None)[0]
            off = distance - terms @ shape
            error = float(np.sqrt(np.mean(np.square(off[kept]))))
            kept = strong & (np.abs(off) < max(OUTLIER * 1.4826 * float(np.median(np.abs(off[kept]))), 0.05))
        points = (centre + distance[:, None] * unit)[kept]
        centre, fitted = centre + shape[1:3], terms[:, [0, 3, 4]] @ shape[[0, 3, 4]]
        reach = max(4.0 * EDGE_BLUR, 5.0 * error)
    return points, max(error, LEAST_EDGE_ERROR)


def _vote(image: Float64, radius: float) -> Float64:
    """Rough centre: where most slopes of the image point to from a radius away, whichever side is brighter."""
    clipped = np.minimum(image, float(np.percentile(image, 98.0)))
    smooth = np.asarray(ndimage.gaussian_filter(clipped, 2.0))
    dy, dx = np.gradient(smooth)
    size = np.hypot(dx, dy)
    rows, columns = np.nonzero(size > max(float(np.percentile(size, 97.0)), 1e-9))
    unit = np.stack([dx[rows, columns], dy[rows, columns]], axis=1) / size[rows, columns][:, None]
    place = np.stack([columns, rows], axis=1) + 0.5
    bin_size = max(2.0, 0.02 * radius)
    votes = np.concatenate([place + radius * unit, place - radius * unit])
    edges = [np.arange(-0.5 * radius, side + 0.5 * radius + bin_size, bin_size) for side in image.shape[::-1]]
    counts = np.asarray(
        ndimage.gaussian_filter(np.histogram2d(*votes.T, bins=edges, weights=np.tile(size[rows, columns], 2))[0], 1.0)
    )
    best = np.unravel_index(int(np.argmax(counts)), counts.shape)
    return np.array([axis[k] + 0.5 * bin_size for axis, k in zip(edges, best, strict=True)])


def _edges(
    image: Float64, centre: Float64, unit: Float64, fitted: Float64, reach: float
) -> tuple[Float64, Float64, float]:
    """Distance of the steepest place on rays from a centre [px], its slope, and the noise of slopes; shapes (n,)."""
    step, edge = 0.25, round(16.0 * EDGE_BLUR)
    count = round(reach / step) + edge
    offset = step * np.arange(-count, count + 1)
    ray = fitted[:, None] + offset
    level = np.zeros_like(ray)
    for sideways in np.linspace(-0.5, 0.5, 5) * (2.0 * np.pi / len(unit)) * fitted.mean():  # over a ray's sector
        row = centre[1] + ray * unit[:, 1:] + sideways * unit[:, :1] - 0.5
        column = centre[0] + ray * unit[:, :1] - sideways * unit[:, 1:] - 0.5
        level += 0.2 * np.asarray(ndimage.map_coordinates(image, [row, column], order=1, mode="nearest"))
    slope = np.asarray(ndimage.gaussian_filter1d(level, EDGE_BLUR / step, axis=1, order=1))[:, edge:-edge] / step
    size = np.abs(slope)
    best, each = np.clip(np.argmax(size, axis=1), 1, size.shape[1] - 2), np.arange(len(size))
    before, here, after = (size[each, best + k] for k in (-1, 0, 1))
    bend = np.minimum(before - 2.0 * here + after, -1e-12)
    distance = fitted + offset[edge:-edge][best] + step * np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
    far = slope[:, -max(4, slope.shape[1] // 8) :]  # outside of the ball, which has shades
    return distance, here, 1.4826 * float(np.median(np.abs(far - np.median(far, axis=0))))
