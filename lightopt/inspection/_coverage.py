"""Which share of the surface was inspected, how sensitively, and why the rest was not."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from lightopt.inspection._deviation import Deviations
from lightopt.inspection._score import disc_gain
from lightopt.inspection._view import PostureView

__all__ = ["CONTRASTS", "Coverage", "Reached", "least_contrast", "measure_coverage"]

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

CONTRASTS: Final = (0.05, 0.1, 0.2, 0.4)
"""Shares of the light that a defect takes away, for which the sensitivity is told."""

TOLD_SIZE_PX = 5.0
"""Diameter of the even disc that it is told for."""


class Reached(IntEnum):
    """How far the inspection of a pixel got, the least first; with several postures the furthest counts."""

    NO_PART = 0
    EDGE = 1
    SHADOW = 2
    SATURATED = 3
    INSPECTED = 4


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """The surface that the camera sees in a posture.

    Attributes
    ----------
    seen
        [mm²].
    inspected
        Of it, judged under as many lights as a defect must show under [mm²].
    saturated, shadow, edge
        Of it, not judged: too few lights because image and prediction are saturated, because it is dark; next to
        silhouettes and creases, or seen at a grazing angle [mm²].
    sensitivity
        By contrast: the surface where an even disc of 5 pixels that changes the light by that share is found half of
        the time [mm²].
    reached
        :class:`Reached` of each pixel, shape (H, W).
    least_contrast
        Share of the light that such a disc must change to be found at a pixel, shape (H, W); infinite where nothing
        was inspected.
    """

    seen: float
    inspected: float
    saturated: float
    shadow: float
    edge: float
    sensitivity: dict[float, float]
    reached: NDArray[np.uint8] = field(compare=False, repr=False)
    least_contrast: Float32 = field(compare=False, repr=False)

    def as_dict(self) -> dict[str, Any]:
        """JSON form."""
        whole = max(self.seen, 1e-9)
        return {
            "seen_mm2": round(self.seen, 3),
            "inspected": round(self.inspected / whole, 5),
            "saturated": round(self.saturated / whole, 5),
            "shadow": round(self.shadow / whole, 5),
            "edge": round(self.edge / whole, 5),
            "finds_contrast": {f"{c:g}": round(a / whole, 5) for c, a in self.sensitivity.items()},
        }


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
    lights = len(view.lights)
    needed = min(seen_by, lights)
    usable = found.usable.sum(axis=0)
    inspected = part & (usable >= needed)
    full = (view.saturated & (view.predicted >= view.limit)).sum(axis=0)
    left = part & ~inspected
    edge = left & ~view.clean
    saturated = left & view.clean & (full >= lights - usable - full) & (full > 0)
    least = least_contrast(found, view.predicted, seen_by=needed, high=high)
    reached = np.zeros(part.shape, np.uint8)
    reached[part] = Reached.SHADOW
    reached[saturated] = Reached.SATURATED
    reached[edge] = Reached.EDGE
    reached[inspected] = Reached.INSPECTED
    return Coverage(
        seen=float(area[part].sum()),
        inspected=float(area[inspected].sum()),
        saturated=float(area[saturated].sum()),
        shadow=float(area[left & ~edge & ~saturated].sum()),
        edge=float(area[edge].sum()),
        sensitivity={c: float(area[inspected & (least <= c)].sum()) for c in CONTRASTS},
        reached=reached,
        least_contrast=np.where(inspected, least, np.inf).astype(np.float32),
    )


def least_contrast(
    found: Deviations, predicted: Float32, *, seen_by: int, high: float
) -> NDArray[np.float64]:
    """Share of the light that an even disc of 5 pixels must take away to be found half of the time, shape (H, W).

    Parameters
    ----------
    found
        Of a posture.
    predicted
        Of the good part [grey level], shape (lights, H, W).
    seen_by
        In how many images it must show, as many as there are at most.
    high
        Threshold of the score.
    """
    # deviation that so many images must show for the threshold, whatever the others do
    pairs = float(special.binom(len(predicted), seen_by))
    z = -float(special.ndtri(0.5 * (10.0**-high / pairs) ** (1.0 / seen_by)))
    # half of the time all of them do
    z += float(special.ndtri(0.5 ** (1.0 / seen_by)))
    least = np.where(
        found.usable, z * found.scale / (disc_gain(TOLD_SIZE_PX) * np.maximum(predicted, 1e-6)), np.inf
    )
    return np.sort(least, axis=0)[seen_by - 1]
