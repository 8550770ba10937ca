"""Objective ``detectability``: the share of the catalogue's defects that the inspection is expected to find.

With the defects t of the part's catalogue (:mod:`lightopt.design.responses._pairs`), u(p, t) the units of
evidence that all images together give of t on patch p, and n the units that it needs to count as found
(:mod:`lightopt.design.responses._evidence`),

    score = Σ_p area(p) · Σ_t weight(t) · [u(p, t) ≥ n],

areas in whole square micrometres. Divided by the inspectable area and the sum of the weights it is the share of the
defects that are found, with each kind of the catalogue as likely as another, and each place. Units change a few times
along the candidates of a light: the scores of all combinations come from these changes, or where they are many from
plain sums.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Float64, Int64
from lightopt.core.errors import counted
from lightopt.core.run_context import Share
from lightopt.defects import DEFAULT_FALSE_ALARMS
from lightopt.design.objectives._objective import Objective, area_text, inspectable_surface
from lightopt.design.objectives._scores_by_units import combination_sums
from lightopt.design.responses._evidence import units_needed
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix, Visibility
from lightopt.design.responses._pairs import PairWeights, PlannedDefect, unpack_flags

# what the number is, beside it in result.json
SCORE_IS = (
    "sum over patches and defects that are found of area [µm²] × weight of the defect; where all are found it is "
    "area_um2 × weight_of_all_defects"
)


def finding_text(min_images: int, false_alarms: float) -> str:
    """What a share of defects says, in words that follow its figure."""
    return (
        f"of the catalogue's defects, all kinds and places of the surface alike, are found at ≤ {false_alarms:g} false "
        f"alarms per posture ({deciding_text(min_images)})"
    )


def deciding_text(min_images: int) -> str:
    return "one image may decide" if min_images == 1 else f"{min_images} images must show each"


@dataclass(frozen=True)
class DetectabilityObjective(Objective):
    defects: tuple[PlannedDefect, ...]
    min_images: int = 1  # images that must show a defect
    false_alarms: float = DEFAULT_FALSE_ALARMS  # of the inspection, in a posture of a good part
    across_postures: bool = False  # whether other postures' images count; with too few lights a posture scores 0
    name: str = "detectability"
    unit: str = "µm² × weight of the defects"
    share_of: str | None = f"{inspectable_surface(edges=False)}, × defects by weight"
    area: int | None = None  # that a score is a share of [µm²]; None for the inspectable area

    @property
    def meaning(self) -> str:
        return finding_text(self.min_images, self.false_alarms)

    @property
    def needed(self) -> int:
        return units_needed(self.min_images)

    @property
    def total_weight(self) -> int:
        return sum(defect.weight for defect in self.defects)

    def format_score(self, score: int, grain: float) -> str:
        """In mm², of the mean defect."""
        return area_text(score / self.total_weight, grain)

    def full_score(self, area: int) -> int | None:
        return (area if self.area is None else self.area) * self.total_weight

    def refusal(self, lights: int) -> str | None:
        """There are no more images than lights, unless other postures add images."""
        if lights >= self.min_images or self.across_postures:
            return None
        number = f"{self.min_images} images, and the rig has {counted(lights, 'light')} only"
        return f"objective detectability requires each defect to be seen in {number}; lower option 'min_images'"

    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        # with one position of each light, all that could be seen is
        return self.bound(matrix, weights, thresholds)

    def scores(
        self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds, threads: int, progress: Share | None
    ) -> Int64:
        """By the places where units change, or by plain sums."""
        del thresholds
        visibility = _visibility(matrix)
        masks, factors = visibility.planes
        pairs = PairWeights(areas=weights, masks=masks, factors=factors)
        words, needed = visibility.counted, self.needed
        return combination_sums(words, pairs, needed, benefit=False, threads=threads, progress=progress)[0]

    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """What would be found if each light stood where it shows each defect best."""
        del thresholds
        visibility = _visibility(matrix)
        return int(weights @ visibility.weights(visibility.most_units(self.needed)[-1]))

    def details(self, matrices: Sequence[LuminanceMatrix], weights: Sequence[Int64]) -> Mapping[str, Any]:
        """Share of each kind of defect that is found, the worst kind, and the worst orientation of long defects."""
        found = np.zeros(len(self.defects), np.int64)
        for matrix, own in zip(matrices, weights, strict=True):
            # of one position of each light: which defects all images together find, shape (p, t)
            units = _visibility(matrix).most_units(self.needed)[-1]
            found += own @ (unpack_flags(units, len(self.defects)) > 0)
        return self.facts(found, sum(int(own.sum()) for own in weights))

    def facts(self, found_areas: Int64, area: int) -> Mapping[str, Any]:
        """The same for areas on which each defect is found, shape (t,), as shares of an area [µm²]."""
        found = found_areas / max(1, area)
        kinds = self._mean_shares([defect.name for defect in self.defects], found)
        facts: dict[str, Any] = {
            "score_is": SCORE_IS,
            "area_um2": area,
            "weight_of_all_defects": self.total_weight,
            "min_images": self.min_images,
            "defects": kinds,
            "worst_defect": min(kinds, key=lambda name: kinds[name]),
        }
        turned = [k for k, defect in enumerate(self.defects) if defect.turn is not None]
        if turned:
            angles = [f"{round(math.degrees(self.defects[k].turn or 0.0), 6):g}" for k in turned]
            facts["directions_deg"] = around = self._mean_shares(angles, found[turned])
            facts["worst_direction_deg"] = float(min(around, key=lambda name: around[name]))
        return facts

    def _mean_shares(self, names: Sequence[str], shares: Float64) -> dict[str, float]:
        # mean over the hypotheses of a name, in the order of the names
        return {
            name: round(float(np.mean([x for n, x in zip(names, shares, strict=True) if n == name])), 6)
            for name in dict.fromkeys(names)
        }


def _visibility(matrix: LuminanceMatrix) -> Visibility:
    assert matrix.visibility is not None
    return matrix.visibility
