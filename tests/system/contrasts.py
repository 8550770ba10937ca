"""A plain contrast test on noisy images, and beside it what the objective's bits say.

A pixel shows a defect in an image where its level is off the noise-free image of the good part by the threshold times
the noise there. The test knows nothing of patches, trials and fill factors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from touched import Touched

from lightopt.design import Contrast, Visibility, unpack_flags
from lightopt.optics import expose, image_rng
from lightopt.scene import Scene

__all__ = ["counted", "off", "predicted"]

Flags = NDArray[np.bool_]
Float64 = NDArray[np.float64]


def counted(
    seen: Touched,
    levels: tuple[Float64, Float64],
    scene: Scene,
    defects: int,
    *,
    contrast: Contrast,
    exposure: float = 1.0,
    image: int = 0,
) -> Flags:
    """Which defects the noisy images show, shape (lights, defects).

    Parameters
    ----------
    seen, levels
        The pixels, and what :meth:`Touched.levels` says of them.
    scene
        Its sensor and full scale.
    defects
        How many there are.
    contrast
        The threshold.
    exposure
        Of the images.
    image
        Number of the posture or comparison, for other noise than elsewhere.
    """
    shown = np.zeros((len(levels[0]), defects), np.bool_)
    for light, (good, bad) in enumerate(zip(*levels, strict=True)):
        rng = image_rng(0, light=light, posture=image, exposure=round(1000 * exposure))
        delivered = expose(
            bad[None].astype(np.float32),
            sensor=scene.sensor,
            exposure=exposure,
            full_scale=scene.reflectance.full_scale,
            rng=rng,
        )[0].astype(np.float64)
        flags = off(delivered, good, scene, contrast.threshold, exposure)
        shown[light, seen.defect[flags]] = True
    return shown


def off(delivered: Float64, good: Float64, scene: Scene, threshold: float, exposure: float = 1.0) -> Flags:
    """The plain contrast test: delivered levels against the noise-free ones of the good part [grey level]."""
    sensor = scene.sensor
    scale = exposure * sensor.max_level / scene.reflectance.full_scale
    expected = np.minimum(sensor.black_level + scale * good, sensor.saturated_from)
    photons = (
        0.0 if sensor.electrons_per_level is None else (expected - sensor.black_level) / sensor.electrons_per_level
    )
    noise = np.sqrt(sensor.read_noise_levels**2 + photons + 1.0 / 12.0)
    return np.abs(np.minimum(delivered, sensor.saturated_from) - expected) >= threshold * noise


def predicted(seen: Touched, visibility: Sequence[Visibility], first_trial: NDArray[np.intp], defects: int) -> Flags:
    """Which defects the objective's bits say the images show: on the patch of one of their walls; (lights, defects).

    Parameters
    ----------
    seen
        The pixels.
    visibility
        Of one position of each light, one for each exposure.
    first_trial
        Of each defect, the first of its trials.
    defects
        How many there are.
    """
    first = visibility[0]
    row_of = np.full(int(max(first.patch.max(), seen.patch.max())) + 1, -1)
    row_of[first.patch] = np.arange(len(first.patch))
    on = np.flatnonzero((seen.wall >= 0) & (row_of[seen.patch] >= 0))
    rows, trial = row_of[seen.patch[on]], first_trial[seen.defect[on]] + seen.wall[on]
    shown = np.zeros((len(first.words), defects), np.bool_)
    for one in visibility:
        for light, layer in enumerate(one.words):
            flags = unpack_flags(layer[0][rows], len(one.hypotheses))[np.arange(len(on)), trial]
            shown[light, seen.defect[on[flags.astype(bool)]]] = True
    return shown
