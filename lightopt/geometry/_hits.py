from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.kernels import kernel


@dataclass(frozen=True)
class Hits:
    """Rays that met the mesh, solved in float64 on the plane of the triangle that Embree named.

    Attributes
    ----------
    ray: Index of the ray among those asked, shape (k,)
    face: Face that was met, shape (k,)
    u, v: Barycentric coordinates: the point is (1−u−v)·A + u·B + v·C of the face's vertices; shape (k,)
    points: Points on the surface, frame of the mesh [mm], shape (k, 3)
    distance: Along the ray from its origin [mm], shape (k,)
    """

    ray: Int32
    face: Int32
    u: Float64
    v: Float64
    points: Float64
    distance: Float64


def resolve_hits(face: Int32, origin: Float64, directions: Float64, vertices: Float64, faces: Int32) -> Hits:
    """Solve the hits that :meth:`RayCaster.first_hit` found, leaving out the rays that met nothing.

    Embree's float32 answer is good to about 1e-5 of the distance, which is not enough for the normals of a glossy
    surface.

    Parameters
    ----------
    face: Answer of ``first_hit``, −1 where a ray met nothing, shape (n,)
    origin: Common origin of the rays [mm], shape (3,)
    directions: Shape (n, 3), any length
    """
    return Hits(*_resolve(face, origin, directions, vertices, faces))


@kernel
def _resolve(
    face: Int32, origin: Float64, directions: Float64, vertices: Float64, faces: Int32
) -> tuple[Int32, Int32, Float64, Float64, Float64, Float64]:
    count = 0
    for i in range(len(face)):
        if face[i] >= 0:
            count += 1
    ray = np.empty(count, np.int32)
    hit = np.empty(count, np.int32)
    u = np.empty(count)
    v = np.empty(count)
    points = np.empty((count, 3))
    distance = np.empty(count)
    k = 0
    for i in range(len(face)):
        f = face[i]
        if f < 0:
            continue
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
        e1x, e1y, e1z = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
        e2x, e2y, e2z = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
        px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
        determinant = e1x * px + e1y * py + e1z * pz
        sx, sy, sz = origin[0] - ax, origin[1] - ay, origin[2] - az
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
        ray[k] = i
        hit[k] = f
        u[k] = bu
        v[k] = bv
        points[k, 0] = x
        points[k, 1] = y
        points[k, 2] = z
        distance[k] = np.sqrt((x - origin[0]) ** 2 + (y - origin[1]) ** 2 + (z - origin[2]) ** 2)
        k += 1
    return ray, hit, u, v, points, distance
