"""Frames of one exposure, their mean, and what of it is saturated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lightopt.sensor import Sensor

__all__ = ["Exposed", "mean_of_frames"]

Levels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, kw_only=True)
class Exposed:
    """An image at one exposure; arrays of shape (H, W).

    Attributes
    ----------
    exposure
        Relative exposure, as the camera held it.
    mean
        Mean of the frames [sensor level].
    saturated
        Where any of the frames reached the saturation level, so that the mean says too little.
    png
        What is kept as PNG [sensor level]: the frame as delivered; of several the mean, rounded half to even (half up
        would add 1/(2N) on average), and the highest level of all where any was saturated.
    """

    exposure: float
    mean: NDArray[np.float32]
    saturated: NDArray[np.bool_]
    png: Levels


def mean_of_frames(frames: Sequence[Levels], *, sensor: Sensor, exposure: float) -> Exposed:
    """One image from the frames of an exposure.

    Parameters
    ----------
    frames
        Sensor levels, each of shape (H, W), at least one.
    sensor
        That took them.
    exposure
        Relative exposure, as the camera held it.
    """
    highest = np.maximum.reduce(frames)
    saturated = highest >= sensor.saturated_from
    if len(frames) == 1:
        return Exposed(
            exposure=exposure, mean=frames[0].astype(np.float32), saturated=saturated, png=frames[0]
        )
    mean = np.zeros(frames[0].shape, np.float64)
    for frame in frames:
        mean += frame
    mean /= len(frames)
    return Exposed(
        exposure=exposure,
        mean=mean.astype(np.float32),
        saturated=saturated,
        png=np.where(saturated, highest, np.rint(mean).astype(highest.dtype)),
    )
