"""The images of a posture beside the predicted good part: the input of fusion and detection."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from lightopt.core.arrays import Bool, Float32
from lightopt.core.errors import InputError, counted
from lightopt.core.kernels import kernel
from lightopt.core.transforms import Posture
from lightopt.estimate.registration import Observation, refuse_mismatch
from lightopt.inspection._image_blocks import in_image_blocks
from lightopt.inspection.prediction._photometry import Photometry, fit_photometry, some_pixels
from lightopt.inspection.prediction._predict import Prediction
from lightopt.scene import Scene

_ARRAYS = ("level", "predicted", "deviation", "rounding", "limit", "saturated")

# noise of this variance [sensor level²] before rounding makes the mean of rounded levels the light's, to 0.002
EVEN_VARIANCE = 0.3


@dataclass(frozen=True, kw_only=True)
class PostureView:
    """Images of one posture, one per light, and the prediction; all levels in grey levels at exposure 1.

    lights: names, of those that the set has for this posture.
    level: measured, black level and the lights' gains taken out, shape (lights, H, W). Of several exposures of a
        light each pixel has the longest that is saturated neither in the image nor in the prediction.
    predicted: of the good part, same shape.
    deviation: standard deviation of the sensor's noise at the predicted level, same shape.
    rounding: by how much rounding may shift the mean of levels, where noise does not even it out, same shape.
    limit: level from which a pixel is saturated, same shape; where it is, not above `level`: a lower bound is never
        darker than the good part.
    saturated: where `level` is only a lower bound, same shape.
    prediction: the images that `predicted` is from, and the pixels that can be judged.
    """

    posture: Posture
    lights: tuple[str, ...]
    level: Float32
    predicted: Float32
    deviation: Float32
    rounding: Float32
    limit: Float32
    saturated: Bool
    prediction: Prediction
    photometry: Photometry

    @cached_property
    def specular(self) -> Float32:
        """The highlights' share of `predicted`, same shape; stacked on first use."""
        images = {image.light: image.specular for image in self.prediction.images.lights}
        return np.stack([cast("Float32", images[light]) for light in self.lights])

    @property
    def part(self) -> Bool:
        """Pixels that show the part, shape (H, W)."""
        return self.prediction.images.geometry.hit

    @property
    def clean(self) -> Bool:
        """Pixels that can be judged, shape (H, W)."""
        return self.prediction.clean


def posture_view(
    scene: Scene, observations: Sequence[Observation], prediction: Prediction, *, where: str, threads: int | None = None
) -> PostureView:
    """Compare the images of one posture with its prediction: fit gains and dark level, merge exposures.

    observations: Of one posture.
    where: The set, for messages.
    Raises InputError: images that do not look like the prediction, or that are all saturated.
    """
    clean = prediction.clean
    if clean.any() and all(bool((o.saturated | ~clean).all()) for o in observations):
        raise InputError(
            f"{where}, posture {observations[0].posture}: all {clean.sum():,} pixels of the part that can be judged "
            f"are saturated in each of {counted(len(observations), 'image')}: they show nothing; take them with a "
            "shorter exposure or less light"
        )
    images = {image.light: image.level for image in prediction.images.lights}
    photometry = fit_photometry(observations, [images[o.light] for o in observations], clean, scene, threads=threads)
    lights = tuple(name for name in images if any(o.light == name for o in observations))
    shape = len(lights), *clean.shape
    arrays: dict[str, Any] = {
        name: np.empty(shape, np.bool_ if name == "saturated" else np.float32) for name in _ARRAYS
    }

    def merge(number: int, rows: slice) -> None:
        light = lights[number]
        here = {name: array[number, rows] for name, array in arrays.items()}
        here["predicted"][:] = images[light][rows]
        _merge_exposures(scene, [o for o in observations if o.light == light], photometry, rows, **here)

    in_image_blocks(merge, len(lights), len(clean), threads)
    posture = observations[0].posture
    level, predicted, limit, deviation = (arrays[k] for k in ("level", "predicted", "limit", "deviation"))
    refuse_mismatch(level, predicted, limit, deviation, some_pixels(clean), f"{where}, posture {posture}")
    return PostureView(posture=posture, lights=lights, prediction=prediction, photometry=photometry, **arrays)


def _merge_exposures(
    scene: Scene,
    observations: Sequence[Observation],
    photometry: Photometry,
    rows: slice,
    *,
    level: Float32,
    predicted: Float32,
    deviation: Float32,
    rounding: Float32,
    limit: Float32,
    saturated: Bool,
) -> None:
    # write some rows of what PostureView has of a light, shape (h, W), but for `predicted`, which is given: of each
    # pixel the longest exposure that is not saturated
    sensor = scene.sensor
    exposures = sorted(observations, key=lambda o: -o.exposure)
    gain = photometry.gains[exposures[0].light]
    open_ = np.ones(predicted.shape, np.bool_)
    for number, o in enumerate(exposures):
        scale = gain * o.exposure * sensor.max_level / scene.reflectance.full_scale
        still = sensor.noise_variance(0.0, frames=o.frames)
        subtracted = np.broadcast_to(np.float32(o.subtracted), o.levels.shape)[rows]
        _merge_exposure(
            np.ascontiguousarray(o.levels[rows]),
            o.saturated[rows],
            np.ascontiguousarray(subtracted),
            predicted,
            open_,
            number + 1 == len(exposures),
            scale,
            sensor.black_level + photometry.dark,
            photometry.dark,
            sensor.saturated_from - sensor.black_level,
            still,
            sensor.noise_variance(1.0, frames=o.frames) - still,  # the variance is linear in the signal
            level,
            deviation,
            rounding,
            limit,
            saturated,
        )


@kernel
def _merge_exposure(
    levels: Float32,
    full: Bool,
    subtracted: Float32,
    predicted: Float32,
    open_: Bool,
    last: bool,
    scale: float,
    black: float,
    dark: float,
    saturation: float,
    still: float,
    shot: float,
    level: Float32,
    deviation: Float32,
    rounding: Float32,
    limit: Float32,
    saturated: Bool,
) -> None:
    # one exposure, of the pixels that no longer one could measure: where it is not saturated, or is the last
    height, width = levels.shape
    for y in range(height):
        for x in range(width):
            if not open_[y, x]:
                continue
            top = saturation - subtracted[y, x]
            signal = min(predicted[y, x] * scale, top)
            if not last and (full[y, x] or signal >= top):
                continue
            open_[y, x] = False
            level[y, x] = (levels[y, x] - black) / scale
            variance = still + shot * signal
            deviation[y, x] = math.sqrt(variance) / scale
            before = variance - 1.0 / 12.0
            rounding[y, x] = 0.0
            if before < EVEN_VARIANCE:
                # the first harmonic of what rounding does to the mean of a normal deviate, or half a level without any
                rounding[y, x] = 0.5 * math.exp(-2.0 * math.pi**2 * before) / scale
            limit[y, x] = (top - 0.5 - dark) / scale
            saturated[y, x] = full[y, x]
            if full[y, x]:
                limit[y, x] = min(limit[y, x], level[y, x])
