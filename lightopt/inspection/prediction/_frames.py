"""From the world frame of a placed part to its nominal place: mesh file coordinates and nominal pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lightopt.core.transforms import Posture, rotation_z
from lightopt.estimate.registration import Placement
from lightopt.inspection.prediction._posture_view import PostureView
from lightopt.scene import Scene, project, view_from_part

Float64 = NDArray[np.float64]


def to_file(
    points: Float64, scene: Scene, placement: Placement, posture: Posture, *, direction: bool = False
) -> Float64:
    """World points of a placed part in a posture, shape (k, 3), in the coordinates of the mesh file [mm].

    Parameters
    ----------
    points
        World frame [mm], or unit vectors with `direction`.
    scene
        Whose mesh lies where its file has it.
    placement
        From there to where the part lies.
    posture
        Of the part.
    direction
        Whether vectors are turned only.
    """
    view = view_from_part(scene, posture)
    turn = rotation_z(placement.turn)
    file = scene.placement
    if direction:
        return points @ view.rotation @ turn @ file.rotation
    on_stage = (points - view.translation) @ view.rotation
    shift = np.array([placement.x, placement.y, 0.0])
    own = (on_stage - scene.pivot - shift) @ turn + scene.pivot
    return (own - file.translation) @ file.rotation


def nominal_pixels(view: PostureView, scene: Scene, placement: Placement) -> NDArray[np.int32]:
    """For each pixel the one that shows its place where the part's file has it: flat index or −1, shape (H, W).

    Parameters
    ----------
    view
        Of a posture of a part.
    scene
        With the part where its file has it.
    placement
        Where it lies from there.
    """
    geometry = view.prediction.images.geometry
    index = np.full(geometry.hit.shape, -1, np.int32)
    stage = view_from_part(scene, view.posture)
    turn = rotation_z(placement.turn)
    shift = np.array([placement.x, placement.y, 0.0])
    on_stage = (geometry.points[geometry.hit].astype(np.float64) - stage.translation) @ stage.rotation
    column, row, depth = project(stage.camera, (on_stage - scene.pivot - shift) @ turn + scene.pivot)
    height, width = stage.camera.height, stage.camera.width
    inside = (depth > 0.0) & (column >= 0.0) & (column < width) & (row >= 0.0) & (row < height)
    found = np.full(len(column), -1, np.int32)
    found[inside] = np.floor(row[inside]).astype(np.int32) * width + np.floor(column[inside]).astype(np.int32)
    index[geometry.hit] = found
    return index
