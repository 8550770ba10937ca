"""How a prediction changes with the placement: parts of a batch that lie nearly alike need no rays of their own."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lightopt.core.kernels import kernel
from lightopt.core.threads import in_threads
from lightopt.core.transforms import Posture, rotation_z
from lightopt.estimate.registration import Placement, view_of_placed
from lightopt.geometry import RayCaster
from lightopt.inspection._row_blocks import BLOCK_ROWS, row_blocks
from lightopt.inspection.prediction._predict import Prediction
from lightopt.rendering import render_posture
from lightopt.scene import Scene, pixel_footprint

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]

NODE_PX = 0.25
"""Predictions are rendered with the part this far to either side, for a shift in x and y and a turn."""


@dataclass(frozen=True, eq=False)
class Slopes:
    """Change of a prediction with the part's place.

    Attributes
    ----------
    levels
        Of each light, per node step in x, y and turn: half the difference of the levels at the two nodes, and half of
        what they are off the middle together [grey level], shape (lights, 3, 2, h, w).
    window
        Rows and columns of the image that the arrays are of; elsewhere nothing changes.
    steps
        Node steps in x and y [mm] and in turn [rad], shape (3,).
    """

    levels: Float32
    window: tuple[slice, slice]
    steps: Float64


def node_steps(scene: Scene) -> Float64:
    """Shifts [mm] and turn [rad] that move the image of the part by :data:`NODE_PX`, shape (3,)."""
    camera = scene.camera
    distance = float(np.linalg.norm(camera.position - scene.pivot))
    shift = NODE_PX * pixel_footprint(camera, distance)
    flat = scene.mesh.vertices[:, :2] - scene.pivot[:2]
    radius = float(np.sqrt(np.max(np.sum(flat * flat, axis=1))))
    return np.array([shift, shift, shift / max(radius, 1.0)])


def move(scene: Scene, placement: Placement, posture: Posture, off: Float64) -> Scene:
    """A scene whose images in a posture are those of its part moved a little further on the stage.

    The mesh stays, so that one ray caster serves: camera and lights go the other way.

    Parameters
    ----------
    scene
        With the part at `placement`.
    placement
        From where its file has it.
    posture
        Of the part.
    off
        Further shift in x and y [mm] and turn [rad], shape (3,).
    """
    turn = float(off[2])
    # it turns about its own middle, and placements turn about the pivot
    middle = np.array([placement.x, placement.y, 0.0])
    x, y, _ = middle - rotation_z(turn) @ middle
    view = view_of_placed(scene, posture, x + float(off[0]), y + float(off[1]), turn)
    return replace(
        scene,
        camera=view.camera.moved(view.rotation, view.translation),
        lights=tuple(light.moved(view.rotation, view.translation) for light in view.lights),
    )


def prediction_slopes(
    scene: Scene,
    placement: Placement,
    posture: Posture,
    prediction: Prediction,
    caster: RayCaster,
    *,
    threads: int | None = None,
) -> Slopes:
    """Render a prediction's posture with the part a little to either side.

    Parameters
    ----------
    scene, placement
        The part where the prediction has it.
    posture
        Of the part.
    prediction
        Of that posture.
    caster
        Of the scene's part.
    threads
        Number of threads; the result does not depend on it.
    """
    images = prediction.images.lights
    names = {image.light for image in images}
    steps = node_steps(scene)
    rows, columns = (np.flatnonzero(prediction.images.geometry.hit.any(axis=axis)) for axis in (1, 0))
    window = tuple(
        slice(max(0, int(side[0]) - 2), int(side[-1]) + 3) if len(side) else slice(0, 0)
        for side in (rows, columns)
    )
    middle = [image.level[window] for image in images]
    levels = np.zeros((len(images), 3, 2, *middle[0].shape), np.float32)
    for axis, off in enumerate(np.diag(steps)):
        more, less = (
            render_posture(
                replace(moved, lights=tuple(light for light in moved.lights if light.name in names)),
                posture,
                caster=caster,
                threads=threads,
            ).lights
            for moved in (move(scene, placement, posture, sign * off) for sign in (1.0, -1.0))
        )
        for i, (upper, lower) in enumerate(zip(more, less, strict=True)):
            levels[i, axis, 0] = 0.5 * (upper.level[window] - lower.level[window])
            levels[i, axis, 1] = 0.5 * (upper.level[window] + lower.level[window]) - middle[i]
    return Slopes(levels=levels, window=(window[0], window[1]), steps=steps)


def shifted(
    prediction: Prediction, slopes: Slopes, off: Float64, *, threads: int | None = None
) -> Prediction:
    """A prediction for a part that lies a little further on the stage: parabolas through what was rendered.

    Which pixels can be judged, what they see and the share of highlights stay those of the prediction: they change by a
    fraction of a pixel.

    Parameters
    ----------
    prediction, slopes
        Of one posture.
    off
        Further shift in x and y [mm] and turn [rad], shape (3,).
    threads
        Number of threads; the result does not depend on it.
    """
    t = (off / slopes.steps).astype(np.float32)
    images = prediction.images.lights
    levels = [np.empty_like(image.level) for image in images]
    rows, columns = slopes.window
    pieces = [(number, top) for number in range(len(images)) for top in row_blocks(len(levels[0]))]

    def piece(place: int) -> None:
        number, top = pieces[place]
        bottom = min(top + BLOCK_ROWS, len(levels[number]))
        levels[number][top:bottom] = images[number].level[top:bottom]
        first, last = max(top, rows.start), min(bottom, rows.stop)
        if first < last:
            inner = levels[number][first:last]
            _add(slopes.levels[number], t, first - rows.start, columns.start, inner)

    in_threads(piece, range(len(pieces)), threads)
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
