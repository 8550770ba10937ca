"""What an objective has to offer, so that the search can find its optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lightopt.optimize._matrix import LuminanceMatrix, Thresholds
from lightopt.optimize._work import Share

__all__ = ["VISIBLE_SURFACE", "Objective"]

VISIBLE_SURFACE = "the surface that the camera sees in the posture; of several postures, added up"

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
    share_of
        What :meth:`share` gives a share of, in words; None where a score is no area.
    """

    @property
    def name(self) -> str: ...

    @property
    def unit(self) -> str: ...

    @property
    def share_of(self) -> str | None: ...

    def shown(self, score: int) -> str:
        """A score, or a difference of two, for people, with its unit."""
        ...

    def share(self, score: int, area: int) -> float | None:
        """A score as a share of the visible area [µm²]; None where it is no area."""
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
