"""Dark frames of a captured set: what the sensor shows when no panel is on, without the frame's own noise."""

from __future__ import annotations

import math

import numpy as np

from lightopt.core.arrays import Float64
from lightopt.core.errors import InputError
from lightopt.images import ImageEntry, ImageSet, dark_name, read_png, read_png_metadata
from lightopt.optics import Sensor

_REACH_PX = 4
"""A frame without light is smoothed over windows of 9 × 9 pixels, except where it shows more than noise."""


def frames_of(entry: ImageEntry) -> int:
    """Number of frames that an image is the mean of, from its manifest; 1 by default."""
    facts = entry.extra.get("capture")
    frames = facts.get("frames", 1) if isinstance(facts, dict) else 1
    return frames if isinstance(frames, int) and frames > 0 else 1


def dark_levels(image_set: ImageSet, entry: ImageEntry, sensor: Sensor) -> Float64 | None:
    """Levels of an image of a captured set without its light [sensor level], shape (H, W).

    None where the set was captured without such frames: the sensor's black level is all that is known then.

    Raises InputError: when the set was captured with frames without light, but that of the image is not listed.
    """
    if not image_set.manifest.options.get("dark"):
        return None
    name = dark_name(entry.posture, entry.exposure)
    if name not in image_set.manifest.files:
        raise InputError(
            f"{image_set.folder}: captured with --dark, but the manifest does not list {name}; take what is missing "
            "with lightopt capture --dark --resume"
        )
    path = image_set.path(name)
    levels = read_png(path).astype(np.float64)
    mean = read_png_metadata(path).get("mean_level")
    if isinstance(mean, int | float):
        levels += mean - float(levels.mean())  # of several frames the PNG has the rounded mean
    return smoothed(levels, sensor=sensor, frames=frames_of(entry))


def smoothed(levels: Float64, *, sensor: Sensor, frames: int) -> Float64:
    """A dark frame, freed of noise where it shows nothing else, and of what clipping at level 0 adds.

    Where the variance in a window is that of the noise the window's mean is taken, elsewhere as much of the pixel
    itself as the variance says (Lee 1980, doi:10.1109/TPAMI.1980.4766994).
    """
    mean = _window_mean(levels)
    variance = np.maximum(_window_mean(levels * levels) - mean * mean, 0.0)
    noise = sensor.noise_variance(mean - sensor.black_level)
    # a window's variance scatters: only what clearly exceeds that of noise is a pattern
    own = np.clip(1.0 - 2.0 * (noise / frames) / np.maximum(variance, 1e-12), 0.0, 1.0)
    return _unclipped(mean, sensor) + own * (levels - mean)


def _window_mean(image: Float64) -> Float64:
    """Means over square windows, which are cut off at the image's border."""
    for axis in (0, 1):
        size = image.shape[axis]
        total = np.insert(np.cumsum(image, axis=axis), 0, 0.0, axis=axis)
        low = np.maximum(np.arange(size) - _REACH_PX, 0)
        high = np.minimum(np.arange(size) + _REACH_PX + 1, size)
        count = (high - low).astype(np.float64)
        image = (total.take(high, axis) - total.take(low, axis)) / (count[:, None] if axis == 0 else count)
    return image


def _unclipped(mean: Float64, sensor: Sensor) -> Float64:
    """Mean of a signal whose noisy levels, none of which is below 0, have the mean given."""
    noise = sensor.read_noise_levels
    if noise < 0.3 or float(mean.min()) > 6.0 * noise:
        return mean  # levels are too coarse, or none is clipped
    signal = np.arange(-noise, 6.0 * noise, noise / 50.0)
    levels = np.arange(0.5, 14.0 * noise + 2.0)
    shown = _above((levels - signal[:, None]) / noise).sum(axis=1)
    return np.where(mean < shown[-1], np.interp(mean, shown, signal), mean)


def _above(z: Float64) -> Float64:
    """Probability that a normal deviate is above z."""
    return 0.5 * np.vectorize(math.erfc, otypes=[np.float64])(z / math.sqrt(2.0))
