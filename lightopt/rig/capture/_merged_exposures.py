"""Exposures of an image: the mean of frames, agreement of two exposures, and one linear image from all."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.core.arrays import Bool, Float32, Float64
from lightopt.optics import Sensor
from lightopt.rig.devices import Levels

LEAST_LEVEL = 1.5  # pixels count that should be at least so far above black in the shorter exposure [sensor level]
LEAST_PIXELS = 30
MOST_PIXELS = 200_000  # of larger images a grid of about so many pixels is compared: the next exposure waits for it
TOLERANCE = 0.1  # share by which the exposures may differ: exposure times of cameras are not exact
TOLERANCE_LEVELS = 0.4  # levels by which they may differ in addition: clipping at level 0, an inexact black level


@dataclass(frozen=True)
class ExposureImage:
    """An image at one exposure; arrays of shape (H, W)."""

    exposure: float  # relative exposure, as the camera held it
    mean: Float32  # mean of the frames [sensor level]
    saturated: Bool  # where any frame reached the saturation level, so that the mean is too low
    # [sensor level] the frame as delivered; of several the mean, rounded half to even (half up would add 1/(2N) on
    # average), and the highest level of all where any was saturated
    png: Levels


class FrameMean:
    """Mean of frames that come in one by one, each of shape (H, W) [sensor level]."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._number = 0
        self._highest: NDArray[Any] | None = None
        self._sum: Float64 | None = None

    def add(self, levels: Levels) -> None:
        self._number += 1
        if self._highest is None:
            self._highest = levels
            return
        if self._sum is None:
            self._sum = self._highest.astype(np.float64)
        self._sum += levels
        self._highest = np.maximum(self._highest, levels)

    def image(self, exposure: float) -> ExposureImage:
        """The image of the frames so far, at least one, at the relative exposure that the camera held."""
        highest = self._highest
        assert highest is not None
        saturated = highest >= self._sensor.saturated_from
        if self._sum is None:
            return ExposureImage(exposure, highest.astype(np.float32), saturated, png=highest)
        mean = self._sum / self._number
        png = np.where(saturated, highest, np.rint(mean).astype(highest.dtype))
        return ExposureImage(exposure, mean.astype(np.float32), saturated, png)


def exposure_mismatch(
    light: str,
    one: ExposureImage,
    other: ExposureImage,
    *,
    darks: tuple[Float32 | float, Float32 | float],
    sensor: Sensor,
) -> str | None:
    """Message about how the brightness of a light differs between two exposures (H, W); None where it does not.

    Pixels that are saturated in the longer exposure must be at least that bright in the shorter one.
    `darks` are what each shows without the light [sensor level], (H, W) or one level.
    """
    pairs = [(one, np.asarray(darks[0], np.float32)), (other, np.asarray(darks[1], np.float32))]
    if one.exposure < other.exposure:
        pairs.reverse()
    (long, long_dark), (short, short_dark) = pairs
    ratio = short.exposure / long.exposure
    step = max(1, round(math.sqrt(long.mean.size / MOST_PIXELS)))
    some = (slice(step // 2, None, step), slice(step // 2, None, step))
    long_dark, short_dark = (dark[some] if dark.ndim else dark for dark in (long_dark, short_dark))
    long_full, short_full = long.saturated[some], short.saturated[some]
    expected = np.minimum(long.mean[some], sensor.saturated_from) - long_dark
    expected = expected * np.float32(ratio)
    seen = short.mean[some] - short_dark
    bright = expected >= LEAST_LEVEL
    both = bright & ~long_full & ~short_full
    only_long = bright & long_full & ~short_full
    for where, least in ((both, False), (only_long, True)):
        count = int(np.count_nonzero(where))
        if count < LEAST_PIXELS:
            continue
        should, found = (float(a[where].mean(dtype=np.float64)) for a in (expected, seen))
        off = found - should
        noise = sensor.noise_variance(should)
        allowed = TOLERANCE * should + TOLERANCE_LEVELS + 6.0 * float(np.sqrt(2.0 * noise / count))
        if off < -allowed or (off > allowed and not least):
            share = max(found, 0.0) / should if one is short else should / max(found, 1e-3)
            return (
                f"{light} is {share:.0%} as bright as at exposure {other.exposure:g}: it failed, changed, or another "
                "light was switched on between the exposures"
            )
    return None


def merge_exposures(
    images: Sequence[ExposureImage], *, sensor: Sensor, full_scale: float, dark: Sequence[Float32] | None = None
) -> dict[str, Float32]:
    """The linear image of a light: every pixel from the longest exposure in which it is not saturated.

    Level at exposure 1 = (sensor level − dark) · full scale / ((2^b − 1) · exposure).

    images: The exposures, of one shape (H, W), the longest first.
    full_scale: Grey level of a full-scale sensor level at exposure 1.
    dark: Mean frame without light of each exposure [sensor level], shape (H, W); else the black level is removed.
    Returns dict: EXR channels, float32 (H, W): ``Y`` [grey level at exposure 1]; ``valid``, 0 where every exposure was
        saturated and `Y` is only a lower bound; ``exposure``, the relative exposure that the pixel came from.
    """
    level = np.zeros(images[0].mean.shape, np.float32)
    exposure = np.zeros(level.shape, np.float32)
    missing = np.ones(level.shape, np.bool_)
    for i, image in enumerate(images):
        last = i == len(images) - 1
        take = missing if last else missing & ~image.saturated
        black = sensor.black_level if dark is None else dark[i]
        scale = full_scale / (sensor.max_level * image.exposure)
        np.copyto(level, ((image.mean - black) * scale).astype(np.float32), where=take)
        exposure[take] = image.exposure
        missing = missing & image.saturated
    return {"Y": level, "valid": (~missing).astype(np.float32), "exposure": exposure}
