"""What an objective has to offer, so that the search can find its optimum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.optimize._matrix import Levels, Thresholds

__all__ = ["Objective"]

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


class Objective(Protocol):
    """A score of a combination of light positions, in whole numbers; larger is better, 0 is nothing gained.

    Attributes
    ----------
    name
        As on the command line.
    unit
        What one unit of the score is.
    """

    @property
    def name(self) -> str: ...

    @property
    def unit(self) -> str: ...

    def refusal(self, lights: int) -> str | None:
        """Why the objective says nothing of this number of lights; None where it does."""
        ...

    def weights(self, areas: Float64) -> Int64:
        """How much each patch counts in the score and in its ties, shape (p,); areas in [mm²]."""
        ...

    def score(self, levels: Levels, weights: Int64, thresholds: Thresholds) -> int:
        """Score of one combination, straight from its definition.

        Parameters
        ----------
        levels
            Delivered levels of the patches under each light, shape (lights, p).
        weights
            From :meth:`weights`.
        thresholds
            Which levels are usable.
        """
        ...

    def scores(
        self, levels: Sequence[Levels], weights: Int64, thresholds: Thresholds, *, threads: int
    ) -> Int64:
        """Scores of all combinations, exact; one axis per light, as long as the light has candidates.

        Parameters as in :meth:`score`, with one array of shape (candidates, p) per light.
        """
        ...

    def bound(self, levels: Sequence[Levels], weights: Int64, thresholds: Thresholds) -> int:
        """A score that no combination exceeds; parameters as in :meth:`scores`."""
        ...
