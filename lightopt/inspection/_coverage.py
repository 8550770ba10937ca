"""Which share of the surface was inspected, how sensitively, and why the rest was not."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from lightopt.inspection._deviation import Deviations
from lightopt.inspection._score import noise_gain
from lightopt.inspection._view import PostureView

__all__ = ["CONTRASTS", "Coverage", "Reached", "measure_coverage"]

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

CONTRASTS: Final = (0.05, 0.1, 0.2, 0.4)
"""Shares of the light that a defect takes away, for which the sensitivity is told."""

TOLD_SCALE_PX = 2.0
"""Width of the Gaussian that it is told for: defects of some 5 pixels and more."""


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
        By contrast: the surface where a defect of some 5 pixels that changes the light by that share is found [mm²].
    reached
        :class:`Reached` of each pixel, shape (H, W).
    least_contrast
        Share of the light that such a defect must change to be found at a pixel, shape (H, W); infinite where nothing
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
    # deviation that `needed` images must show for the threshold, whatever the others do
    pairs = float(special.binom(lights, needed))
    z = -float(special.ndtri(0.5 * (10.0**-high / pairs) ** (1.0 / needed)))
    least = np.where(
        found.usable, z * found.scale / (noise_gain(TOLD_SCALE_PX) * np.maximum(view.predicted, 1e-6)), np.inf
    )
    kth = np.sort(least, axis=0)[needed - 1]
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
        sensitivity={c: float(area[inspected & (kth <= c)].sum()) for c in CONTRASTS},
        reached=reached,
        least_contrast=np.where(inspected, kth, np.inf).astype(np.float32),
    )
