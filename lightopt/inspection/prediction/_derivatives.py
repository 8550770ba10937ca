"""How a prediction changes with the placement: parts of a batch that lie nearly alike need no rays of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Float32, Float64
from lightopt.core.kernels import kernel
from lightopt.core.transforms import Posture, rotation_z
from lightopt.estimate.registration import Placement, view_of_placed
from lightopt.geometry import RayCaster
from lightopt.inspection._image_blocks import in_image_blocks, mask_window
from lightopt.inspection.prediction._predict import Prediction
from lightopt.rendering import render_posture
from lightopt.scene import Scene, pixel_footprint

STEP_PX = 0.25
"""For the differences the part is rendered this far to either side, for a shift in x and y and a rotation."""


@dataclass(frozen=True, eq=False)
class PlacementDerivatives:
    """Central differences of a prediction with respect to the placement.

    levels: of each light, per step in x, y and rotation: half the difference of the levels at the two sides, and half
        of their second difference [grey level], shape (lights, 3, 2, h, w).
    window: rows and columns of the image that the arrays are of; elsewhere nothing changes.
    steps: in x and y [mm] and in rotation [rad], shape (3,).
    """

    levels: Float32
    window: tuple[slice, slice]
    steps: Float64


def difference_steps(scene: Scene) -> Float64:
    """Shifts [mm] and rotation [rad] that move the image of the part by :data:`STEP_PX`, shape (3,)."""
    camera = scene.camera
    distance = float(np.linalg.norm(camera.position - scene.pivot))
    shift = STEP_PX * pixel_footprint(camera, distance)
    flat = scene.mesh.vertices[:, :2] - scene.pivot[:2]
    radius = float(np.sqrt(np.max(np.sum(flat * flat, axis=1))))
    return np.array([shift, shift, shift / max(radius, 1.0)])


def shifted_scene(scene: Scene, placement: Placement, posture: Posture, offset: Float64) -> Scene:
    """A scene whose images in a posture are those of its part moved a little further on the stage.

    The mesh stays, so that one ray caster serves: camera and lights go the other way.

    scene: with the part at `placement`.
    offset: further shift in x and y [mm] and rotation [rad], shape (3,).
    """
    turn = float(offset[2])
    # it rotates about its own middle, and placements rotate about the pivot
    middle = np.array([placement.x, placement.y, 0.0])
    x, y, _ = middle - rotation_z(turn) @ middle
    view = view_of_placed(scene, posture, x + float(offset[0]), y + float(offset[1]), turn)
    return replace(
        scene,
        camera=view.camera.moved(view.rotation, view.translation),
        lights=tuple(light.moved(view.rotation, view.translation) for light in view.lights),
    )


def placement_derivatives(
    scene: Scene,
    placement: Placement,
    posture: Posture,
    prediction: Prediction,
    caster: RayCaster,
    *,
    threads: int | None = None,
) -> PlacementDerivatives:
    """Render the posture of a prediction with the part a little to either side of its `placement` in `scene`."""
    images = prediction.images.lights
    names = {image.light for image in images}
    steps = difference_steps(scene)
    rows, columns = (
        slice(max(0, side.start - 2), side.stop + 2) if side.stop else side
        for side in mask_window(prediction.images.geometry.hit)
    )
    window = rows, columns
    middle = [image.level[window] for image in images]
    levels = np.zeros((len(images), 3, 2, *middle[0].shape), np.float32)
    for axis, offset in enumerate(np.diag(steps)):
        more, less = (
            render_posture(
                replace(moved, lights=tuple(light for light in moved.lights if light.name in names)),
                posture,
                caster=caster,
                threads=threads,
            ).lights
            for moved in (shifted_scene(scene, placement, posture, sign * offset) for sign in (1.0, -1.0))
        )
        for i, (upper, lower) in enumerate(zip(more, less, strict=True)):
            levels[i, axis, 0] = 0.5 * (upper.level[window] - lower.level[window])
            levels[i, axis, 1] = 0.5 * (upper.level[window] + lower.level[window]) - middle[i]
    return PlacementDerivatives(levels=levels, window=window, steps=steps)


def shift_prediction(
    prediction: Prediction, derivatives: PlacementDerivatives, offset: Float64, *, threads: int | None = None
) -> Prediction:
    """A prediction for a part that lies a little further on the stage: a Taylor series of second order.

    Which pixels can be judged, what they see and the share of highlights stay those of the prediction: they change by a
    fraction of a pixel.

    offset: further shift in x and y [mm] and rotation [rad], shape (3,).
    """
    t = (offset / derivatives.steps).astype(np.float32)
    images = prediction.images.lights
    levels = [np.empty_like(image.level) for image in images]
    window = derivatives.window

    def extrapolate(number: int, rows: slice) -> None:
        levels[number][rows] = images[number].level[rows]
        first, last = max(rows.start, window[0].start), min(rows.stop, window[0].stop)
        if first < last:
            inner = levels[number][first:last]
            _add(derivatives.levels[number], t, first - window[0].start, window[1].start, inner)

    in_image_blocks(extrapolate, len(images), len(levels[0]), threads)
    moved = tuple(replace(image, level=level) for image, level in zip(images, levels, strict=True))
    return replace(prediction, images=replace(prediction.images, lights=moved))


@kernel
def _add(terms: Float32, t: Float32, top: int, left: int, level: Float32) -> None:
    # to rows of an image, of which the first is that of the terms' row `top`
    for y in range(level.shape[0]):
        for x in range(terms.shape[3]):
            value = level[y, left + x]
            for axis in range(3):
                value += t[axis] * (terms[axis, 0, top + y, x] + t[axis] * terms[axis, 1, top + y, x])
            level[y, left + x] = max(value, np.float32(0.0))
