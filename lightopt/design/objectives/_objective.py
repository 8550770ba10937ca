"""The interface of an objective to the search, and the printed form of its scores."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from lightopt.core.arrays import Float64, Int64
from lightopt.core.errors import percent
from lightopt.core.run_context import Share
from lightopt.design.responses._luminance_matrix import AREA_UNIT_MM2, LevelThresholds, LuminanceMatrix, area_units
from lightopt.rendering import GRAZING_DEG


def inspectable_surface(*, edges: bool) -> str:
    """What shares of area are shares of; for defects `edges` of the part do not belong to it."""
    off = "" if edges else ", off silhouettes and creases"
    return (
        f"the surface that the camera sees in the posture at up to {GRAZING_DEG:g}° to its normal{off}; of several "
        "postures, added up"
    )


# how near to the best a score is near [thousandths of the inspectable area, where a score is an area; else of the best
# score]: half a point, less than what placement and reflectance are known to
NEAR_PER_MILLE = 5


def area_text(area: float, grain: float) -> str:
    """An area [µm²] in mm², to the digit that its grain supports, hundredths at most.

    The grain is how far the area may be off since each patch counts as its middle does [µm²].

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

    The grain is how far the share may be off since each patch counts as its middle does; `short_of` is as for
    :func:`lightopt.core.errors.percent`.

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


class Objective(ABC):
    """A score of a combination of light positions, in whole numbers; larger is better, 0 is nothing gained."""

    name: str  # as on the command line
    unit: str  # of one unit of the score
    share_of: str | None  # what a score is a share of, in words; None where it is no area

    @property
    @abstractmethod
    def meaning(self) -> str:
        """What a score says, in words that follow its figure."""

    def format_score(self, score: int, grain: float) -> str:
        """A score, or a difference of two, for people, with its unit; areas to the digits of their grain [µm²]."""
        return area_text(score, grain)

    def full_score(self, area: int) -> int | None:
        """The score of a fully covered inspectable area [µm²]; None where a score is no area."""
        return area

    def share_of_whole(self, score: int, area: int) -> float | None:
        """A score as a share of the inspectable area [µm²]; None where it is no area."""
        whole = self.full_score(area)
        return None if whole is None else score / max(1, whole)

    def near_margin(self, best: int, area: int) -> int:
        """How far a score may be below the best one and still be near it: see :data:`NEAR_PER_MILLE`."""
        whole = self.full_score(area)
        return NEAR_PER_MILLE * (best if whole is None else whole) // 1000

    def weights(self, areas: Float64) -> Int64:
        """How much each patch counts in the score and in its ties, shape (p,); areas in [mm²]."""
        return area_units(areas)

    def details(self, matrices: Sequence[LuminanceMatrix], weights: Sequence[Int64]) -> Mapping[str, Any]:
        """Further facts on one combination, as JSON; nothing for most objectives.

        `matrices` have one candidate of each light; one matrix and one array of weights per posture.
        """
        del matrices, weights
        return {}

    @abstractmethod
    def refusal(self, lights: int) -> str | None:
        """Why the objective is undefined for this number of lights; None where it is defined."""

    @abstractmethod
    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """Score of one combination, directly from its definition; `matrix` has one candidate of each light."""

    @abstractmethod
    def scores(
        self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds, threads: int, progress: Share | None
    ) -> Int64:
        """Scores of all combinations, exact: one number each, the last light's candidates varying fastest.

        `progress` is called often, from the calling thread; an exception that it raises ends the work soon.
        """

    @abstractmethod
    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """A score that no combination exceeds."""


def shares_of(objectives: Sequence[Objective]) -> dict[str, list[str]]:
    """Names of the objectives whose scores are shares, by the surface that they are shares of."""
    names: dict[str, list[str]] = {}
    for objective in objectives:
        if objective.share_of is not None:
            names.setdefault(objective.share_of, []).append(objective.name)
    return names


def near_meaning(objectives: Sequence[Objective]) -> str:
    within = f"{NEAR_PER_MILLE / 10:g}"
    texts = [
        f"within {within} points of the share of {' and '.join(names)}"
        if points
        else f"within {within} % of the best score of {' and '.join(names)}"
        for points in (True, False)
        if (names := [one.name for one in objectives if (one.share_of is not None) == points])
    ]
    return f"near best: other combinations {', '.join(texts)}, ties among them"
