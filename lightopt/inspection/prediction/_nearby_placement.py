"""Parts of a batch with nearly the same placement: registration and prediction without casting rays.

The derivatives of a prediction with respect to the placement move it by a fraction of a pixel; how far it is to be
moved is fitted to few pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Bool, Float32, Float64, Index
from lightopt.core.kernels import kernel
from lightopt.core.least_squares import Limits, linear_problem, solve
from lightopt.core.transforms import Posture, rotation_z
from lightopt.estimate.registration import DARK_SPREAD, GAIN_SPREAD, Observation, Placement, PoseFrame, view_of_placed
from lightopt.geometry import RayCaster
from lightopt.inspection._image_blocks import in_image_blocks, mask_window
from lightopt.inspection.prediction._predict import Prediction
from lightopt.rendering import render_lights
from lightopt.scene import Scene, pixel_footprint, project, view_from_part

# for the differences the part is rendered this far to either side, for a shift in x and y and a rotation
STEP_PX = 0.25

PIXELS = 10_000  # of each image: half of them where its level changes most with the place, half anywhere
STEEP_SHARE = 0.1  # of the pixels, those where it changes most

# Steps that predictions are extrapolated to; beyond, the part is searched for. All steps are those of
# `difference_steps`.
FURTHEST = 1.5

# by how much the typical deviation of steep pixels may exceed that of the part that was predicted: with derivatives
# from shifted images, which only decide whether better ones are rendered, and with those
LOOSE, TIGHT = 2.0, 1.3

REACH = 4.0  # steps that an offset is fitted up to; beyond `FURTHEST` the part is not near

CLEAR = 3.5
_LEAST_PIXELS = 200


@dataclass(frozen=True, eq=False)
class PlacementDerivatives:
    """Central differences of a prediction with respect to the placement."""

    # of each light, per step in x, y and rotation: half the difference of the levels at the two sides, and half of
    # their second difference [grey level], shape (lights, 3, 2, h, w)
    levels: Float32
    window: tuple[slice, slice]  # rows and columns of the image that the arrays are of; elsewhere nothing changes
    steps: Float64  # in x and y [mm] and in rotation [rad], shape (3,)


def difference_steps(scene: Scene) -> Float64:
    """Shifts [mm] and rotation [rad] that move the image of the part by :data:`STEP_PX`, shape (3,)."""
    camera = scene.camera
    distance = float(np.linalg.norm(camera.position - scene.pivot))
    shift = STEP_PX * pixel_footprint(camera, distance)
    flat = scene.mesh.vertices[:, :2] - scene.pivot[:2]
    radius = float(np.sqrt(np.max(np.sum(flat * flat, axis=1))))
    return np.array([shift, shift, shift / max(radius, 1.0)])


def shifted_scene(scene: Scene, placement: Placement, posture: Posture, offset: Float64) -> Scene:
    """A scene whose images in a posture are those of its part moved on from `placement`, by x, y [mm] and rotation.

    The mesh stays, so that one ray caster serves: camera and lights go the other way.
    """
    turn = float(offset[2])
    # it rotates about its own middle, and placements rotate about the pivot
    middle = np.array([placement.x, placement.y, 0.0])
    x, y, _ = middle - rotation_z(turn) @ middle
    offset_place = Placement(x=float(x + offset[0]), y=float(y + offset[1]), turn=turn)
    return view_of_placed(scene, posture, offset_place).of_scene(scene)


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
            render_lights(
                replace(moved, lights=tuple(light for light in moved.lights if light.name in names)),
                posture,
                caster=caster,
                averaged=prediction.clean,
                threads=threads,
            )
            for moved in (shifted_scene(scene, placement, posture, sign * offset) for sign in (1.0, -1.0))
        )
        for i, (upper, lower) in enumerate(zip(more, less, strict=True)):
            levels[i, axis, 0] = 0.5 * (upper.level[window] - lower.level[window])
            levels[i, axis, 1] = 0.5 * (upper.level[window] + lower.level[window]) - middle[i]
    return PlacementDerivatives(levels=levels, window=window, steps=steps)


def shift_prediction(
    prediction: Prediction, derivatives: PlacementDerivatives, offset: Float64, *, threads: int | None = None
) -> Prediction:
    """A prediction for a part moved on by x, y [mm] and rotation [rad]: a Taylor series of second order.

    Which pixels can be judged, what they see and the share of highlights stay those of the prediction: they change by a
    fraction of a pixel.
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


@dataclass(frozen=True, eq=False)
class PixelSample:
    """Some pixels of an image, n of them."""

    pixel: Index  # raveled indices
    steep: Bool  # which of them are among those that change most with the placement
    level: Float64  # predicted [grey level at exposure 1]
    slope: Float64  # change of the level per step in x, y and rotation, shape (n, 3)


@dataclass(frozen=True, eq=False)
class PlacementOffset:
    """Displacement of a part from its predicted placement."""

    offset: Float64  # steps in x, y and rotation about the part's middle, shape (3,)
    errors: Float64  # standard errors, same shape
    converged: bool
    misfit: float  # median deviation of the steep pixels, in standard deviations of the sensor's noise

    @property
    def near(self) -> bool:
        """Whether the displacement is small enough to shift the predictions."""
        return self.converged and bool(np.all(np.abs(self.offset) <= FURTHEST))

    def placement(self, scene: Scene, before: Placement) -> Placement:
        x, y, turn = self.offset * difference_steps(scene)
        ex, ey, et = (float(e) for e in self.errors * difference_steps(scene))
        errors = (ex, ey, et, *before.errors[3:])
        return replace(before, x=before.x + x, y=before.y + y, turn=before.turn + turn, errors=errors)


def sample_pixels(
    scene: Scene, placement: Placement, prediction: Prediction, derivatives: PlacementDerivatives | None, light: str
) -> PixelSample:
    """The pixels of a light's image to fit the offset to; `derivatives` are None where they are not rendered yet."""
    number = [image.light for image in prediction.images.lights].index(light)
    level = prediction.images.lights[number].level
    clean = np.flatnonzero(prediction.clean)
    down, right = (g.ravel()[clean].astype(np.float64) for g in np.gradient(level))
    step = np.hypot(down, right)
    if not len(clean):
        return PixelSample(clean, np.zeros(0, np.bool_), np.zeros(0), np.zeros((0, 3)))
    steep = step >= np.quantile(step, 1.0 - STEEP_SHARE)
    picked = [which[:: max(1, len(which) // (PIXELS // 2))] for which in map(np.flatnonzero, (steep, ~steep))]
    index = np.sort(np.concatenate(picked))
    pixel = clean[index]
    if derivatives is None:
        # the image of the part moves, as if its light did along
        x, y = _image_shifts(scene, placement, prediction, pixel)
        slope = -(right[index][:, None] * x + down[index][:, None] * y)
    else:
        rows, columns = np.unravel_index(pixel, level.shape)
        inner = rows - derivatives.window[0].start, columns - derivatives.window[1].start
        slope = np.stack([derivatives.levels[number, axis, 0][inner] for axis in range(3)], axis=1)
    return PixelSample(pixel, steep[index], level.ravel()[pixel].astype(np.float64), slope.astype(np.float64))


def _image_shifts(scene: Scene, placement: Placement, prediction: Prediction, pixel: Index) -> tuple[Float64, Float64]:
    # columns and rows that the surface at pixels moves by per step in x, y and rotation, each of shape (n, 3)
    posture = prediction.images.posture
    view = view_from_part(scene, posture)
    world = prediction.images.geometry.points.reshape(-1, 3)[pixel].astype(np.float64)
    own = (world - view.translation) @ view.rotation
    column, row, _ = project(view.camera, own)
    middle = scene.pivot + np.array([placement.x, placement.y, 0.0])
    across: list[Float64] = []
    along: list[Float64] = []
    for axis, step in enumerate(difference_steps(scene)):
        shift, turn = (step, 0.0) if axis < 2 else (0.0, float(step))
        there = (own - middle) @ rotation_z(turn).T + middle + shift * np.eye(3)[axis]
        columns, rows, _ = project(view.camera, there)
        across.append(columns - column)
        along.append(rows - row)
    return np.stack(across, axis=1), np.stack(along, axis=1)


def fit_placement_offset(
    scene: Scene,
    placement: Placement,
    observations: Sequence[Observation],
    samples: Sequence[PixelSample],
    *,
    moves: bool,
) -> PlacementOffset:
    """Fit the displacement of a part from its predicted placement, with the gains of the lights and a dark level.

    moves: whether the part may lie elsewhere; else only light is fitted.
    """
    sensor = scene.sensor
    names = [light.name for light in scene.lights]
    n = len(names)
    rows: list[tuple[Float64, Float64, Float64, Bool]] = []
    for o, sample in zip(observations, samples, strict=True):
        scale = o.exposure * sensor.max_level / scene.reflectance.full_scale
        model = scale * sample.level
        noise = np.sqrt(sensor.noise_variance(model, frames=o.frames))
        subtracted = np.broadcast_to(np.float32(o.subtracted), o.levels.shape).ravel()[sample.pixel]
        top = sensor.saturated_from - sensor.black_level - subtracted
        reach = FURTHEST * scale * np.abs(sample.slope).sum(axis=1)
        good = ~o.saturated.ravel()[sample.pixel]
        good &= (model + reach + CLEAR * noise < top) & (model - reach > CLEAR * noise)
        design = np.zeros((int(good.sum()), n + 4))
        design[:, names.index(o.light)] = model[good]
        design[:, n] = 1.0
        if moves:
            design[:, n + 1 :] = scale * sample.slope[good]
        target = o.levels.ravel()[sample.pixel][good].astype(np.float64) - sensor.black_level
        rows.append((design, target, noise[good], sample.steep[good]))
    a, b, noise, steep = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    if np.count_nonzero(steep) < _LEAST_PIXELS:
        return PlacementOffset(np.full(3, REACH), np.full(3, REACH), converged=False, misfit=np.inf)
    resolution = np.maximum(PoseFrame.of(scene).resolution[:3] / difference_steps(scene), 1.0)
    reach = np.array([*[3.0] * n, 10.0 * DARK_SPREAD, *[REACH] * 3])
    limits = Limits(
        nominal=np.array([*[1.0] * n, *[0.0] * 4]),
        reach=reach,
        step=reach,
        prior=np.array([*[GAIN_SPREAD] * n, DARK_SPREAD, *[np.inf] * 3]),
        resolution=np.array([*[np.inf] * (n + 1), *(resolution if moves else [np.inf] * 3)]),
    )
    # what the images of the first part did not determine stays as it was
    a[:, n + 1 :] *= np.array(placement.observable[:3])
    found = solve(linear_problem(a / noise[:, None], b / noise), limits.nominal, limits, least_spread=1.0)
    misfit = float(np.median(np.abs(b - np.einsum("ij,j->i", a, found.x))[steep] / noise[steep]))
    return PlacementOffset(found.x[n + 1 :], found.errors[n + 1 :], found.converged, misfit)
