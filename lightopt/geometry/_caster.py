"""Ray casting: the first face that a ray meets, and whether the way to a target is blocked (Embree)."""

import logging
import math
import threading
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh as EmbreeMesh

from lightopt.core.arrays import Bool, Float32, Float64, Int32
from lightopt.core.kernels import kernel
from lightopt.core.threads import side_by_side
from lightopt.core.vectors import vector_at
from lightopt.geometry._blocker_maps import BlockerMaps
from lightopt.geometry._ray_packets import packet_scene
from lightopt.geometry._silhouettes import SilhouetteEdges, Silhouettes
from lightopt.geometry._triangle_mesh import bounding_box

_log = logging.getLogger("lightopt.geometry")

# Shadow rays start this fraction of the mesh's radius off the surface: 0.25 µm on a 50 mm part. Embree's own hits lie
# within 1e-7 of the radius of the surface, and an offset 100 times smaller already shows no false self-shadow.
SURFACE_OFFSET = 1e-5

# rays per triangle below which a hierarchy that is built quicker and queried slower takes less time in all
FEW_RAYS = 4.0


class RayCaster:
    """A bounding volume hierarchy over a triangle mesh, and the two queries of it.

    Safe to use from several threads at once; the answers do not depend on how rays are grouped into calls.

    vertices: [mm], shape (n, 3), any frame: rays are given in the same
    rays: About how many will be cast, where that is known; for few the hierarchy is built quicker and queried slower
    """

    def __init__(self, vertices: Float64, faces: Int32, *, rays: float = math.inf) -> None:
        self._made_of = vertices, faces, rays
        low, high = bounding_box(vertices)
        self.centre: Float64 = 0.5 * (low + high)
        self.radius = float(0.5 * np.linalg.norm(high - low))
        self._lock, self._edges_lock = threading.Lock(), threading.Lock()
        self._rays_cast = self._rays_free = 0
        # float32 keeps 7 digits, so the mesh is centred and scaled to unit size before it is given to Embree
        local = self._local(vertices).astype(np.float32)
        faces = np.ascontiguousarray(faces, dtype=np.int32)
        self._maps = BlockerMaps(local, faces)
        self._edges: SilhouetteEdges | None = None  # made where they are needed
        few = rays < FEW_RAYS * len(faces)
        self._packets, _ = side_by_side(lambda: packet_scene(local, faces, few_rays=few), self._maps.check)
        if self._packets is None:
            self._scene: Any = rtcore_scene.EmbreeScene(robust=True)  # pyright: ignore[reportAttributeAccessIssue]
            self._mesh = EmbreeMesh(self._scene, local, faces)
            # the first query commits the scene; done here, so that threads only ever read it
            self._first(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
        how = "one by one, by embreex" if self._packets is None else "in packets"
        _log.info("hierarchy over %s triangles; rays are cast %s", f"{len(faces):,}", how)

    def __reduce__(self) -> tuple[Any, ...]:
        # another process builds the hierarchy for itself
        vertices, faces, rays = self._made_of
        return partial(RayCaster, rays=rays), (vertices, faces)

    @property
    def rays_cast(self) -> int:
        return self._rays_cast

    @property
    def rays_free(self) -> int:
        """Number of shadow rays so far that a map of blockers proved free."""
        return self._rays_free

    def is_outside(self, point: Float64) -> bool:
        """Whether a point lies outside the mesh's bounding sphere; [mm], shape (3,)."""
        return bool(np.linalg.norm(point - self.centre) > self.radius)

    def first_hit(self, origin: Float64, directions: Float64, *, neighbours: bool = False) -> Int32:
        """Index of the first face that each ray meets, −1 where none; shape (k,).

        origin: Common origin of the rays [mm], shape (3,)
        directions: Shape (k, 3), any length
        neighbours: Whether rays that follow each other go nearly the same way: they are then cast together
        """
        rays = _primary_rays(self._local(origin), directions)
        return self._first(*rays, doubtful=self._maps.doubtful if neighbours else None)

    def next_hit(self, points: Float64, normals: Float64, directions: Float64) -> Int32:
        """Index of the first face that each ray from the surface meets, −1 where none; shape (k,).

        points: Points on the surface, where the rays begin [mm], shape (k, 3)
        normals: Unit geometric normals on the side of the surface that the rays leave, shape (k, 3)
        directions: Shape (k, 3), any length
        """
        begins = _begins(points, normals, self.centre, self.radius).T
        rays = np.ascontiguousarray(begins, np.float32), np.ascontiguousarray(directions, np.float32)
        return self._first(*rays, doubtful=self._maps.doubtful, scattered=True)

    def occluded(
        self, points: Float64, normals: Float64, targets: Float64, *, point_index: Int32, target_index: Int32
    ) -> Bool:
        """Whether the mesh blocks the way from a surface point to a target; shape (k,).

        Ray i goes from ``points[point_index[i]]`` to ``targets[target_index[i]]``; all of them are cast.

        points: Points on the surface [mm], shape (n, 3)
        normals: Unit geometric normals on the side of the surface that the rays leave, shape (n, 3)
        targets: [mm], shape (t, 3)
        point_index, target_index: Shape (k,)
        """
        begins = _begins(points, normals, self.centre, self.radius)
        return self._are_blocked(*_rays_of_pairs(begins, self._local(targets), point_index, target_index))

    def visible(
        self, points: Float64, normals: Float64, targets: Float64, *, candidates: Bool, outside: bool = False
    ) -> Bool:
        """Which targets surface points see, of some candidates; shape (t, n).

        Rays that a map of blockers proves free are not cast.

        points, normals, targets: As in :meth:`occluded`
        candidates: Whether point j may see target i, shape (t, n)
        outside: Whether all points are seen, from the side of their normals, from outside the mesh's bounding sphere:
            then none lies inside a solid, and :meth:`map_blockers` serves them
        """
        begins = _begins(points, normals, self.centre, self.radius)
        of_targets = np.broadcast_to(begins, (len(targets), *begins.shape))
        return self._unblocked(of_targets, targets, candidates, outside=outside, scattered=False)

    def sees_one(
        self, points: Float64, normals: Float64, targets: Float64, *, chosen: Int32, outside: bool = False
    ) -> Bool:
        """Whether each surface point sees the one target that is chosen for it, shape (n,).

        points, normals, targets, outside: As in :meth:`visible`
        chosen: Number of each point's target, −1 for none, shape (n,)
        """
        begins, seen = _begins(points, normals, self.centre, self.radius), np.zeros(len(points), np.bool_)
        for number in range(len(targets)):
            index = np.flatnonzero(chosen == number)
            every = np.ones((1, len(index)), np.bool_)
            own = begins.take(index, axis=1)[None], targets[number : number + 1]
            seen[index] = self._unblocked(*own, every, outside=outside, scattered=True)[0]
        return seen

    def _unblocked(
        self, begins: Float64, targets: Float64, candidates: Bool, *, outside: bool, scattered: bool
    ) -> Bool:
        # begins of the rays to each target, shape (t, 3, n)
        local = self._local(targets)
        cast = self._maps.unproven(local, begins, candidates) if outside else candidates
        with self._lock:
            self._rays_free += int(np.count_nonzero(candidates) - np.count_nonzero(cast))
        if self._packets is not None:
            blocked = self._packets.blocked(begins, local, cast, scattered=scattered)
            with self._lock:
                self._rays_cast += int(np.count_nonzero(cast))
            return candidates & ~blocked
        point, target = np.nonzero(cast.T)
        origins = begins[target, :, point]
        rays = origins.astype(np.float32), (local[target] - origins).astype(np.float32)
        seen = candidates.copy()
        seen[target, point] = ~self._are_blocked(*rays)
        return seen

    def silhouettes(self, points: Float64, normals: Float64, corner: Float64, sides: Float64) -> Silhouettes:
        """The mesh's silhouettes between surface points and a rectangle, which tell without rays what they see of it.

        points, normals: As in :meth:`occluded`
        corner, sides: A corner of the rectangle, shape (3,), and the sides s and t that begin there, perpendicular to
            each other, shape (2, 3) [mm]
        """
        begins = _begins(points, normals, self.centre, self.radius)
        with self._edges_lock:
            if self._edges is None:
                self._edges = SilhouetteEdges(*self._maps.welded())
        return self._edges.between(begins, self._local(corner), *(sides / self.radius))

    def map_blockers(self, targets: Float64, *, rays: int, moving: bool = False, threads: int | None = None) -> None:
        """Make maps that prove rays to some targets free, where so many rays to each of them make that worthwhile.

        targets: [mm], shape (t, 3)
        rays: To each of them from points seen from outside, over all calls of :meth:`visible`
        moving: Whether targets follow that are near these, as of a part that is moved: maps then serve these as well
        """
        self._maps.make(self._local(targets), rays=rays, moving=moving, threads=threads)

    def _local(self, points: Float64) -> Float64:
        return (points - self.centre) / self.radius

    def _first(
        self, origins: Float32, directions: Float32, *, doubtful: Bool | None = None, scattered: bool = False
    ) -> Int32:
        with self._lock:
            self._rays_cast += len(origins)
        if self._packets is None:
            return self._scene.run(origins, directions, query="INTERSECT")
        return self._packets.first_hit(origins, directions, doubtful=doubtful, scattered=scattered)

    def _are_blocked(self, origins: Float32, directions: Float32) -> Bool:
        with self._lock:
            self._rays_cast += len(origins)
        if self._packets is not None:
            return self._packets.occluded(origins, directions) >= 0
        # directions end at the target, so that a shadow ray reaches from 0 to 1 of its length
        return self._scene.run(origins, directions, np.ones(len(origins), np.float32), query="OCCLUDED") >= 0


@kernel
def _primary_rays(origin: Float64, directions: Float64) -> tuple[Float32, Float32]:
    # each ray starts near the mesh's bounding sphere, not at the far camera: the rounding of its origin to float32
    # then is that of the part's size, not of the camera's distance
    n = len(directions)
    origins32 = np.empty((n, 3), np.float32)
    directions32 = np.empty((n, 3), np.float32)
    ox, oy, oz = origin
    outside = ox * ox + oy * oy + oz * oz > 1.21
    for i in range(n):
        dx, dy, dz = directions[i]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * scale, dy * scale, dz * scale
        start = max(0.0, -(ox * dx + oy * dy + oz * dz) - 1.1) if outside else 0.0
        origins32[i, 0], origins32[i, 1], origins32[i, 2] = ox + start * dx, oy + start * dy, oz + start * dz
        directions32[i, 0], directions32[i, 1], directions32[i, 2] = dx, dy, dz
    return origins32, directions32


@kernel
def _begins(points: Float64, normals: Float64, centre: Float64, radius: float) -> Float64:
    # where shadow rays start, a little off the surface, in the mesh's radii from its centre; shape (3, n)
    begins = np.empty((3, len(points)))
    for i in range(len(points)):
        for axis in range(3):
            begins[axis, i] = (points[i, axis] - centre[axis]) / radius + SURFACE_OFFSET * normals[i, axis]
    return begins


def _rays_of_pairs(begins: Float64, targets: Float64, point: Int32, target: Int32) -> tuple[Float32, Float32]:
    origins = begins[:, point].T
    return np.ascontiguousarray(origins, np.float32), np.ascontiguousarray(targets[target] - origins, np.float32)


class Hits(NamedTuple):
    """Rays that met the mesh, solved in float64 on the plane of the triangle that Embree named; shapes (k,)."""

    ray: Int32  # index of the ray among those cast
    face: Int32  # face that was met
    u: Float64  # barycentric coordinates: the point is (1−u−v)·A + u·B + v·C of the face's vertices
    v: Float64
    points: Float64  # points on the surface, frame of the mesh [mm], shape (k, 3)
    distance: Float64  # along the ray from its origin [mm]


def resolve_hits(face: Int32, origin: Float64, directions: Float64, vertices: Float64, faces: Int32) -> Hits:
    """Solve the hits that :meth:`RayCaster.first_hit` found, leaving out the rays that met nothing.

    Embree's float32 answer is good to about 1e-5 of the distance, which is not enough for the normals of a glossy
    surface.

    face: Answer of ``first_hit`` or ``next_hit``, −1 where a ray met nothing, shape (n,)
    origin: Of the rays [mm], a common one of shape (3,), or shape (n, 3)
    directions: Shape (n, 3), any length
    """
    return _resolve(face, np.atleast_2d(origin), directions, vertices, faces)


@kernel
def _resolve(face: Int32, origins: Float64, directions: Float64, vertices: Float64, faces: Int32) -> Hits:
    count = np.count_nonzero(face >= 0)
    ray, hit = np.empty(count, np.int32), np.empty(count, np.int32)
    u, v, distance, points = np.empty(count), np.empty(count), np.empty(count), np.empty((count, 3))
    k = 0
    for i in range(len(face)):
        f = face[i]
        if f < 0:
            continue
        origin = vector_at(origins, i if len(origins) > 1 else 0)
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        e1x, e1y, e1z = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        e2x, e2y, e2z = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
        px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
        determinant = e1x * px + e1y * py + e1z * pz
        sx, sy, sz = origin.x - ax, origin.y - ay, origin.z - az
        qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
        if determinant != 0.0:
            bu = (sx * px + sy * py + sz * pz) / determinant
            bv = (dx * qx + dy * qy + dz * qz) / determinant
        else:
            bu = bv = 1.0 / 3.0
        # at the edge of a triangle float32 and float64 may disagree by a rounding error: stay on the triangle
        bu = min(max(bu, 0.0), 1.0)
        bv = min(max(bv, 0.0), 1.0 - bu)
        x = ax + bu * e1x + bv * e2x
        y = ay + bu * e1y + bv * e2y
        z = az + bu * e1z + bv * e2z
        ray[k], hit[k], u[k], v[k] = i, f, bu, bv
        points[k, 0], points[k, 1], points[k, 2] = x, y, z
        distance[k] = np.sqrt((x - origin.x) ** 2 + (y - origin.y) ** 2 + (z - origin.z) ** 2)
        k += 1
    return Hits(ray, hit, u, v, points, distance)
