"""Frames of one exposure, their mean, and what of it is saturated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lightopt.optics import Sensor

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


class FrameMean:
    """Becomes one image while its frames come in, each of shape (H, W) [sensor level].

    Parameters
    ----------
    sensor
        That takes them.
    """

    def __init__(self, sensor: Sensor) -> None:
        self._sensor = sensor
        self._number = 0
        self._highest: NDArray[Any] | None = None
        self._sum: NDArray[np.float64] | None = None

    def add(self, levels: Levels) -> None:
        """Count a frame in."""
        self._number += 1
        if self._highest is None:
            self._highest = levels
            return
        if self._sum is None:
            self._sum = self._highest.astype(np.float64)
        self._sum += levels
        self._highest = np.maximum(self._highest, levels)

    def image(self, exposure: float) -> Exposed:
        """The image of the frames so far, at least one, at the relative exposure that the camera held."""
        highest = self._highest
        assert highest is not None
        saturated = highest >= self._sensor.saturated_from
        if self._sum is None:
            return Exposed(
                exposure=exposure, mean=highest.astype(np.float32), saturated=saturated, png=highest
            )
        mean = self._sum / self._number
        return Exposed(
            exposure=exposure,
            mean=mean.astype(np.float32),
            saturated=saturated,
            png=np.where(saturated, highest, np.rint(mean).astype(highest.dtype)),
        )


def mean_of_frames(frames: Iterable[Levels], *, sensor: Sensor, exposure: float) -> Exposed:
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
    mean = FrameMean(sensor)
    for levels in frames:
        mean.add(levels)
    return mean.image(exposure)
