"""Maps that prove shadow rays free, so that they need not be cast.

A mesh whose directed edges cancel is the surface of solids. On the way from a point outside all solids to a target
outside the mesh a ray leaves the solids as often as it enters them, and where it enters one the surface faces away from
the target. So where all surface that faces away from the target lies behind the point, seen from the target, nothing
blocks the ray. A map holds for each texel of a perspective view from the target the least depth of that surface.

A shadow ray does not start at the point but a little off the surface. In a fold of less than 90°, or where two bodies
touch, it may start inside a solid, which it then leaves without having entered it. Triangles at such folds, and those
that may touch another body, are in the maps whichever way they face.
"""

from __future__ import annotations

import logging
import math
import threading

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Int32, Int64
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.geometry._topology import merge_rows

_log = logging.getLogger("lightopt.geometry")

TEXELS = 256
"""Texels of a map, along each side."""

LEAST_DISTANCE = 1.5
"""Of a target from the mesh's centre, in radii of the mesh; nearer ones get no map."""

MOST_MAPS = 256
"""Maps that are held at once: 64 MiB."""

MOST_BODIES = 100
"""Of a mesh; of more, all triangles are taken to touch another one."""

WORTHWHILE_SHARE = 0.1
"""A map is made where as many rays as this share of the triangles may go to its target."""

# in radii of the mesh, some hundred times the rounding of its float32 coordinates
FACING_TOLERANCE = 1e-4
DEPTH_TOLERANCE = 1e-4
TEXEL_MARGIN = 0.05

BlockerMap = tuple[Float32, Float32]
"""A view's 14 numbers (its axes right, up and forward, the target, the coordinate of its edge, texels per unit), and
the least depth in each texel, shape (TEXELS, TEXELS)."""

NO_VIEWS, NO_DEPTHS = np.zeros((0, 14), np.float32), np.zeros((0, TEXELS, TEXELS), np.float32)
"""Of a caster that has no map."""


class BlockerMaps:
    """Maps of the targets of shadow rays. Safe to use from several threads at once.

    vertices: In the unit sphere, as Embree has them, shape (n, 3), float32
    faces: Shape (m, 3)
    """

    def __init__(self, vertices: Float32, faces: Int32) -> None:
        self._vertices, self._faces = vertices, faces
        self._lock = threading.Lock()
        self._surface: tuple[Float32, Bool] | None = None
        self._closed: bool | None = None
        self._maps: dict[bytes, BlockerMap] = {}

    @property
    def closed(self) -> bool:
        """Whether the mesh is closed and consistently oriented; if it is not, there are no maps."""
        with self._lock:
            return self._is_closed()

    def _is_closed(self) -> bool:
        if self._closed is None:
            _, welded = merge_rows(self._vertices.astype(np.float64))
            closed, folded = _closed_and_folded(self._vertices, self._faces, welded)
            self._closed = bool(closed)
            if not closed:
                _log.info("the mesh is open or its faces disagree in direction: every shadow ray is cast")
            if closed:
                either = folded[self._faces].any(axis=1) | _near_other_bodies(self._vertices, self._faces, welded)
                self._surface = _planes(self._vertices, self._faces), either
        return bool(self._closed)

    def find(self, targets: Float64) -> tuple[Int32, Float32, Float32]:
        """Number of the map of each target, −1 where it has none, shape (t,); views (k, 14) and depths of the maps.

        targets: In the mesh's radii from its centre, shape (t, 3)
        """
        numbers = np.full(len(targets), -1, np.int32)
        found: list[BlockerMap] = []
        with self._lock:
            for i, key in enumerate(_keys(targets) if self._maps else ()):
                if key in self._maps:
                    numbers[i] = len(found)
                    found.append(self._maps[key])
        if not found:
            return numbers, NO_VIEWS, NO_DEPTHS
        return numbers, np.stack([view for view, _ in found]), np.stack([depths for _, depths in found])

    def make(self, targets: Float64, *, rays: int, threads: int | None) -> None:
        """Make the maps of targets that have none, where so many rays to each of them make that worthwhile.

        targets: As in :meth:`find`
        """
        with self._lock:
            if rays <= WORTHWHILE_SHARE * len(self._faces) or not self._is_closed():
                return
            assert self._surface is not None
            planes, either = self._surface
            distance = np.linalg.norm(targets, axis=1)
            keys = [key for i, key in enumerate(_keys(targets)) if distance[i] >= LEAST_DISTANCE]
            fresh = [key for key in dict.fromkeys(keys) if key not in self._maps][:MOST_MAPS]
            made = in_threads(
                lambda i: _made(self._vertices, self._faces, planes, either, np.frombuffer(fresh[i])),
                range(len(fresh)),
                threads,
            )
            self._maps |= dict(zip(fresh, made, strict=True))
            for key in list(self._maps)[:-MOST_MAPS]:
                del self._maps[key]


def _keys(targets: Float64) -> list[bytes]:
    return [target.tobytes() for target in np.ascontiguousarray(targets, np.float64)]


def _made(vertices: Float32, faces: Int32, planes: Float32, either: Bool, target: Float64) -> BlockerMap:
    frame, depths = _frame(target), np.full((TEXELS, TEXELS), np.inf, np.float32)
    _fill(vertices, faces, planes, either, frame, depths)
    return frame, depths


def _frame(target: Float64) -> Float32:
    forward = -target / np.linalg.norm(target)
    right = np.cross(np.eye(3)[np.argmin(np.abs(forward))], forward)
    right /= np.linalg.norm(right)
    edge = 1.02 / math.sqrt(float(target @ target) - 1.0)
    numbers = [*right, *np.cross(forward, right), *forward, *target, -edge, TEXELS / (2.0 * edge)]
    return np.array(numbers, np.float32)


@kernel
def project(frame: Float32, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Column and row [texels], and depth, of a point in the view of a map."""
    x, y, z = x - frame[9], y - frame[10], z - frame[11]
    depth = x * frame[6] + y * frame[7] + z * frame[8]
    column = ((x * frame[0] + y * frame[1] + z * frame[2]) / depth - frame[12]) * frame[13]
    row = ((x * frame[3] + y * frame[4] + z * frame[5]) / depth - frame[12]) * frame[13]
    return column, row, depth


@kernel
def proven_free(frame: Float32, depths: Float32, x: float, y: float, z: float) -> bool:
    """Whether nothing can block the ray from a point outside all solids to the target of a map."""
    column, row, depth = project(frame, x, y, z)
    i, j = int(row), int(column)
    if column < 0.0 or row < 0.0 or i >= len(depths) or j >= len(depths):
        return False
    return depths[i, j] > depth + DEPTH_TOLERANCE


@kernel
def _planes(vertices: Float32, faces: Int32) -> Float32:
    # unit normal of each triangle, and its plane's distance from the centre along it
    planes = np.empty((len(faces), 4), np.float32)
    for i in range(len(faces)):
        nx, ny, nz = _normal(vertices, faces[i])
        a = faces[i, 0]
        planes[i, 0], planes[i, 1], planes[i, 2] = nx, ny, nz
        planes[i, 3] = nx * vertices[a, 0] + ny * vertices[a, 1] + nz * vertices[a, 2]
    return planes


@kernel
def _normal(vertices: Float32, face: Int32) -> tuple[float, float, float]:
    a, b, c = face[0], face[1], face[2]
    ax, ay, az = np.float64(vertices[a, 0]), np.float64(vertices[a, 1]), np.float64(vertices[a, 2])
    ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    vx, vy, vz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length > 0.0:
        nx, ny, nz = nx / length, ny / length, nz / length
    return nx, ny, nz


@kernel
def _fill(vertices: Float32, faces: Int32, planes: Float32, either: Bool, frame: Float32, depths: Float32) -> None:
    # every texel that the bounding box of a triangle touches gets the depth of its nearest vertex
    seen = np.empty((len(vertices), 3), np.float32)
    for i in range(len(vertices)):
        seen[i, 0], seen[i, 1], seen[i, 2] = project(
            frame, np.float64(vertices[i, 0]), np.float64(vertices[i, 1]), np.float64(vertices[i, 2])
        )
    last = len(depths) - 1
    for i in range(len(faces)):
        beyond = planes[i, 0] * frame[9] + planes[i, 1] * frame[10] + planes[i, 2] * frame[11] - planes[i, 3]
        if beyond > FACING_TOLERANCE and not either[i]:
            continue
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        depth = min(seen[a, 2], seen[b, 2], seen[c, 2])
        left = int(max(0.0, min(seen[a, 0], seen[b, 0], seen[c, 0]) - TEXEL_MARGIN))
        right = int(min(last, max(seen[a, 0], seen[b, 0], seen[c, 0]) + TEXEL_MARGIN))
        top = int(max(0.0, min(seen[a, 1], seen[b, 1], seen[c, 1]) - TEXEL_MARGIN))
        bottom = int(min(last, max(seen[a, 1], seen[b, 1], seen[c, 1]) + TEXEL_MARGIN))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                depths[row, column] = min(depths[row, column], depth)


@kernel
def _closed_and_folded(vertices: Float32, faces: Int32, welded: Int32) -> tuple[bool, Bool]:
    # whether directed edges cancel, each edge's two ways taken as often; and the vertices at folds of less than 90°
    folded = np.zeros(len(vertices), np.bool_)
    sharp = np.zeros(len(vertices), np.bool_)  # by welded vertex
    size = 16
    while size < 3 * len(faces):
        size *= 2
    mask = size - 1
    key = np.full(size, -1, np.int64)
    balance = np.zeros(size, np.int32)
    uses = np.zeros(size, np.int32)
    first = np.zeros(size, np.int32)
    for f in range(len(faces)):
        for k in range(3):
            a, b = np.int64(welded[faces[f, k]]), np.int64(welded[faces[f, (k + 1) % 3]])
            if a == b:
                continue
            low, high = min(a, b), max(a, b)
            edge = low * np.int64(len(vertices)) + high
            slot = ((edge ^ (edge >> 17)) * np.int64(0x2545F4914F6CDD1D) >> 20) & mask
            while key[slot] != -1 and key[slot] != edge:
                slot = (slot + 1) & mask
            key[slot] = edge
            balance[slot] += 1 if a < b else -1
            uses[slot] += 1
            if uses[slot] == 1:
                first[slot] = f
            elif uses[slot] > 2 or _is_fold(vertices, faces[first[slot]], faces[f], welded, low, high):
                sharp[low] = True
                sharp[high] = True
    for slot in range(size):
        if balance[slot] != 0:
            return False, folded
    for i in range(len(vertices)):
        folded[i] = sharp[welded[i]]
    return True, folded


@kernel
def _is_fold(vertices: Float32, face: Int32, other: Int32, welded: Int32, low: int, high: int) -> bool:
    nx, ny, nz = _normal(vertices, face)
    mx, my, mz = _normal(vertices, other)
    if nx * mx + ny * my + nz * mz > 0.01:
        return False
    for k in range(3):
        corner = welded[other[k]]
        if corner != low and corner != high:
            a, b = face[0], other[k]
            height = (
                nx * (vertices[b, 0] - vertices[a, 0])
                + ny * (vertices[b, 1] - vertices[a, 1])
                + nz * (vertices[b, 2] - vertices[a, 2])
            )
            return height > -1e-6
    return True


def _near_other_bodies(vertices: Float32, faces: Int32, welded: Int32) -> Bool:
    # triangles within the bounding box of a body that they do not belong to; bodies are connected through vertices
    body = _bodies(welded[faces], int(welded.max()) + 1)
    count = int(body.max()) + 1
    near = np.full(len(faces), count > MOST_BODIES)
    if not 1 < count <= MOST_BODIES:
        return near
    least, most = vertices[faces].min(axis=1), vertices[faces].max(axis=1)
    low, high = np.full((count, 3), np.inf, np.float32), np.full((count, 3), -np.inf, np.float32)
    np.minimum.at(low, body, least)
    np.maximum.at(high, body, most)
    _within_other_box(least, most, body, low - DEPTH_TOLERANCE, high + DEPTH_TOLERANCE, near)
    return near


@kernel
def _bodies(faces: Int32, vertices: int) -> Int64:
    parent = np.arange(vertices)
    for f in range(len(faces)):
        for k in range(2):
            a, b = faces[f, k], faces[f, k + 1]
            while parent[a] != a:
                parent[a] = parent[parent[a]]
                a = parent[a]
            while parent[b] != b:
                parent[b] = parent[parent[b]]
                b = parent[b]
            parent[max(a, b)] = min(a, b)
    number = np.full(vertices, -1)
    body = np.empty(len(faces), np.int64)
    count = 0
    for f in range(len(faces)):
        a = faces[f, 0]
        while parent[a] != a:
            a = parent[a]
        if number[a] < 0:
            number[a] = count
            count += 1
        body[f] = number[a]
    return body


@kernel
def _within_other_box(least: Float32, most: Float32, body: Int64, low: Float32, high: Float32, near: Bool) -> None:
    for f in range(len(near)):
        for other in range(len(low)):
            if other != body[f]:
                inside = True
                for axis in range(3):
                    inside = inside and least[f, axis] <= high[other, axis] and most[f, axis] >= low[other, axis]
                if inside:
                    near[f] = True
                    break
