"""The ray casters of Open3D and trimesh behind one face, for shading in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.scene import Scene

Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]


class Open3DCaster:
    """``open3d.t.geometry.RaycastingScene``; each call spreads its rays over all threads."""

    def __init__(self, scene: Scene, *, threads: int) -> None:
        from open3d.core import Tensor
        from open3d.t.geometry import RaycastingScene

        self._tensor, self._threads = Tensor, threads
        self._scene = RaycastingScene(nthreads=threads)
        self._scene.add_triangles(
            Tensor(scene.mesh.vertices.astype(np.float32)), Tensor(scene.mesh.faces.astype(np.uint32))
        )
        self._scene.cast_rays(Tensor(np.ones((1, 6), np.float32)))  # the first ray builds the tree
        self._none = RaycastingScene.INVALID_ID

    def first_hit(self, origin: Float32, directions: Float32) -> tuple[Int32, Float32, Float32]:
        """See :class:`benchmarks._numpy_shading.Backend`."""
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origin, directions
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=self._threads)
        face = answer["primitive_ids"].numpy()
        uv = answer["primitive_uvs"].numpy()
        return np.where(face == self._none, -1, face.astype(np.int64)).astype(np.int32), uv[:, 0], uv[:, 1]

    def occluded(self, origins: Float32, directions: Float32) -> NDArray[np.bool_]:
        """See :class:`benchmarks._numpy_shading.Backend`."""
        rays = np.concatenate([origins, directions], axis=1)
        return self._scene.test_occlusions(self._tensor(rays), tfar=1.0, nthreads=self._threads).numpy()


class TrimeshCaster:
    """``trimesh.Trimesh.ray`` over embreex, as it comes."""

    def __init__(self, scene: Scene) -> None:
        import trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self._mesh = trimesh.Trimesh(scene.mesh.vertices, scene.mesh.faces, process=False)
        self._ray = RayMeshIntersector(self._mesh)
        self._ray.intersects_first(np.zeros((1, 3)), np.ones((1, 3)))  # the first ray builds the tree

    def first_hit(self, origin: Float32, directions: Float32) -> tuple[Int32, Float32, Float32]:
        """See :class:`benchmarks._numpy_shading.Backend`."""
        face = self._ray.intersects_first(np.broadcast_to(origin, directions.shape), directions)
        a, b, c = (self._mesh.vertices[i] for i in self._mesh.faces[face].T)
        # trimesh says which triangle; where on it: Möller and Trumbore 1997, equation 6
        e1, e2 = b - a, c - a
        p = np.cross(directions, e2)
        determinant = np.einsum("ij,ij->i", e1, p)
        s = origin - a
        u = np.einsum("ij,ij->i", s, p) / determinant
        v = np.einsum("ij,ij->i", directions, np.cross(s, e1)) / determinant
        return face.astype(np.int32), u.astype(np.float32), v.astype(np.float32)

    def occluded(self, origins: Float32, directions: Float32) -> NDArray[np.bool_]:
        """See :class:`benchmarks._numpy_shading.Backend`."""
        # rays have no end here; the lights stand farther out than the part, so that any hit is in the way
        return self._ray.intersects_any(origins, directions)
