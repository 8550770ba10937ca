"""The pixels of a posture whose light can be predicted: off silhouettes, creases and edges of shadows and regions."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64, Index, Int32, UInt8
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture
from lightopt.core.vectors import dot, minus, vector_at
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight
from lightopt.rendering._converged_panel import shadow_targets
from lightopt.rendering._point_lights import visible_counts
from lightopt.rendering._surface import GRAZING_COSINE, PointRows, SurfacePoints, trace_samples
from lightopt.scene import PartView, Scene, pixel_directions, screen_window, view_from_part

UNLIT, WHOLE, LEFT_OUT, PARTLY = 0, 1, 2, 3
"""What a pixel sees of a light: nothing; all of it; a share that is not predicted here (penumbrae); or, of a light that
is no panel, about the share that its neighbours see."""

# a neighbouring point further from the tangent plane than this share of its distance lies across a silhouette
STEEPEST_STEP = 0.6

# normals of neighbouring pixels that differ by more than 10° are those of a crease or of a silhouette
CREASE_COSINE = 0.985

# pixels next to those that are left out are left out, too: the part never lies exactly where the model has it
MARGIN_PX = 2

STEADY = 0.1  # neighbours' shares of a light that differ by no more than this share of the greater are about the same
_LEAST_COSINE = 0.02  # no pixel is taken to see more than fifty times the surface that faces it
_BLOCK_ROWS = 64
_CHUNK = 32_768
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class PosturePixels:
    """What the pixel centres of one posture's images look at, k of them."""

    posture: Posture  # of the part
    view: PartView  # camera and lights in the part's frame
    row: Int32  # of each pixel, shape (k,)
    column: Int32  # of each pixel, shape (k,)
    surface: SurfacePoints  # where the rays meet the part, part frame
    clean: Bool  # off silhouettes, creases, back faces and grazing views, shape (k,)
    shape: tuple[int, int]  # rows and columns of the image


def trace_pixels(scene: Scene, posture: Posture, caster: RayCaster, *, threads: int | None = None) -> PosturePixels:
    """Cast a ray through every pixel centre that can show the part."""
    view = view_from_part(scene, posture)
    left, top, right, bottom = screen_window(view.camera, scene.mesh)
    columns = np.arange(left, right, dtype=np.int32)

    def block(first: int) -> tuple[Int32, Int32, SurfacePoints]:
        rows = np.arange(first, min(first + _BLOCK_ROWS, bottom), dtype=np.int32)
        column, row = (a.ravel() for a in np.meshgrid(columns, rows))
        x, y = column.astype(np.float64) + 0.5, row.astype(np.float64) + 0.5
        hits, surface = trace_samples(caster, scene.mesh, view.camera, x, y, neighbours=True)
        return row[hits.ray], column[hits.ray], surface

    # no row at all is a block, too
    blocks = in_threads(block, range(top, max(bottom, top + 1), _BLOCK_ROWS), threads)
    rows, all_columns, parts = zip(*blocks, strict=True)
    row, column, surface = np.concatenate(rows), np.concatenate(all_columns), SurfacePoints.joined(parts)
    shape = (scene.camera.height, scene.camera.width)
    edge = _spread(_edges(surface, row, column, shape), row, column)
    cosine: Float64 = np.einsum("ij,ij->i", surface.normals, surface.views)
    clean = surface.front & ~edge & (cosine >= GRAZING_COSINE)
    return PosturePixels(posture=posture, view=view, row=row, column=column, surface=surface, clean=clean, shape=shape)


@dataclass(frozen=True, kw_only=True)
class PixelMasks:
    """What kind of surface each pixel centre of one posture's images looks at; arrays of shape (H, W) but `faces`."""

    hit: Bool  # whether it is the part at all
    clean: Bool  # off silhouettes, creases, back faces and grazing views: as :class:`PosturePixels` has it
    grazing: Bool  # front faces at more than :data:`GRAZING_DEG` to their normal
    area: Float32  # of the surface that the pixel sees [mm²], 0 off the part
    faces: Bool  # whether a pixel centre looks at each face of the mesh, shape (f,)


def mask_pixels(scene: Scene, posture: Posture, caster: RayCaster, *, threads: int | None = None) -> PixelMasks:
    """As :func:`trace_pixels`, but of each block of rows only what is asked here is kept, and not the surface."""
    view = view_from_part(scene, posture)
    camera = view.camera
    left, top, right, bottom = screen_window(camera, scene.mesh)
    columns = np.arange(left, right, dtype=np.int32)
    shape = (scene.camera.height, scene.camera.width)
    hit, edge, clean, grazing = (np.zeros(shape, np.bool_) for _ in range(4))
    area, faces = np.zeros(shape, np.float32), np.zeros(len(scene.mesh.faces), np.bool_)
    solid_angle = (camera.pixel_size / camera.image_distance) ** 2 / camera.aspect  # of a pixel on the optical axis

    def block(first: int) -> None:
        last = min(first + _BLOCK_ROWS, bottom)
        # with a row on either side, which edges may lie on
        rows = np.arange(max(top, first - 1), min(last + 1, bottom), dtype=np.int32)
        column, row = (a.ravel() for a in np.meshgrid(columns, rows))
        x, y = column.astype(np.float64) + 0.5, row.astype(np.float64) + 0.5
        hits, surface = trace_samples(caster, scene.mesh, camera, x, y, neighbours=True)
        row, column, faces[hits.face] = row[hits.ray], column[hits.ray], True
        index = np.full((len(rows) + 1, shape[1] + 1), -1, np.int32)
        index[row - rows[0], column] = np.arange(len(row), dtype=np.int32)
        differing = _differing(surface.rows, _materials(surface), row, column, index, int(rows[0]), shape[0])
        rays, masks = pixel_directions(camera, x[hits.ray], y[hits.ray]), (hit, edge, clean, grazing, area)
        _store_masks(surface.rows, hits.distance, rays, solid_angle, differing, (row, column), (first, last), masks)

    in_threads(block, range(top, bottom, _BLOCK_ROWS), threads)
    clean &= ~_widened(edge)
    return PixelMasks(hit=hit, clean=clean, grazing=grazing, area=area, faces=faces)


@kernel
def _store_masks(
    surface: PointRows,
    distance: Float64,
    rays: Float64,
    solid_angle: float,
    differing: Bool,
    pixels: tuple[Int32, Int32],
    part: tuple[int, int],
    masks: tuple[Bool, Bool, Bool, Bool, Float32],
) -> None:
    # of the pixels, by row and column, in some rows [first, last)
    (row, column), (first, last), (hit, edge, clean, grazing, area) = pixels, part, masks
    _, frames, views, facets, front = surface
    for i in range(len(row)):
        y, x = row[i], column[i]
        if not first <= y < last:
            continue
        view, ray = vector_at(views, i), vector_at(rays, i)
        facing = dot(vector_at(frames, i), view) >= GRAZING_COSINE
        hit[y, x], edge[y, x] = True, differing[i]
        # back faces are no grazing views: they are black, and counted
        clean[y, x], grazing[y, x] = front[i] and facing, front[i] and not facing
        # solid angle of a pixel: (side / image distance)² · cos³ of the angle to the optical axis
        axial = 1.0 / math.sqrt(dot(ray, ray))
        angle = solid_angle * axial**3
        cosine = abs(dot(vector_at(facets, i), view))
        area[y, x] = angle * distance[i] ** 2 / max(cosine, _LEAST_COSINE)


def _visible_counts(
    pixels: PosturePixels, targets: Float64, caster: RayCaster, moving: bool, threads: int | None
) -> tuple[Index, Index]:
    # how many targets each pixel sees, and how many are above its horizon
    surface = pixels.surface
    front = np.flatnonzero(surface.front)
    caster.map_blockers(targets, rays=len(front), moving=moving, threads=threads)

    def chunk(start: int) -> tuple[Index, Index, Index | slice]:
        end = start + _CHUNK
        where = slice(start, end) if len(front) == len(surface) else front[start:end]  # a slice is not copied
        return *visible_counts(surface.take(where), targets, caster), where

    clear, above = np.zeros((2, len(surface)), np.intp)
    for seen, facing, where in in_threads(chunk, range(0, len(front), _CHUNK), threads):
        clear[where], above[where] = seen, facing
    return clear, above


def _light_visibility(
    pixels: PosturePixels, light: PanelLight, caster: RayCaster, moving: bool, threads: int | None
) -> UInt8:
    targets = shadow_targets(light)
    clear, above = _visible_counts(pixels, targets, caster, moving, threads)
    # below the horizon of the interpolated normal there is no light, whatever is in the way
    if isinstance(light, SurfaceLight):
        # a large light reaches below most horizons, and is hidden in part at most places of most parts
        share = clear / np.maximum(above, 1)
        least, most = _range_nearby(share, pixels.row, pixels.column)
        steady = most - least <= STEADY * most
        return np.select(
            [above == 0, ~steady, share == 0.0, share < 1.0], [UNLIT, LEFT_OUT, UNLIT, PARTLY], WHOLE
        ).astype(np.uint8)
    # the terminator, where that horizon runs across the panel, moves with the least error of a normal
    mixed = (clear > 0) & (clear < above) | (above > 0) & (above < len(targets))
    hidden = (clear == 0) & (above > 0) & ~mixed
    lit = (clear > 0) & ~mixed
    visibility = np.select([mixed, lit], [LEFT_OUT, WHOLE], UNLIT).astype(np.uint8)
    for own, other in ((lit, hidden), (hidden, lit)):
        beside = other | mixed
        if own.any() and beside.any():
            visibility[own & _spread(beside, pixels.row, pixels.column)] = LEFT_OUT
    return visibility


def visibility_of_lights(
    pixels: PosturePixels,
    lights: Sequence[PanelLight],
    caster: RayCaster,
    *,
    moving: bool = False,
    threads: int | None = None,
) -> UInt8:
    """What each pixel sees of each light: `UNLIT`, `WHOLE`, `LEFT_OUT` or `PARTLY`, shape (lights, k).

    lights: Part frame
    moving: Whether it will be asked again with the lights nearby, as of a part that is moved
    """

    def of_light(light: PanelLight) -> UInt8:
        return _light_visibility(pixels, light, caster, moving, threads)

    return _of_places(lights, of_light)


def visible_shares(
    pixels: PosturePixels,
    lights: Sequence[PanelLight],
    caster: RayCaster,
    *,
    moving: bool = False,
    threads: int | None = None,
) -> Float64:
    """The share of each light's surface above its horizon that each pixel sees, shape (lights, k).

    lights, moving: As :func:`visibility_of_lights` has them
    """

    def of_light(light: PanelLight) -> Float64:
        clear, above = _visible_counts(pixels, shadow_targets(light), caster, moving, threads)
        return clear / np.maximum(above, 1)

    return _of_places(lights, of_light)


def _of_places(lights: Sequence[PanelLight], of_light: Callable[[PanelLight], NDArray[Any]]) -> NDArray[Any]:
    # channels in one place are asked once
    found: dict[bytes, NDArray[Any]] = {}
    places = [shadow_targets(light).tobytes() for light in lights]
    for place, light in zip(places, lights, strict=True):
        if place not in found:
            found[place] = of_light(light)
    return np.stack([found[place] for place in places])


def _edges(surface: SurfacePoints, row: Int32, column: Int32, shape: tuple[int, int]) -> Bool:
    # pixels that differ from the next one to the right or below by a step, by a crease, by the border of a region, or
    # by seeing no part at all
    index = np.full((shape[0] + 1, shape[1] + 1), -1, np.int32)
    index[row, column] = np.arange(len(row), dtype=np.int32)
    return _differing(surface.rows, _materials(surface), row, column, index, 0, shape[0])


def _materials(surface: SurfacePoints) -> UInt8:
    # none where there is one only
    return np.zeros(0, np.uint8) if surface.material is None else surface.material


@kernel
def _differing(
    surface: PointRows, material: UInt8, row: Int32, column: Int32, index: Int32, top: int, rows: int
) -> Bool:
    # `index`: of the point that each pixel sees, −1 where none, from row `top` on, with a row and a column more; of an
    # image of so many rows. In its first and last row flags are not complete
    points, frames, _, facets, _ = surface
    edge = np.zeros(len(row), np.bool_)
    columns = index.shape[1] - 1
    for a in range(len(row)):
        y, x = row[a], column[a]
        # inside the image, where the part ends on any side
        edge[a] |= (y > top and index[y - top - 1, x] < 0) or (x > 0 and index[y - top, x - 1] < 0)
        for down in range(2):
            below, beside = y + down, x + 1 - down
            if below == rows or beside == columns:
                continue
            b = index[below - top, beside]
            if b < 0:
                edge[a] = True
                continue
            step = minus(vector_at(points, b), vector_at(points, a))
            crease = dot(vector_at(frames, a), vector_at(frames, b)) < CREASE_COSINE
            rise = abs(dot(step, vector_at(facets, a)))
            border = len(material) > 0 and material[a] != material[b]
            if crease or border or rise > STEEPEST_STEP * math.sqrt(dot(step, step)):
                edge[a] = edge[b] = True
    return edge


def _spread(flags: Bool, row: Int32, column: Int32) -> Bool:
    # pixels with a flagged one within MARGIN_PX rows and columns
    if not len(row):
        return flags.copy()
    m = MARGIN_PX
    row, column = row - row.min(), column - column.min()
    rows, columns = int(row.max()) + 1, int(column.max()) + 1
    grid = np.zeros((rows + 2 * m, columns + 2 * m), np.bool_)
    grid[row + m, column + m] = flags
    if len(row) * (2 * m + 1) ** 2 < grid.size:  # few pixels, far apart
        return _near_flagged(grid, row, column)
    return _widened(grid)[row + m, column + m]


def _widened(flags: Bool) -> Bool:
    # all pixels of an image with a flagged one within MARGIN_PX rows and columns
    m, (rows, columns) = MARGIN_PX, flags.shape
    grid = np.pad(flags, m)
    wide = grid[:, :columns].copy()
    for dx in range(1, 2 * m + 1):
        wide |= grid[:, dx : dx + columns]
    near = wide[:rows].copy()
    for dy in range(1, 2 * m + 1):
        near |= wide[dy : dy + rows]
    return near


def _range_nearby(values: Float64, row: Int32, column: Int32) -> tuple[Float64, Float64]:
    # least and greatest of the values of pixels within MARGIN_PX rows and columns
    least, most = values.copy(), values.copy()
    if len(row):
        row, column = row - row.min(), column - column.min()
        grid = np.full((int(row.max()) + 1 + 2 * MARGIN_PX, int(column.max()) + 1 + 2 * MARGIN_PX), np.nan)
        grid[row + MARGIN_PX, column + MARGIN_PX] = values
        _find_range(grid, row, column, least, most)
    return least, most


@kernel
def _find_range(grid: Float64, row: Int32, column: Int32, least: Float64, most: Float64) -> None:
    # comparisons with NaN are false
    for i in range(len(row)):
        for down in range(2 * MARGIN_PX + 1):
            for along in range(2 * MARGIN_PX + 1):
                value = grid[row[i] + down, column[i] + along]
                if value < least[i]:
                    least[i] = value
                if value > most[i]:
                    most[i] = value


@kernel
def _near_flagged(grid: Bool, row: Int32, column: Int32) -> Bool:
    near = np.zeros(len(row), np.bool_)
    for i in range(len(row)):
        near[i] = grid[row[i] : row[i] + 2 * MARGIN_PX + 1, column[i] : column[i] + 2 * MARGIN_PX + 1].any()
    return near
