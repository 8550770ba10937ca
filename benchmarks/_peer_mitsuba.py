"""The reflection model in Dr.Jit around Mitsuba 3's ray caster (``llvm_ad_mono``), from the same point lights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks._numpy_shading import camera_rays
from lightopt.lights import panel_grid
from lightopt.optics import MIN_COS_VIEW
from lightopt.scene import Scene

Float32 = NDArray[np.float32]


class MitsubaPeer:
    """A Mitsuba scene with the part's mesh; Dr.Jit kernels make pictures of it, one per light."""

    def __init__(self, scene: Scene, *, threads: int) -> None:
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_mono")
        dr.set_thread_count(threads)
        self._dr, self._mi = dr, mi
        self._source = scene
        vertices, faces, normals = scene.mesh.vertices, scene.mesh.faces, scene.mesh.normals
        assert normals is not None
        mesh = mi.Mesh("part", len(vertices), len(faces), has_vertex_normals=True)
        values = mi.traverse(mesh)
        values["vertex_positions"] = mi.Float(vertices.astype(np.float32).ravel())
        values["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
        values["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
        values.update()
        self._scene = mi.load_dict({"type": "scene", "part": mesh})
        dr.sync_thread()

    def render(self) -> list[Float32]:
        """One float image per light, shape (height, width) each [grey level]."""
        dr, mi, source = self._dr, self._mi, self._source
        pixels, directions = camera_rays(source)
        origin = mi.Point3f(*(float(x) for x in source.camera.position))
        ray = mi.Ray3f(origin, dr.normalize(mi.Vector3f(directions.T)))
        hit = self._scene.ray_intersect(ray)
        view = -ray.d
        front = hit.is_valid() & (dr.dot(hit.n, view) > 0.0)
        dr.eval(hit, view, front)
        images: list[Float32] = []
        for light in source.lights:
            grid = dr.opaque(mi.Float, 0.0, 1) + mi.Float(
                panel_grid(light, int(light.points)).astype(np.float32).ravel()
            )
            dr.eval(grid)
            level = mi.Float(0.0)
            for k in range(int(light.points)):
                q = mi.Point3f(*(dr.gather(mi.Float, grid, mi.UInt32(3 * k + axis)) for axis in range(3)))
                level += self._point(hit, view, front, q)
            image = np.zeros((source.camera.height, source.camera.width), np.float32)
            image.ravel()[pixels] = (level * (light.total_weight / int(light.points))).numpy()
            images.append(image)
        return images

    def _point(self, hit: object, view: object, front: object, q: object) -> object:
        # equations 2 and 3 of the paper for one point light
        dr, mi, reflectance = self._dr, self._mi, self._source.reflectance
        normal = hit.sh_frame.n
        to_light = q - hit.p
        active = front & (dr.dot(normal, to_light) > 0.0) & (dr.dot(hit.n, to_light) > 0.0)
        active &= ~self._scene.ray_test(hit.spawn_ray_to(q), active)
        light = dr.normalize(to_light)
        chord = dr.norm(normal - dr.normalize(light + view))
        delta = 2.0 * dr.asin(dr.minimum(0.5 * chord, 1.0))
        n_dot_v = dr.dot(normal, view)
        specular = (
            reflectance.R_s / dr.maximum(n_dot_v, MIN_COS_VIEW) * dr.exp(-0.5 / reflectance.sigma**2 * delta * delta)
        )
        level = reflectance.R_d * dr.dot(normal, light) + dr.select(n_dot_v > 0.0, specular, 0.0)
        return dr.select(active, level, mi.Float(0.0))
