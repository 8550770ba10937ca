"""The images of a light at several exposures as one: of each pixel the longest exposure that tells of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lightopt.core.kernels import kernel
from lightopt.estimate.registration import Observation
from lightopt.inspection._photometry import Photometry
from lightopt.scene import Scene

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

EVEN_VARIANCE = 0.3
"""Noise of this variance [sensor level²] before rounding makes the mean of rounded levels the light's, to 0.002."""


def merge_exposures(
    scene: Scene,
    observations: Sequence[Observation],
    predicted: Float32,
    photometry: Photometry,
    rows: slice,
    *,
    level: Float32,
    deviation: Float32,
    rounding: Float32,
    limit: Float32,
    saturated: Bool,
) -> None:
    """Write what the images of one light tell of some rows of pixels, as :class:`PostureView` has it.

    Parameters
    ----------
    scene
        For the sensor.
    observations
        The images of the light, in a posture.
    predicted
        Levels of the good part in these rows [grey level at exposure 1], shape (h, W).
    photometry
        To take out.
    rows
        Of the images.
    level, deviation, rounding, limit, saturated
        To write to, shape (h, W).
    """
    sensor = scene.sensor
    exposures = sorted(observations, key=lambda o: -o.exposure)
    gain = photometry.gains[exposures[0].light]
    open_ = np.ones(predicted.shape, np.bool_)
    for number, o in enumerate(exposures):
        scale = gain * o.exposure * sensor.max_level / scene.reflectance.full_scale
        still = sensor.noise_variance(0.0, frames=o.frames)
        subtracted = np.broadcast_to(np.float32(o.subtracted), o.levels.shape)[rows]
        _take(
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
def _take(
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
    # what one exposure says of the pixels that no longer one could tell of: where it is not full, or is the last
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
