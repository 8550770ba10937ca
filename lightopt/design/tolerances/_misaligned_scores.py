"""Scores of a plan whose lights or part are misaligned: exact evaluations, image by image.

Each image is computed once: of a posture, with the part off by so much, under one light that is off by so much. The
scores of all combinations are composed of them.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from lightopt.config import RigConfig
from lightopt.core.arrays import Int64, UInt64
from lightopt.core.threads import available_processors
from lightopt.core.transforms import Posture
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._combinations import combination_sums
from lightopt.design.postures._counts import add_counts, counts_of_images, zero_counts
from lightopt.design.postures._image_evaluator import ImageEvaluator, scattered_flags
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix
from lightopt.design.tolerances._analysis import Offset
from lightopt.geometry import face_normals
from lightopt.rendering import PatchTable, camera_visibility
from lightopt.scene import PanelLight, build_lights, view_from_part

EXACT: Offset = (0.0, 0.0)

ImageKey = tuple[int, Offset, int, Offset]  # a posture, the offset of the part, a light, and its offset


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Postures that are judged together, and the positions of the lights in them.

    angles: Elevation and azimuth of each light, posture by posture [°].
    exposures: Posture by posture, 1 among them.
    points: Point lights per panel, instead of the rig's.
    """

    rig: RigConfig
    postures: tuple[Posture, ...]
    angles: tuple[tuple[tuple[float, float], ...], ...]
    exposures: tuple[tuple[float, ...], ...]
    points: int | Literal["auto"] | None = None

    def panel(self, posture: int, light: int, offset: Offset) -> PanelLight:
        """A light that is off by so much, world frame."""
        elevation, azimuth = self.angles[posture][light]
        config = self.rig.lights[light].model_copy(
            update={"elevation_deg": elevation + offset[0], "azimuth_deg": azimuth + offset[1]}
        )
        return build_lights(self.rig.model_copy(update={"lights": (config,)}), None, self.points)[0]

    def misaligned_posture(self, posture: int, pose: Offset) -> Posture:
        """The posture of a part that is off by so much."""
        there = self.postures[posture]
        return Posture(there.elevation_deg + pose[0], there.rotation_deg + pose[1])


class _Assessment(ABC):
    """Scores of combinations of offsets, from images that are computed once: a `ScoreFunction`.

    The patches of the evaluator stay the same; which of them are visible does not.
    """

    def __init__(self, evaluator: ImageEvaluator, setup: Setup) -> None:
        self.evaluator, self.setup = evaluator, setup
        self.patches = evaluator.patches
        self.images: dict[ImageKey, Any] = {}
        self._facets = face_normals(evaluator.scene.mesh)[evaluator.table.patches.face[self.patches]]

    def __call__(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        # images of other poses than this one and the exact one are not needed again
        self.images = {key: image for key, image in self.images.items() if key[1] in (pose, EXACT)}
        for posture in range(len(self.setup.postures)):
            self._compute_images(posture, pose, lights)
        return self.scores(pose, lights)

    @abstractmethod
    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """Scores of all combinations, the last light's offsets varying fastest."""

    @abstractmethod
    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """What is stored of an image: row `at` of a light, in matrices of all exposures."""

    def _compute_images(self, posture: int, pose: Offset, lights: Sequence[Sequence[Offset]]) -> None:
        # the images that are not known yet, those of all lights in one go
        missing = [
            [offset for offset in offsets if (posture, pose, light, offset) not in self.images]
            for light, offsets in enumerate(lights)
        ]
        if not any(missing):
            return
        there = self.setup.misaligned_posture(posture, pose)
        matrices = replace(self.evaluator, table=self._table(there)).matrices(
            there,
            [[self.setup.panel(posture, light, offset) for offset in offsets] for light, offsets in enumerate(missing)],
            exposures=self.setup.exposures[posture],
        )
        for light, offsets in enumerate(missing):
            for at, offset in enumerate(offsets):
                self.images[posture, pose, light, offset] = self.keep(matrices, light, at)

    def _table(self, posture: Posture) -> PatchTable:
        table = self.evaluator.table
        visible, grazing = np.zeros((2, 1, len(table.patches)), np.bool_)
        visible[0, self.patches], grazing[0, self.patches] = camera_visibility(
            table.patches.centroids[self.patches],
            table.patches.normals[self.patches],
            self._facets,
            view_from_part(self.evaluator.scene, posture),
            self.evaluator.caster,
        )
        return replace(table, postures=(posture,), visible=visible, grazing=grazing)


class PairAssessment(_Assessment):
    """Weight of the pairs of patch and defect that all postures together show in `min_images` images or more."""

    def __init__(self, evaluator: ImageEvaluator, setup: Setup, *, min_images: int) -> None:
        super().__init__(evaluator, setup)
        self._seen_in = min_images
        self._weights = evaluator.weights

    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """One image, whatever the number of its exposures."""
        return counts_of_images([scattered_flags(matrices, self.patches, light=light, place=at)], self._seen_in)

    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """Add up the postures, then all combinations of the lights."""
        totals: list[UInt64] = []
        for light, offsets in enumerate(lights):
            total = np.stack([zero_counts(self._weights, self._seen_in)] * len(offsets))
            for at, offset in enumerate(offsets):
                for posture in range(len(self.setup.postures)):
                    total[at] = add_counts(total[at], self.images[posture, pose, light, offset])
            totals.append(total)
        return combination_sums(totals, self._weights, threads=self.evaluator.threads)[0]


class ObjectiveAssessment(_Assessment):
    """Score of an objective of levels at exposure 1, summed over the postures."""

    def __init__(
        self, evaluator: ImageEvaluator, setup: Setup, *, objective: Objective, thresholds: LevelThresholds
    ) -> None:
        super().__init__(evaluator, setup)
        self._objective, self._thresholds = objective, thresholds

    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """Levels, and the areas of their patches."""
        return matrices[0].levels[light][at], matrices[0].areas

    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """All combinations by the objective's own search."""
        total = np.zeros(int(np.prod([len(offsets) for offsets in lights])), np.int64)
        for posture in range(len(self.setup.postures)):
            images = [
                [self.images[posture, pose, light, offset] for offset in offsets]
                for light, offsets in enumerate(lights)
            ]
            matrix = LuminanceMatrix(
                levels=tuple(np.stack([levels for levels, _ in some]) for some in images), areas=images[0][0][1]
            )
            total += self._objective.scores(
                matrix,
                self._objective.weights(matrix.areas),
                self._thresholds,
                threads=self.evaluator.threads or available_processors(),
            )
        return total
