"""From the world frame of a placed part to its nominal place: mesh file coordinates and nominal pixels."""

from __future__ import annotations

import numpy as np

from lightopt.core.arrays import Float64, Int32
from lightopt.core.transforms import Posture, rotation_z
from lightopt.estimate.registration import Placement
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.scene import Scene, project, view_from_part


def world_to_mesh_file(
    points: Float64, scene: Scene, placement: Placement, posture: Posture, *, direction: bool = False
) -> Float64:
    """World points of a placed part in a posture, shape (k, 3), in the coordinates of the mesh file [mm].

    scene, placement: where the part's file has the part, and where it lies from there.
    direction: whether `points` are directions, which are rotated only.
    """
    file = scene.placement
    if direction:
        view = view_from_part(scene, posture)
        return points @ view.rotation @ rotation_z(placement.turn) @ file.rotation
    nominal = _world_to_nominal_part(points, scene, placement, posture)
    return (nominal - file.translation) @ file.rotation


def nominal_pixels(view: PostureView, scene: Scene, placement: Placement) -> Int32:
    """For each pixel the one that shows its place where the part's file has it: flat index or −1, shape (H, W).

    scene: With the part where its file has it.
    placement: Where it lies from there.
    """
    geometry = view.prediction.images.geometry
    index = np.full(geometry.hit.shape, -1, np.int32)
    camera = view_from_part(scene, view.posture).camera
    points = geometry.points[geometry.hit].astype(np.float64)
    column, row, depth = project(camera, _world_to_nominal_part(points, scene, placement, view.posture))
    inside = (depth > 0.0) & (column >= 0.0) & (column < camera.width) & (row >= 0.0) & (row < camera.height)
    pixel = np.full(len(column), -1, np.int32)
    pixel[inside] = np.floor(row[inside]).astype(np.int32) * camera.width
    pixel[inside] += np.floor(column[inside]).astype(np.int32)
    index[geometry.hit] = pixel
    return index


def _world_to_nominal_part(points: Float64, scene: Scene, placement: Placement, posture: Posture) -> Float64:
    # world points of the placed part in the part frame, with the part where its file has it
    view = view_from_part(scene, posture)
    on_stage = (points - view.translation) @ view.rotation
    shift = np.array([placement.x, placement.y, 0.0])
    return (on_stage - scene.pivot - shift) @ rotation_z(placement.turn) + scene.pivot
