"""Whether lights touch each other."""

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.geometry import RayCaster
from lightopt.lights import PanelLight, SurfaceLight, rectangles_meet, surface_mesh


def lights_meet(a: PanelLight, b: PanelLight) -> bool:
    """Whether the surfaces of two lights touch or cross; one that surrounds the other does not."""
    if all(not isinstance(light, SurfaceLight) or light.is_flat for light in (a, b)):
        return rectangles_meet(a, b)
    (points, faces), (others, other_faces) = surface_mesh(a), surface_mesh(b)
    return _edges_cross(points, faces, others, other_faces) or _edges_cross(others, other_faces, points, faces)


def _edges_cross(points: Float64, faces: Int32, others: Float64, other_faces: Int32) -> bool:
    # whether edges of some triangles go through others
    ends = [np.ascontiguousarray(faces[:, [k, (k + 1) % 3]].ravel().reshape(-1, 2)) for k in range(3)]
    start, end = np.concatenate(ends).T.astype(np.int32)
    caster = RayCaster(others, other_faces, rays=len(start))
    return bool(caster.occluded(points, np.zeros_like(points), points, point_index=start, target_index=end).any())
