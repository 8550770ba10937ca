"""How far a part lies from the predicted placement: fitted to few pixels, without casting a ray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lightopt.core.arrays import Bool, Float64, Index
from lightopt.core.least_squares import Limits, linear_problem, solve
from lightopt.core.transforms import rotation_z
from lightopt.estimate.registration import DARK_SPREAD, GAIN_SPREAD, Observation, Placement, PoseFrame
from lightopt.inspection.prediction._derivatives import PlacementDerivatives, difference_steps
from lightopt.inspection.prediction._predict import Prediction
from lightopt.scene import Scene, project, view_from_part

PIXELS = 10_000
"""Of each image: half of them where its level changes most with the place, half anywhere."""

STEEP_SHARE = 0.1
"""Of the pixels, those where it changes most."""

FURTHEST = 1.5
"""Steps that predictions are extrapolated to; beyond, the part is searched for. All steps are those of
:func:`difference_steps`."""

LOOSE, TIGHT = 2.0, 1.3
"""By how much the typical deviation of steep pixels may exceed that of the part that was predicted: with derivatives
from shifted images, which only decide whether better ones are rendered, and with those."""

REACH = 4.0
"""Steps that an offset is fitted up to; beyond :data:`FURTHEST` the part is not near."""

CLEAR = 3.5
_LEAST_PIXELS = 200


@dataclass(frozen=True, eq=False)
class PixelSample:
    """Some pixels of an image, n of them.

    pixel: raveled indices.
    steep: which of them are among those that change most with the placement.
    level: predicted [grey level at exposure 1].
    slope: change of the level per step in x, y and rotation, shape (n, 3).
    """

    pixel: Index
    steep: Bool
    level: Float64
    slope: Float64


@dataclass(frozen=True, eq=False)
class PlacementOffset:
    """How far a part lies from where it was predicted.

    offset: steps in x, y and rotation about the part's middle, shape (3,).
    errors: standard errors, same shape.
    """

    offset: Float64
    errors: Float64
    converged: bool

    @property
    def near(self) -> bool:
        """Whether the predictions can be moved so far."""
        return self.converged and bool(np.all(np.abs(self.offset) <= FURTHEST))

    def placement(self, scene: Scene, before: Placement) -> Placement:
        """Where the part lies, given the placement that was predicted."""
        x, y, turn = self.offset * difference_steps(scene)
        ex, ey, et = (float(e) for e in self.errors * difference_steps(scene))
        return replace(before, x=before.x + x, y=before.y + y, turn=before.turn + turn, errors=(ex, ey, et))


def sample_pixels(
    scene: Scene,
    placement: Placement,
    prediction: Prediction,
    derivatives: PlacementDerivatives | None,
    light: str,
) -> PixelSample:
    """The pixels of a light's image to fit the offset to; `derivatives` are None where they are not rendered yet."""
    number = [image.light for image in prediction.images.lights].index(light)
    level = prediction.images.lights[number].level
    clean = np.flatnonzero(prediction.clean)
    down, right = (np.asarray(g, np.float64).ravel()[clean] for g in np.gradient(level))
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


def _image_shifts(
    scene: Scene, placement: Placement, prediction: Prediction, pixel: Index
) -> tuple[Float64, Float64]:
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
) -> tuple[PlacementOffset, float]:
    """How far a part lies from where it was predicted, and the misfit of the steep pixels.

    Gains of the lights and a dark level are fitted along. The misfit is the median deviation of the steep pixels in
    standard deviations of the sensor's noise.

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
        return PlacementOffset(np.full(3, REACH), np.full(3, REACH), converged=False), np.inf
    resolution = np.maximum(PoseFrame.of(scene).resolution / difference_steps(scene), 1.0)
    reach = np.array([*[3.0] * n, 10.0 * DARK_SPREAD, *[REACH] * 3])
    limits = Limits(
        nominal=np.array([*[1.0] * n, *[0.0] * 4]),
        reach=reach,
        step=reach,
        prior=np.array([*[GAIN_SPREAD] * n, DARK_SPREAD, *[np.inf] * 3]),
        resolution=np.array([*[np.inf] * (n + 1), *(resolution if moves else [np.inf] * 3)]),
    )
    # what the images of the first part did not determine stays as it was
    a[:, n + 1 :] *= np.array(placement.observable)
    found = solve(linear_problem(a / noise[:, None], b / noise), limits.nominal, limits, least_spread=1.0)
    misfit = float(np.median(np.abs(b - a @ found.x)[steep] / noise[steep]))
    return PlacementOffset(found.x[n + 1 :], found.errors[n + 1 :], found.converged), misfit
