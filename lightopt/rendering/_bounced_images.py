"""Light of the part on itself in images: worked out at some pixels, and interpolated between them where it is smooth.

A square of pixels has 3 × 3 nodes. Where the surface in it is smooth and the other nodes agree with the mean of the
corners beside them, the polynomial through the nodes serves for all of it; otherwise the square is divided, at last
into single pixels.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float64, Index, Int32
from lightopt.core.kernels import kernel
from lightopt.core.vectors import dot, length, minus, vector_at
from lightopt.geometry import Hits
from lightopt.rendering._caustics import ENOUGH, blurred, caustic_levels, landed_light
from lightopt.rendering._interreflection import PartLight
from lightopt.rendering._penumbra_squares import quadratic_weights
from lightopt.rendering._surface import SurfacePoints
from lightopt.scene import PinholeCamera, lens_share

SIDES = (16, 8, 4)  # of the squares, in samples
BAND = 16 * SIDES[0]  # rows of samples that are worked on at once
NEAR = 4  # rows and columns around a sample, in which others like it tell its level
LEAST_NEAR = 5  # number of these
MOST_TURN = 0.05  # angle between their normals [rad]
# by how much nodes may differ from means of corners, of which the polynomial takes account, besides their errors [grey
# level], share
CHANGE, RELATIVE_CHANGE = 0.6, 0.05
# errors of pixels near each other are alike, so that over the size of a defect they count for as much as those of
# independent pixels that are so many times as large
ALIKE = 6.0
OF_DISAGREEMENT = 0.25  # share of it that is an error of interpolated levels
SHARED = 65  # rows and columns around a sample that share glints, twice
MOST_BEND = 0.1  # normals that differ by more from those interpolated between corners divide a square [rad]
MOST_STEP = 0.1  # and points that are further from those interpolated, as a share of the square's diagonal

_Trace = Callable[[Float64, Float64], tuple[Hits, SurfacePoints]]


@dataclass(frozen=True, eq=False)
class Band:
    """Rows [top, bottom) of images, columns from `left` on: levels to add, shape (lights, rows, columns)."""

    top: int
    bottom: int
    left: int
    diffuse: Float64
    specular: Float64
    error: Float64  # standard error of their sum, of the mean of samples as of one


def bounced_bands(
    light: PartLight,
    camera: PinholeCamera,
    window: tuple[int, int, int, int],
    trace: _Trace,
    *,
    supersample: int,
    offset: Float64,
    threads: int | None = None,
) -> Iterator[Band]:
    """What the part's light on itself adds to the images of a posture, band by band.

    window: Left, top, right and bottom of what is rendered [px]
    trace: Casts the camera's rays through a grid of columns and rows
    supersample: n² samples of a pixel, whose mean it shows
    offset: Of the samples from where they are in their pixels, to the right and down [px], shape (2,)
    """
    n, (left, top, right, bottom) = supersample, window
    columns = (np.arange(left * n, right * n) + 0.5) / n + offset[0]
    step = max(1, BAND // n)
    samples = (right - left) * (bottom - top) * n * n
    light.map_blockers(samples, threads)
    landed = landed_light(light, camera.position, samples, threads)
    for first in range(top, bottom, step):
        end = min(first + step, bottom)
        # with the row that the squares of the last rows reach to
        rows = (np.arange(first * n, min(end * n + 1, bottom * n)) + 0.5) / n + offset[1]
        hits, surface = trace(columns, rows)
        at = np.full((len(rows), len(columns)), -1, np.int32)
        at.ravel()[hits.ray] = np.arange(len(surface), dtype=np.int32)
        passed = lens_share(camera, columns[hits.ray % len(columns)], rows[hits.ray // len(columns)])
        pixels, errors = list[Float64](), list[Float64]()
        mirrors = light.mirrors_housing(surface)

        for worked_out in (light.diffuse, light.specular):
            apart = surface.material
            if mirrors is not None and pixels:
                # the edge of a housing in a mirror is as sharp as the border of a region
                apart = mirrors if apart is None else 2 * apart.astype(np.int16) + mirrors
            values, error = _over_regions(surface, at, apart, worked_out, threads)
            if landed and not pixels:
                caustics = caustic_levels(landed, camera, surface, at, (columns[0], rows[0]), 1.0 / n)
                values += caustics
                error = np.hypot(error, caustics / math.sqrt(ENOUGH))
            pixels.append(_means(values if passed is None else values * passed, at, end - first, n))
            errors.append(_means(error if passed is None else error * passed, at, end - first, n))
        yield Band(first, end, left, *pixels, error=np.hypot(*errors))


def _means(values: Float64, at: Int32, rows: int, n: int) -> Float64:
    # over the n² samples of each pixel of so many rows, shape (lights, rows, columns)
    samples = np.zeros((len(values), *at.shape))
    samples[:, at >= 0] = values[:, at[at >= 0]]
    return samples[:, : rows * n].reshape(len(values), rows, n, -1, n).mean(axis=(2, 4))


def _over_regions(
    surface: SurfacePoints,
    at: Int32,
    region: NDArray[Any] | None,
    worked_out: Callable[[SurfacePoints, int | None], Float64],
    threads: int | None,
) -> Float64:
    # levels of all points of a grid and their errors, shape (2, lights, k); nothing is interpolated across the border
    # of a region
    if region is None or not len(surface):
        return _over_squares(surface, at, worked_out, threads)
    parts: list[tuple[Index, Float64]] = []
    for number in np.unique(region):
        index = np.flatnonzero(region == number)
        own = np.full(len(surface) + 1, -1, np.int32)  # at −1: none
        own[index] = np.arange(len(index), dtype=np.int32)
        parts.append((index, _over_squares(surface.take(index), own[at], worked_out, threads)))
    values = np.zeros((*parts[0][1].shape[:2], len(surface)))
    for index, found in parts:
        values[..., index] = found
    return values


def _over_squares(
    surface: SurfacePoints, at: Int32, worked_out: Callable[[SurfacePoints, int | None], Float64], threads: int | None
) -> Float64:
    # levels of all points of a grid and their errors, shape (2, lights, k)
    known, done = np.zeros(len(surface), np.bool_), ~surface.front
    values = np.zeros((*worked_out(surface.take(slice(0)), 1).shape[:2], len(surface)))
    errors = np.zeros(values.shape[1:])  # those in `values` are of points that were worked out alone

    def work_out(chosen: Bool) -> None:
        index = np.flatnonzero(chosen & ~known)
        values[..., index] = worked_out(surface.take(index), threads)
        errors[:, index] = values[1][:, index]
        known[index] = done[index] = True

    side = SIDES[0]
    corners = side * np.argwhere(np.ones(-(-np.array(at.shape) // side), np.bool_))
    for side in SIDES:
        smooth = _smooth_squares(corners, side, at, surface.points, surface.normals, surface.front)
        work_out(_nodes(corners[smooth], side, at, len(surface)))
        fitting = smooth.copy()
        fitting[smooth] = _interpolated(corners[smooth], side, at, values, errors, done)
        half = side // 2
        corners = np.concatenate([corners[~fitting] + [down, right] for down in (0, half) for right in (0, half)])
        corners = corners[np.all(corners < at.shape, axis=1)]
    _from_neighbours(at, surface.points, surface.normals, surface.facets, values, errors, done)
    work_out(~done)
    if values[2].any():
        values[0] += _shared(values[2], surface.front, at)
    return np.stack([values[0], errors])


def _shared(glints: Float64, front: Bool, at: Int32) -> Float64:
    # means of glints over the samples around each, shape (lights, k)
    chosen = at >= 0
    chosen[chosen] = front[at[chosen]]
    shared, weight = np.zeros_like(glints), blurred(chosen.astype(np.float64), SHARED)[chosen]
    for found, own in zip(shared, glints, strict=True):
        image = np.zeros(at.shape)
        image[chosen] = own[at[chosen]] / weight
        found[at[chosen]] = blurred(image, SHARED)[chosen]
    return shared


@kernel
def _smooth_squares(corners: Int32, side: int, at: Int32, points: Float64, normals: Float64, front: Bool) -> Bool:
    # squares inside the grid whose points and normals are nearly those interpolated between the corners
    smooth = np.zeros(len(corners), np.bool_)
    for k in range(len(corners)):
        top, left = corners[k, 0], corners[k, 1]
        if top + side >= at.shape[0] or left + side >= at.shape[1]:
            continue
        found = True
        for y in range(side + 1):
            for x in range(side + 1):
                i = at[top + y, left + x]
                found &= i >= 0 and front[i]
        if not found:
            continue
        a, b = at[top, left], at[top, left + side]
        c, d = at[top + side, left], at[top + side, left + side]
        across = minus(vector_at(points, d), vector_at(points, a))
        most = MOST_STEP * length(across)
        for y in range(side + 1):
            for x in range(side + 1):
                i, s, t = at[top + y, left + x], x / side, y / side
                of = ((1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t)
                away = bend = 0.0
                for axis in range(3):
                    place = of[0] * points[a, axis] + of[1] * points[b, axis]
                    place += of[2] * points[c, axis] + of[3] * points[d, axis]
                    away += (points[i, axis] - place) ** 2
                    lean = of[0] * normals[a, axis] + of[1] * normals[b, axis]
                    lean += of[2] * normals[c, axis] + of[3] * normals[d, axis]
                    bend += (normals[i, axis] - lean) ** 2
                found &= away <= most * most and bend <= MOST_BEND**2
        smooth[k] = found
    return smooth


@kernel
def _nodes(corners: Int32, side: int, at: Int32, count: int) -> Bool:
    chosen = np.zeros(count, np.bool_)
    half = side // 2
    for k in range(len(corners)):
        for down in range(3):
            for right in range(3):
                chosen[at[corners[k, 0] + half * down, corners[k, 1] + half * right]] = True
    return chosen


@kernel
def _interpolated(corners: Int32, side: int, at: Int32, values: Float64, errors: Float64, done: Bool) -> Bool:
    # fills the squares whose other nodes agree with their corners under every light, and says which
    fitting = np.zeros(len(corners), np.bool_)
    half, nodes, along = side // 2, np.empty(9, np.int64), quadratic_weights(side)
    own = np.empty(values.shape[1])
    for k in range(len(corners)):
        top, left = corners[k, 0], corners[k, 1]
        for down in range(3):
            for right in range(3):
                nodes[3 * down + right] = at[top + half * down, left + half * right]
        agrees = True
        for light in range(values.shape[1]):
            v, e = values[0, light], values[1, light]
            error = most = 0.0
            for node in nodes:
                error, most = max(error, e[node]), max(most, v[node])
            a, b, c, d = v[nodes[0]], v[nodes[2]], v[nodes[6]], v[nodes[8]]
            off = abs(v[nodes[4]] - 0.25 * (a + b + c + d))
            off = max(off, max(abs(v[nodes[1]] - 0.5 * (a + b)), abs(v[nodes[7]] - 0.5 * (c + d))))
            off = max(off, max(abs(v[nodes[3]] - 0.5 * (a + c)), abs(v[nodes[5]] - 0.5 * (b + d))))
            agrees &= off <= CHANGE + RELATIVE_CHANGE * most + error
            own[light] = max(error, OF_DISAGREEMENT * off)
        fitting[k] = agrees
        if not agrees:
            continue
        for y in range(side + 1):
            for x in range(side + 1):
                i = at[top + y, left + x]
                if done[i]:
                    continue
                done[i] = True
                errors[:, i] = own
                for layer in range(0, 3, 2):
                    for light in range(values.shape[1]):
                        v, value = values[layer, light], 0.0
                        for down in range(3):
                            for right in range(3):
                                value += along[y, down] * along[x, right] * v[nodes[3 * down + right]]
                        v[i] = max(0.0, value)
    return fitting


@kernel
def _from_neighbours(
    at: Int32, points: Float64, normals: Float64, facets: Float64, values: Float64, errors: Float64, done: Bool
) -> None:
    # fills samples beside edges from others on the same surface near them, where these agree
    rows, columns = at.shape
    told = done.copy()
    for y in range(rows):
        for x in range(columns):
            i = at[y, x]
            if i < 0 or told[i]:
                continue
            weights, count, total = np.empty((2 * NEAR + 1) ** 2), 0, 0.0
            numbers = np.empty(len(weights), np.int64)
            n, p, facet = vector_at(normals, i), vector_at(points, i), vector_at(facets, i)
            for down in range(max(0, y - NEAR), min(rows, y + NEAR + 1)):
                for right in range(max(0, x - NEAR), min(columns, x + NEAR + 1)):
                    j = at[down, right]
                    if j < 0 or not told[j]:
                        continue
                    turn, way = minus(n, vector_at(normals, j)), minus(vector_at(points, j), p)
                    if length(turn) > MOST_TURN or abs(dot(way, facet)) > MOST_TURN * length(way):
                        continue
                    weights[count] = 1.0 / ((down - y) ** 2 + (right - x) ** 2)
                    numbers[count], total, count = j, total + weights[count], count + 1
            if count < LEAST_NEAR:
                continue
            agrees = True
            for light in range(values.shape[1]):
                v, e = values[0, light], values[1, light]
                least, most, error = v[numbers[0]], v[numbers[0]], 0.0
                for k in range(count):
                    least, most = min(least, v[numbers[k]]), max(most, v[numbers[k]])
                    error = max(error, e[numbers[k]])
                agrees &= most - least <= CHANGE + RELATIVE_CHANGE * most + error
                errors[light, i] = max(error, OF_DISAGREEMENT * (most - least))
            if not agrees:
                continue
            done[i] = True
            for layer in range(0, 3, 2):
                for light in range(values.shape[1]):
                    mean = 0.0
                    for k in range(count):
                        mean += weights[k] * values[layer, light, numbers[k]]
                    values[layer, light, i] = mean / total
