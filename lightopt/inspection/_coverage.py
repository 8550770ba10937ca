"""Which share of the surface that a posture shows was inspected, how sensitively, and why the rest was not."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from lightopt.inspection._detection_score import disc_gain
from lightopt.inspection._deviation import Deviations
from lightopt.inspection._posture_view import PostureView
from lightopt.inspection._surface_classes import TOLD_SIZE_PX, Reached, Shares, class_areas

Float32 = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class Coverage(Shares):
    """The surface that the camera sees in a posture.

    Attributes
    ----------
    reached
        :class:`Reached` of each pixel, shape (H, W).
    least_contrast
        Share of the light that a disc of 5 pixels must change to be found at a pixel, shape (H, W); infinite where it
        is dark, or nothing was inspected.
    """

    reached: NDArray[np.uint8] = field(compare=False, repr=False)
    least_contrast: Float32 = field(compare=False, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        return {"seen_mm2": round(self.seen, 3), **self.shares()}


def measure_coverage(view: PostureView, found: Deviations, *, seen_by: int, high: float) -> Coverage:
    """The surface of a posture that was inspected.

    Parameters
    ----------
    view, found
        Of the posture.
    seen_by
        In how many images a defect must show.
    high
        Threshold of the score.
    """
    area = view.prediction.area.astype(np.float64)
    part = view.part & (area > 0.0)
    lit = found.lit.sum(axis=0)
    full = (view.saturated & (view.predicted >= view.limit)).any(axis=0)
    reached = np.zeros(part.shape, np.uint8)
    reached[part] = Reached.EDGE
    reached[part & view.prediction.grazing] = Reached.GRAZING
    reached[part & view.clean] = Reached.SHADOW
    reached[part & view.clean & full] = Reached.SATURATED
    reached[part & found.usable.any(axis=0)] = Reached.GLINTS
    reached[part & (lit > 0)] = Reached.FEWER
    reached[part & (lit >= seen_by)] = Reached.INSPECTED
    least = least_contrast(found, view.predicted, seen_by=seen_by, high=high)
    least[reached < Reached.FEWER] = np.inf
    return Coverage(
        **class_areas(area, reached, least), reached=reached, least_contrast=least.astype(np.float32)
    )


def least_contrast(
    found: Deviations, predicted: Float32, *, seen_by: int, high: float
) -> NDArray[np.float64]:
    """Share of the light that an even disc of 5 pixels must take away to be found half of the time, shape (H, W).

    Infinite where no image is lit.

    Parameters
    ----------
    found
        Of a posture.
    predicted
        Of the good part [grey level], shape (lights, H, W).
    seen_by
        In how many images it must show, or in all that are lit where these are fewer.
    high
        Threshold of the score.
    """
    images = len(predicted)
    k = np.clip(found.lit.sum(axis=0), 1, min(seen_by, images))
    needed = _needed(images, min(seen_by, images), high)[found.usable.sum(axis=0), k]
    share = np.where(found.lit, found.scale / np.maximum(predicted, 1e-6), np.inf)
    weakest = np.take_along_axis(np.sort(share, axis=0), k[None] - 1, axis=0)[0]
    return needed / disc_gain(TOLD_SIZE_PX) * weakest


def _needed(images: int, seen_by: int, high: float) -> NDArray[np.float64]:
    # deviation that k of n images must show for the threshold, whatever the others do, all of them half of the time;
    # by n and k
    z = np.full((images + 1, seen_by + 1), np.inf)
    for n in range(1, images + 1):
        for k in range(1, min(n, seen_by) + 1):
            each = (10.0**-high / float(special.binom(n, k))) ** (1.0 / k)
            z[n, k] = float(special.ndtri(0.5 ** (1.0 / k)) - special.ndtri(0.5 * each))
    return z
