"""Images through a lens of finite aperture: means over pinholes that are spread over it, and diffraction.

Each pinhole has the perspective of its place, so that edges hide what they hide, and highlights, which are images of a
light at a depth of their own, are blurred by that depth. The images are linear: what would saturate spreads, too.
"""

import logging
from collections.abc import Callable

import numpy as np

from lightopt.core.arrays import Float32, Float64
from lightopt.optics import airy_kernel, pupil_points
from lightopt.scene import Scene

_log = logging.getLogger("lightopt.rendering")

# Views are added, doubling their number, until the mean changes by less than the camera's noise
FIRST_VIEWS, TYPICAL_VIEWS, MOST_VIEWS = 4, 16, 256

# in all but this share of the lit pixels: at sharp edges the mean of n views has steps of 1/n of the contrast
MOST_CHANGED = 0.005

Images = list[dict[str, Float32]]  # the image of each light: its level and, with layers, its components [grey level]
Sums = list[dict[str, Float64]]  # of such images

_GOLDEN = 0.6180339887498949  # multiples of it, modulo 1, are well spread, however many they are


def added(sums: Sums, images: Images) -> Sums:
    """Sums with images added to them; an empty list becomes the sums of these alone."""
    sums = sums or [{name: np.zeros(level.shape) for name, level in one.items()} for one in images]
    for total, one in zip(sums, images, strict=True):
        for name, level in one.items():
            total[name] += level
    return sums


def lens_means(render_view: Callable[[Float64, Float64, float], Images], scene: Scene, *, least: int = 1) -> Images:
    """Mean over views through well-spread places of the lens, each with rays at another place of the pixels.

    render_view: Of a place in the unit disc of the lens and of an offset from the pixels' centres [px], shapes (2,),
        at an instant, in exposure times after the exposure's middle
    scene: With the camera and the sensor
    least: Number of views at least
    """
    places, offsets = pupil_points(MOST_VIEWS)
    sums: Sums = []
    count, changed = 0, 1.0
    while count < MOST_VIEWS and (count < least or changed > MOST_CHANGED):
        before = [one["level"] / count for one in sums]
        for number in range(count, max(2 * count, FIRST_VIEWS)):
            instant = (0.5 + number * _GOLDEN) % 1.0 - 0.5
            sums = added(sums, render_view(places[number], offsets[number], instant))
        count = max(2 * count, FIRST_VIEWS)
        if before:
            shares = [_changed(old, one["level"] / count, scene) for old, one in zip(before, sums, strict=True)]
            changed = max(shares, default=0.0)
    _log.info("lens: %d views; the last half changed %.2g of the pixels by more than noise", count, changed)
    cutoff = scene.camera.diffraction_cutoff
    kernel = None if cutoff is None else airy_kernel(cutoff)
    return [{name: _spread(total / count, kernel) for name, total in one.items()} for one in sums]


def _changed(before: Float64, after: Float64, scene: Scene) -> float:
    # share of the lit pixels that changed by more than the noise of the longest exposure that does not saturate them
    sensor = scene.sensor
    scale = sensor.max_level / scene.reflectance.full_scale
    signal, top = after * scale, float(sensor.max_level)
    noise = np.sqrt(sensor.noise_variance(np.minimum(signal, top))) * np.maximum(signal / top, 1.0)
    lit = np.maximum(signal, before * scale) > noise
    return float(np.count_nonzero(np.abs(after - before) * scale > noise) / max(1, np.count_nonzero(lit)))


def _spread(level: Float64, kernel: Float64 | None) -> Float32:
    if kernel is not None and level.any():
        from scipy import signal

        # mirrored at the borders, so that a part that leaves the view is not darker there
        wide = np.pad(level, len(kernel) // 2, mode="symmetric")
        # rounding of the transform goes both ways
        level = np.maximum(signal.fftconvolve(wide, kernel, mode="valid"), 0.0)
    return level.astype(np.float32)
