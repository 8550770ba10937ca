"""What an objective has to offer, so that the search can find its optimum."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.core.errors import percent
from lightopt.core.progress import Share
from lightopt.design.responses._luminance_matrix import AREA_UNIT_MM2, LuminanceMatrix, Thresholds
from lightopt.rendering import GRAZING_DEG

INSPECTABLE_SURFACE = (
    f"the surface that the camera sees in the posture at up to {GRAZING_DEG:g}° to its normal; of several postures, "
    "added up"
)
"""What shares of area are shares of."""

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]

NEAR_PER_MILLE = 5
"""How near to the best a score is near [thousandths of the inspectable area, where a score is an area; else of the best
score]: half a point, less than what placement and reflectance are known to."""


def share_of_whole(objective: Objective, score: int, area: int) -> float | None:
    """A score as a share of the inspectable area [µm²]; None where it is no area."""
    whole = objective.whole(area)
    return None if whole is None else score / max(1, whole)


def near_margin(objective: Objective, best: int, area: int) -> int:
    """By how much a score may be below the best one and still be near it: see :data:`NEAR_PER_MILLE`."""
    whole = objective.whole(area)
    return NEAR_PER_MILLE * (best if whole is None else whole) // 1000


def area_text(area: float, grain: float) -> str:
    """An area in mm², to the digit that its grain supports, hundredths at most.

    Parameters
    ----------
    area, grain
        The area, and how far it may be off since each patch counts as its middle does [µm²].

    Examples
    --------
    >>> area_text(2_358_123_456, 2_900_000), area_text(2_358_123_456, 29_000_000), area_text(130_000, 2_900_000)
    ('2,358 mm²', '2,360 mm²', '< 1 mm²')
    >>> area_text(250_000, 0.0), area_text(0, 2_900_000)
    ('0.25 mm²', '0 mm²')
    """
    place = max(-2, math.floor(math.log10(max(grain * AREA_UNIT_MM2, 1e-9))))
    rounded = round(area * AREA_UNIT_MM2, -place)
    digits = max(0, -place)
    if area and not rounded:
        return f"< {10.0**place:,.{digits}f} mm²"
    return f"{rounded:,.{digits}f} mm²"


def share_text(share: float, grain: float, *, short_of: float = 1.0) -> str:
    """A share of the surface to the decimals that its grain supports, one at most.

    Parameters
    ----------
    share, grain
        The share, and how far it may be off since each patch counts as its middle does.
    short_of
        As for :func:`lightopt.core.errors.percent`.

    Examples
    --------
    >>> share_text(0.92174, 0.0011), share_text(0.92174, 0.02), share_text(0.002, 0.02)
    ('92.2 %', '92 %', '< 1 %')
    >>> share_text(0.949, 0.02, short_of=0.95)
    '94.9 %'
    """
    digits = 1 if grain < 0.01 else 0
    if share > 0.0 and not round(100.0 * share, digits):
        return f"< {10.0**-digits:.{digits}f} %"
    return percent(share, digits, short_of=short_of)


class Objective(Protocol):
    """A score of a combination of light positions, in whole numbers; larger is better, 0 is nothing gained.

    Attributes
    ----------
    name
        As on the command line.
    unit
        What one unit of the score is.
    share_of
        What a score is a share of, in words; None where it is no area.
    """

    @property
    def name(self) -> str: ...

    @property
    def unit(self) -> str: ...

    @property
    def share_of(self) -> str | None: ...

    def shown(self, score: int, grain: float) -> str:
        """A score, or a difference of two, for people, with its unit; areas to the digits of their grain [µm²]."""
        ...

    def whole(self, area: int) -> int | None:
        """The score of an inspectable area [µm²] that is won wholly; None where a score is no area."""
        ...

    def refusal(self, lights: int) -> str | None:
        """Why the objective says nothing of this number of lights; None where it does."""
        ...

    def weights(self, areas: Float64) -> Int64:
        """How much each patch counts in the score and in its ties, shape (p,); areas in [mm²]."""
        ...

    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: Thresholds) -> int:
        """Score of one combination, straight from its definition.

        Parameters
        ----------
        matrix
            With one candidate of each light.
        weights
            From :meth:`weights`.
        thresholds
            Which levels are usable.
        """
        ...

    def scores(
        self,
        matrix: LuminanceMatrix,
        weights: Int64,
        thresholds: Thresholds,
        *,
        threads: int,
        progress: Share | None = None,
    ) -> Int64:
        """Scores of all combinations, exact: one number each, the last light's candidates varying fastest.

        Parameters
        ----------
        matrix
            With all candidates.
        weights, thresholds
            As in :meth:`score`.
        threads
            Number of threads; the scores do not depend on it.
        progress
            Called often from the calling thread with the share that is done; an exception that it raises ends the work
            soon.
        """
        ...

    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: Thresholds) -> int:
        """A score that no combination exceeds; parameters as in :meth:`scores`."""
        ...

    def details(self, matrices: Sequence[LuminanceMatrix], weights: Sequence[Int64]) -> Mapping[str, Any]:
        """What else there is to say of one combination, as JSON; nothing for most objectives.

        Parameters
        ----------
        matrices
            With one candidate of each light; one per posture.
        weights
            From :meth:`weights`, of each.
        """
        ...
