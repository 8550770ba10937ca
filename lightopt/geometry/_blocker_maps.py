"""Maps that prove shadow rays free, so that they need not be cast.

A mesh whose directed edges cancel is the surface of solids. On the way from a point outside all solids to a target
outside the mesh a ray leaves the solids as often as it enters them, and where it enters one the surface faces away from
the target. So where all surface that faces away from the target lies behind the point, seen from the target, nothing
blocks the ray. A map holds for each texel of a perspective view from the target the least depth of that surface.

A shadow ray does not start at the point but a little off the surface. In a fold of less than 90°, or where two bodies
touch, it may start inside a solid, which it then leaves without having entered it. Triangles at such folds, and those
that may touch another body, are in the maps whichever way they face.

A map may serve all targets within a reach R of its own. A ray from the same point to one of these passes a place of
the mesh at most a share of R beside the ray to the map's target, and surface that faces away from it faces away from
the map's target but for R. So triangles are that much larger in the map, and nearer.
"""

import logging
import math
import threading
from collections.abc import Collection

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads, side_by_side
from lightopt.geometry._topology import corners_by_edge, join, merge_rows, next_corner
from lightopt.geometry._triangle_mesh import unit_crosses

_log = logging.getLogger("lightopt.geometry")

TEXELS = 384  # texels of a map, along each side
LEAST_DISTANCE = 1.5  # of a target from the mesh's centre, in radii of the mesh; nearer ones get no map
MOST_MAPS = 256  # maps that are held at once: 144 MiB
MOST_BODIES = 100  # of a mesh; of more, all triangles are taken to touch another one
FEW_TRIANGLES = 300_000  # of maps that are made in less time than threads take to begin
WORTHWHILE_SHARE = 0.1  # a map is made where as many rays as this share of the triangles may go to its targets
REACH = 0.03  # of the maps of targets that move [radii of the mesh]

# in radii of the mesh, some hundred times the rounding of its float32 coordinates
FACING_TOLERANCE = 1e-4
DEPTH_TOLERANCE = 1e-4
TEXEL_MARGIN = 0.05

# a view's 12 numbers (its axes right, up and forward, the target's distance, the coordinate of its edge, texels per
# unit), and the least depth in each texel, counted from the mesh's centre, shape (TEXELS, TEXELS)
BlockerMap = tuple[Float32, Float32]


class BlockerMaps:
    """Maps of targets of shadow rays, for threads; vertices (n, 3) are in the unit sphere, as Embree has them."""

    def __init__(self, vertices: Float32, faces: Int32) -> None:
        self._vertices, self._faces = vertices, faces
        self._lock = threading.Lock()
        self._surface: tuple[Float32, Bool] | None = None
        self._closed: bool | None = None
        self._welded: tuple[Int32, Int32, Float32] | None = None
        self._maps: dict[bytes, BlockerMap] = {}
        # the same of targets that move, which serve those nearby; and rays so far to targets around one without a map
        self._moving: dict[bytes, BlockerMap] = {}
        self._asked: dict[bytes, int] = {}

    def check(self) -> bool:
        """Find out whether the mesh is closed and consistently oriented; if it is not, there are no maps."""
        with self._lock:
            return self._is_closed()

    def _is_closed(self) -> bool:
        if self._closed is None:
            vertices, faces = self._vertices, self._faces
            planes, (places, welded) = side_by_side(  # the first vertex at each place
                lambda: _planes(vertices, faces), lambda: merge_rows(vertices)
            )
            (closed, folded), body = side_by_side(
                lambda: _closed_and_folded(vertices, faces, planes, welded, *corners_by_edge(welded[faces])),
                lambda: _bodies(welded, faces),
            )
            self._closed, self._welded = bool(closed), (places, welded, planes)
            if not closed:
                _log.info("the mesh is open or its faces disagree in direction: every shadow ray is cast")
            else:
                at_fold = folded[faces[:, 0]] | folded[faces[:, 1]] | folded[faces[:, 2]]
                self._surface = planes, at_fold | _near_other_bodies(vertices, faces, body)
        return bool(self._closed)

    def welded(self) -> tuple[Float32, Int32, Float32]:
        """The mesh with one vertex at each place: vertices, faces, and of these unit normal and distance, (m, 4)."""
        with self._lock:
            self._is_closed()
            assert self._welded is not None
            places, number, planes = self._welded
            return self._vertices[places], number[self._faces], planes

    @property
    def doubtful(self) -> Bool | None:
        """Faces at folds, and those that may touch another body, shape (m,); None for an open mesh."""
        with self._lock:
            return self._surface[1] if self._is_closed() and self._surface is not None else None

    def unproven(self, targets: Float64, begins: Float64, candidates: Bool) -> Bool:
        """Which rays no map proves free, of the candidates; shape (t, n).

        targets: In the mesh's radii from its centre, shape (t, 3)
        begins: Of the rays to each, all outside all solids, in the same units, shape (t, 3, n)
        candidates: Shape (t, n)
        """
        with self._lock:
            found = [self._maps.get(key) or self._moving.get(_near(key, self._moving)) for key in _keys(targets)]
        if not any(found):
            return candidates
        rest = candidates.copy()
        for row, own, blockers in zip(rest, begins, found, strict=True):
            if blockers is not None:
                _drop_proven(*blockers, own, row)
        return rest

    def make(self, targets: Float64, *, rays: int, moving: bool = False, threads: int | None = None) -> None:
        """Make the maps of targets that have none, where so many rays to each of them make that worthwhile.

        targets: As in :meth:`find`
        moving: Whether other targets follow that are near these: their maps serve these, too, and rays to them count
        """
        with self._lock:
            least = WORTHWHILE_SHARE * len(self._faces)
            if (rays <= least and not moving) or not self._is_closed():
                return
            surface = self._surface
            assert surface is not None
            distance = np.linalg.norm(targets, axis=1)
            keys = [key for i, key in enumerate(_keys(targets)) if distance[i] >= LEAST_DISTANCE]
            fresh = [key for key in dict.fromkeys(keys) if key not in self._maps][:MOST_MAPS]
            if moving:
                fresh = [key for key in fresh if not _near(key, self._moving) and self._count(key, rays) > least]
        reach = REACH if moving else 0.0
        # without the lock: other threads make maps of other targets
        made = in_threads(
            lambda i: _made(self._vertices, self._faces, *surface, np.frombuffer(fresh[i]), reach),
            range(len(fresh)),
            1 if len(fresh) * len(self._faces) < FEW_TRIANGLES else threads,
        )
        with self._lock:
            maps = self._moving if moving else self._maps
            maps |= dict(zip(fresh, made, strict=True))
            for kept in (maps, self._asked):
                for key in list(kept)[:-MOST_MAPS]:
                    del kept[key]

    def _count(self, key: bytes, rays: int) -> int:
        # rays so far to targets around this one
        place = _near(key, self._asked) or key
        self._asked[place] = self._asked.get(place, 0) + rays
        return self._asked[place]


def _near(key: bytes, places: Collection[bytes]) -> bytes:
    # of the targets at some places the nearest one that has this one in its reach; none: no bytes
    if not places:
        return b""
    distance = np.linalg.norm(np.frombuffer(b"".join(places)).reshape(-1, 3) - np.frombuffer(key), axis=1)
    nearest = int(np.argmin(distance))
    return list(places)[nearest] if distance[nearest] <= REACH else b""


def _keys(targets: Float64) -> list[bytes]:
    return [target.tobytes() for target in np.ascontiguousarray(targets, np.float64)]


def _made(vertices: Float32, faces: Int32, planes: Float32, either: Bool, target: Float64, reach: float) -> BlockerMap:
    view, depths = _view(target), np.full((TEXELS, TEXELS), np.inf, np.float32)
    # the ray to a target within reach is at most so far beside at a place of the unit sphere, and there so many texels
    far = float(view[9]) - 1.0
    beside = reach * min(1.0, 2.0 / (far - reach))
    slack = float(view[11]) * beside / (far - beside) * (1.0 + (1.0 + beside) / (far - beside))
    numbers = np.array([FACING_TOLERANCE + reach, TEXEL_MARGIN + slack, beside], np.float32)
    _fill(vertices, faces, planes, either, target, view, depths, numbers)
    return view, depths


def _view(target: Float64) -> Float32:
    distance = float(np.linalg.norm(target))
    forward = -target / distance
    # right is across the axis that is furthest from forward
    right = np.cross(np.eye(3)[np.argmin(np.abs(forward))], forward)
    right /= np.linalg.norm(right)
    edge = 1.02 / math.sqrt(distance * distance - 1.0)
    numbers = (*right, *np.cross(forward, right), *forward, distance, -edge, TEXELS / (2.0 * edge))
    return np.array(numbers, np.float32)


@kernel
def _project(view: Float32, x: float, y: float, z: float) -> tuple[float, float, float]:
    # column and row [texels], and depth, of a point in the view of a map; all float32. Depth is counted from the mesh's
    # centre, so that it is as exact for a target far away
    depth = x * view[6] + y * view[7] + z * view[8]
    distance = view[9] + depth
    column = ((x * view[0] + y * view[1] + z * view[2]) / distance - view[10]) * view[11]
    row = ((x * view[3] + y * view[4] + z * view[5]) / distance - view[10]) * view[11]
    return column, row, depth


@kernel
def _drop_proven(view: Float32, depths: Float32, begins: Float64, rays: Bool) -> None:
    # clears the rays that start outside all solids and that nothing can block
    at_once = 1024
    texel = np.empty(at_once, np.int32)
    depth = np.empty(at_once, np.float32)
    nearest = depths.ravel()
    tolerance, side = np.float32(DEPTH_TOLERANCE), np.float32(TEXELS)
    for first in range(0, len(rays), at_once):
        count = min(at_once, len(rays) - first)
        for j in range(count):
            i = first + j
            x, y, z = np.float32(begins[0, i]), np.float32(begins[1, i]), np.float32(begins[2, i])
            column, row, behind = _project(view, x, y, z)
            inside = (column >= 0) & (row >= 0) & (column < side) & (row < side)
            texel[j] = np.int32(row) * TEXELS + np.int32(column) if inside else -1
            depth[j] = behind + tolerance
        for j in range(count):
            if rays[first + j] and texel[j] >= 0 and nearest[texel[j]] > depth[j]:
                rays[first + j] = False


def _planes(vertices: Float32, faces: Int32) -> Float32:
    # unit normal of each triangle, and its plane's distance from the centre along it
    normals = unit_crosses(vertices.astype(np.float64), faces)
    distance = np.einsum("ij,ij->i", normals, vertices[faces[:, 0]])
    return np.column_stack([normals.astype(np.float32), distance.astype(np.float32)])


@kernel
def _fill(
    vertices: Float32,
    faces: Int32,
    planes: Float32,
    either: Bool,
    target: Float64,
    view: Float32,
    depths: Float32,
    tolerances: Float32,
) -> None:
    # every texel that the bounding box of a triangle touches gets the depth of its nearest vertex
    facing, margin, nearer = tolerances
    seen = np.empty((len(vertices), 3), np.float32)
    for i in range(len(vertices)):
        seen[i, 0], seen[i, 1], seen[i, 2] = _project(view, vertices[i, 0], vertices[i, 1], vertices[i, 2])
    last = len(depths) - 1
    for i in range(len(faces)):
        beyond = planes[i, 0] * target[0] + planes[i, 1] * target[1] + planes[i, 2] * target[2] - planes[i, 3]
        if beyond > facing and not either[i]:
            continue
        a, b, c = faces[i, 0], faces[i, 1], faces[i, 2]
        depth = min(seen[a, 2], seen[b, 2], seen[c, 2]) - nearer
        left = max(0, int(min(seen[a, 0], seen[b, 0], seen[c, 0]) - margin))
        right = min(last, int(max(seen[a, 0], seen[b, 0], seen[c, 0]) + margin))
        top = max(0, int(min(seen[a, 1], seen[b, 1], seen[c, 1]) - margin))
        bottom = min(last, int(max(seen[a, 1], seen[b, 1], seen[c, 1]) + margin))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                depths[row, column] = min(depths[row, column], depth)


@kernel
def _closed_and_folded(
    vertices: Float32, faces: Int32, planes: Float32, welded: Int32, order: Int32, begins: Int32
) -> tuple[bool, Bool]:
    # whether directed edges cancel, each edge's two ways taken as often; and the vertices at folds of less than 90°
    corners = faces.reshape(-1)
    folded = np.zeros(len(vertices), np.bool_)
    sharp = np.zeros(len(vertices), np.bool_)  # by welded vertex
    for edge in range(len(begins) - 1):
        begin, end = begins[edge], begins[edge + 1]
        a, b = welded[corners[order[begin]]], welded[corners[next_corner(order[begin])]]
        if a == b:
            continue
        balance = 0
        for k in range(begin, end):
            balance += 1 if welded[corners[order[k]]] == a else -1
        if balance != 0:
            return False, folded
        one, two = order[begin] // 3, order[begin + 1] // 3
        if end - begin > 2 or _is_fold(vertices, faces, planes, one, two, welded, a, b):
            sharp[a] = True
            sharp[b] = True
    for i in range(len(vertices)):
        folded[i] = sharp[welded[i]]
    return True, folded


@kernel
def _is_fold(
    vertices: Float32, faces: Int32, planes: Float32, f: int, g: int, welded: Int32, low: int, high: int
) -> bool:
    # whether two faces meet at less than 90° across the edge between two welded vertices
    if planes[f, 0] * planes[g, 0] + planes[f, 1] * planes[g, 1] + planes[f, 2] * planes[g, 2] > 0.01:
        return False
    for k in range(3):
        i = faces[g, k]
        if welded[i] != low and welded[i] != high:
            x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            height = planes[f, 0] * x + planes[f, 1] * y + planes[f, 2] * z - planes[f, 3]
            return height > -1e-6
    return True


def _near_other_bodies(vertices: Float32, faces: Int32, body: Int32) -> Bool:
    # triangles within the bounding box of a body that they do not belong to
    count = int(body.max()) + 1
    near = np.full(len(faces), count > MOST_BODIES)
    if not 1 < count <= MOST_BODIES:
        return near
    least, most = vertices[faces].min(axis=1), vertices[faces].max(axis=1)
    low, high = np.full((count, 3), np.inf, np.float32), np.full((count, 3), -np.inf, np.float32)
    np.minimum.at(low, body, least)
    np.maximum.at(high, body, most)
    for other in range(count):
        below, above = least <= high[other] + DEPTH_TOLERANCE, most >= low[other] - DEPTH_TOLERANCE
        near |= (below & above).all(axis=1) & (body != other)
    return near


@kernel
def _bodies(welded: Int32, faces: Int32) -> Int32:
    # of each triangle; bodies are connected through vertices
    parent = np.arange(len(welded)).astype(np.int32)
    for f in range(len(faces)):
        join(parent, welded[faces[f, 0]], welded[faces[f, 1]])
        join(parent, welded[faces[f, 0]], welded[faces[f, 2]])
    for i in range(len(parent)):
        parent[i] = parent[parent[i]]
    root = parent[welded[faces[:, 0]]]
    is_root = np.zeros(len(parent), np.int32)
    is_root[root] = 1
    return (np.cumsum(is_root)[root] - 1).astype(np.int32)
