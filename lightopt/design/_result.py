"""The best light positions of each posture, for each objective."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lightopt.core.transforms import Posture
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import Levels
from lightopt.design.search._curves import Curve
from lightopt.design.search._exact_search import SearchResult
from lightopt.design.search._ranking import Ranked


@dataclass(frozen=True, kw_only=True)
class ObjectiveResult:
    """The best set of light positions for an objective.

    found: By the search.
    scores: Of the best set under every objective, by name.
    details: What else the objective says of the best set, as JSON.
    nothing: Why there is no best set: no combination scores at all. None where there is one.
    proven_of: Where the positions were chosen with postures: the set of alternatives that `found` is a proof for;
        others were not counted. None where the search chose them.
    """

    objective: Objective
    found: SearchResult
    scores: Mapping[str, int]
    details: Mapping[str, Any] = field(default_factory=dict[str, Any])
    nothing: str | None = None
    proven_of: str | None = None


@dataclass(frozen=True, kw_only=True)
class SetResult:
    """The results for postures that share their light positions.

    postures: One, or all of them where the lights stand the same for all.
    patches, area: Number and area [µm²] of inspectable patches, summed over the postures.
    grazing_area: That the camera sees at a grazing angle, summed over the postures [µm²]: left out of scores and
        shares.
    grain: How far shares of the area may be off since each patch counts as its middle does, 0 to 1.
    answers: One per objective.
    levels: Of the best set of the first objective, for each posture: delivered levels of its visible patches under
        each light, shape (lights, p).
    curves: The first objective's score against one angle; none where nothing scores.
    """

    postures: tuple[Posture, ...]
    patches: int
    area: int
    grazing_area: int
    grain: float
    answers: tuple[ObjectiveResult, ...]
    levels: tuple[Levels, ...]
    curves: tuple[Curve, ...]

    @property
    def left_out(self) -> float:
        """Of the surface that the camera sees, the share that it sees at a grazing angle."""
        return self.grazing_area / max(1, self.area + self.grazing_area)


def angles_of(candidates: Candidates, ranked: Ranked) -> tuple[tuple[float, float], ...]:
    """Elevation and azimuth of each light in a combination [°]."""
    return tuple(angles[k] for angles, k in zip(candidates.angles, ranked.candidates, strict=True))
