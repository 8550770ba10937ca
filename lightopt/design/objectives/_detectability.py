"""Objective ``detectability``: the planned defects that enough images show.

With the hypotheses t of the part's catalogue (:mod:`lightopt.design.responses._defect_hypotheses`), n(p, t) the number
of images in which t is visible on patch p (:mod:`lightopt.design.responses._detection`), and k from `min_images`,

    score = Σ_p area(p) · Σ_t weight(t) · [n(p, t) ≥ k],

areas in whole square micrometres. Divided by the visible area and the sum of the weights it is the share of (patch,
defect) pairs that are seen. The bits change a few times along the candidates of a light: the scores of
all combinations come from these changes, or where they are many from packed bits.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lightopt.core.arrays import Bool, Float64, Int64
from lightopt.core.errors import InputError, counted
from lightopt.core.run_context import Share, part_of
from lightopt.core.threads import blocks
from lightopt.design.objectives._objective import INSPECTABLE_SURFACE, Objective, area_text
from lightopt.design.objectives._scores_by_image_counts import at_least, count_run_sums
from lightopt.design.objectives._scores_by_packed_bits import bit_scores
from lightopt.design.responses._defect_hypotheses import DefectHypothesis
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix, Visibility
from lightopt.design.responses._packed_bits import Words, unpack_flags

FLAG_BYTES = 1 << 27  # of the flags that the packed bits are given at once


# what the number is, beside it in result.json
SCORE_IS = (
    "sum over patches and defects that are seen of area [µm²] × weight of the defect; where all are seen it is "
    "area_um2 × weight_of_all_defects"
)


def min_images_problem(min_images: int) -> str | None:
    """What is wrong with a number of images that must show a defect; None where nothing is."""
    if min_images >= 1:
        return None
    return f"option 'min_images': expected the number of images that must show a defect, 1 or more, found {min_images}"


@dataclass(frozen=True)
class DetectabilityObjective(Objective):
    """Defects that enough images show; see the module's text.

    min_images: Images that must show a defect.
    across_postures: Whether images of other postures count, so that a posture may have fewer lights than that; the
        score of its own images is then 0.
    """

    hypotheses: tuple[DefectHypothesis, ...]
    min_images: int = 1
    across_postures: bool = False
    name: str = "detectability"
    unit: str = "µm² × weight of the defects"
    share_of: str | None = f"{INSPECTABLE_SURFACE}, × defects by weight"

    def __post_init__(self) -> None:
        if problem := min_images_problem(self.min_images):
            raise InputError(problem)

    @property
    def meaning(self) -> str:
        # a defect may be found by any of its walls
        return (
            f"of the walls of the catalogue's defects, at every place of the surface, are visible in "
            f"{counted(self.min_images, 'image')} or more; it is not a share of whole defects"
        )

    @property
    def total_weight(self) -> int:
        return sum(hypothesis.weight for hypothesis in self.hypotheses)

    def format_score(self, score: int, grain: float) -> str:
        """In mm², of the mean defect."""
        return area_text(score / self.total_weight, grain)

    def full_score(self, area: int) -> int | None:
        return area * self.total_weight

    def refusal(self, lights: int) -> str | None:
        """There are no more images than lights, unless other postures add images."""
        if lights >= self.min_images or self.across_postures:
            return None
        return (
            f"objective detectability requires each defect to be seen in {self.min_images} images, and the rig has "
            f"{counted(lights, 'light')} only; lower option 'min_images'"
        )

    def score(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        # with one position of each light, all that could be seen is
        return self.bound(matrix, weights, thresholds)

    def scores(
        self,
        matrix: LuminanceMatrix,
        weights: Int64,
        thresholds: LevelThresholds,
        *,
        threads: int,
        progress: Share | None = None,
    ) -> Int64:
        """By the places where bits change, or by packed bits."""
        del thresholds
        visibility = _visibility(matrix)
        (table,), left = count_run_sums(
            [layer[:, None] for layer in visibility.words],
            weights,
            visibility.planes,
            at_least(self.min_images)[None],
            threads=threads,
            progress=part_of(progress, 0.0, 0.9),
        )
        if left.any():
            table += self._by_bits(
                visibility.words, np.flatnonzero(left), weights, threads, part_of(progress, 0.9, 1.0)
            )
        return table

    def _by_bits(
        self, words: Sequence[Words], some: Int64, weights: Int64, threads: int, progress: Share | None
    ) -> Int64:
        # each (patch, hypothesis) as a patch of its own, usable where it is visible and never saturated
        table = np.zeros(math.prod(len(layer) for layer in words), np.int64)
        positions, count = sum(len(layer) for layer in words), len(self.hypotheses)
        parts = list(blocks(len(some), max(1, FLAG_BYTES // (positions * count))))
        for number, (start, end) in enumerate(parts):
            chosen = some[start:end]
            table += bit_scores(
                [unpack_flags(layer[:, chosen], count).reshape(len(layer), -1) for layer in words],
                np.arange(len(chosen) * count),
                np.outer(weights[chosen], self._hypothesis_weights()).ravel(),
                LevelThresholds(shade=1, saturation=2),
                rule=(self.min_images, len(words)),
                threads=threads,
                progress=part_of(progress, number / len(parts), (number + 1) / len(parts)),
            )
        return table

    def bound(self, matrix: LuminanceMatrix, weights: Int64, thresholds: LevelThresholds) -> int:
        """What could be seen if each light stood where it shows each defect best."""
        del thresholds
        visibility = _visibility(matrix)
        return int(weights @ visibility.weights(visibility.reachable(self.min_images)))

    def details(self, matrices: Sequence[LuminanceMatrix], weights: Sequence[Int64]) -> Mapping[str, Any]:
        """Share of the area on which each kind of defect is seen, the worst kind, and the worst direction of walls."""
        area = sum(int(own.sum()) for own in weights)
        seen = sum(
            (own @ self._seen(_visibility(matrix)) for matrix, own in zip(matrices, weights, strict=True)),
            start=np.zeros(len(self.hypotheses), np.int64),
        )
        return self.facts(seen, area)

    def facts(self, seen_areas: Int64, area: int) -> Mapping[str, Any]:
        """The same for areas on which each hypothesis is seen, shape (t,), as shares of an area [µm²]."""
        seen = seen_areas / max(1, area)
        kinds = self._mean_shares([hypothesis.name for hypothesis in self.hypotheses], seen)
        facts: dict[str, Any] = {
            "score_is": SCORE_IS,
            "area_um2": area,
            "weight_of_all_defects": self.total_weight,
            "min_images": self.min_images,
            "defects": kinds,
            "worst_defect": min(kinds, key=lambda name: kinds[name]),
        }
        leaning = [k for k, hypothesis in enumerate(self.hypotheses) if hypothesis.slope > 0.0]
        if leaning:
            around = self._mean_shares(
                [f"{round(math.degrees(self.hypotheses[k].direction), 6):g}" for k in leaning], seen[leaning]
            )
            worst = min(around, key=lambda name: around[name])
            facts["directions_deg"] = around
            facts["worst_direction_deg"] = float(worst)
        return facts

    def _seen(self, visibility: Visibility) -> Bool:
        # for one position of each light: which hypotheses enough images show, shape (p, t)
        count = len(self.hypotheses)
        images = sum((unpack_flags(layer[0], count) for layer in visibility.words), start=np.uint8(0))
        return np.asarray(images >= self.min_images)

    def _hypothesis_weights(self) -> Int64:
        return np.array([hypothesis.weight for hypothesis in self.hypotheses], np.int64)

    def _mean_shares(self, names: Sequence[str], shares: Float64) -> dict[str, float]:
        # mean over the hypotheses of a name, in the order of the names
        return {
            name: round(float(np.mean([x for n, x in zip(names, shares, strict=True) if n == name])), 6)
            for name in dict.fromkeys(names)
        }


def _visibility(matrix: LuminanceMatrix) -> Visibility:
    if matrix.visibility is None:
        raise InputError(
            "objective detectability: expected a luminance matrix with the visibility of the defects, found levels "
            "alone"
        )
    return matrix.visibility
