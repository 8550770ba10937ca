"""Scores of a plan whose lights or part are off: exact evaluations, image by image.

Each image is worked out once: of a posture, with the part off by so much, under one light that is off by so much. The
scores of all combinations are put together from them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lightopt.config import RigConfig
from lightopt.core.threads import available_processors
from lightopt.core.transforms import Posture
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._combinations import combination_sums
from lightopt.design.postures._counts import added, counts_of_images, no_counts
from lightopt.design.postures._pair_visibility import Survey, scattered_flags
from lightopt.design.responses._luminance_matrix import LuminanceMatrix, Thresholds
from lightopt.design.tolerances._tolerances import Offset
from lightopt.geometry import face_normals
from lightopt.rendering import PatchTable, sight_of
from lightopt.scene import PanelLight, build_lights, view_from_part

Int64 = NDArray[np.int64]

EXACT: Offset = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """Postures that are judged together, and where the lights stand in them.

    Attributes
    ----------
    rig
        Whose lights they are.
    postures
        One or more.
    angles
        Elevation and azimuth of each light, posture by posture [°].
    exposures
        Posture by posture, 1 among them.
    points
        Point lights per panel, instead of the rig's.
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

    def off(self, posture: int, pose: Offset) -> Posture:
        """How the part lies where it is off by so much."""
        there = self.postures[posture]
        return Posture(there.elevation_deg + pose[0], there.rotation_deg + pose[1])


@dataclass(frozen=True, kw_only=True)
class _Image:
    """Which posture, how far the part is off, which light, how far that is off."""

    posture: int
    pose: Offset
    light: int
    offset: Offset


class _Assessment(ABC):
    """Scores of combinations of offsets, from images that are worked out once; see :class:`lightopt.design.Assess`.

    Parameters
    ----------
    survey
        The part; its patches stay the same, those in view do not.
    setup
        Postures and lights.
    """

    def __init__(self, survey: Survey, setup: Setup) -> None:
        self.survey, self.setup = survey, setup
        self.patches = survey.patches
        self.kept: dict[_Image, Any] = {}
        self._facets = face_normals(survey.scene.mesh)[survey.table.patches.face[self.patches]]

    def __call__(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        # images of other poses than this one and the exact one are not asked for again
        self.kept = {image: kept for image, kept in self.kept.items() if image.pose in (pose, EXACT)}
        for posture in range(len(self.setup.postures)):
            self._look(posture, pose, lights)
        return self.scores(pose, lights)

    @abstractmethod
    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """Scores of all combinations, the last light's offsets varying fastest."""

    @abstractmethod
    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """What is kept of an image: row `at` of a light, in matrices of all exposures."""

    def _look(self, posture: int, pose: Offset, lights: Sequence[Sequence[Offset]]) -> None:
        # the images that are not known yet, those of all lights in one go
        image = partial(_Image, posture=posture, pose=pose)
        missing = [
            [offset for offset in offsets if image(light=light, offset=offset) not in self.kept]
            for light, offsets in enumerate(lights)
        ]
        if not any(missing):
            return
        there = self.setup.off(posture, pose)
        matrices = replace(self.survey, table=self._table(there)).matrices(
            there,
            [
                [self.setup.panel(posture, light, offset) for offset in offsets]
                for light, offsets in enumerate(missing)
            ],
            exposures=self.setup.exposures[posture],
        )
        for light, offsets in enumerate(missing):
            for at, offset in enumerate(offsets):
                self.kept[image(light=light, offset=offset)] = self.keep(matrices, light, at)

    def _table(self, posture: Posture) -> PatchTable:
        table = self.survey.table
        visible, grazing = np.zeros((2, 1, len(table.patches)), np.bool_)
        visible[0, self.patches], grazing[0, self.patches] = sight_of(
            table.patches.centroids[self.patches],
            table.patches.normals[self.patches],
            self._facets,
            view_from_part(self.survey.scene, posture),
            self.survey.caster,
        )
        return replace(table, postures=(posture,), visible=visible, grazing=grazing)


class PairAssessment(_Assessment):
    """Weight of the pairs of patch and defect that all postures together show in enough images.

    Parameters
    ----------
    survey, setup
        Part, postures and lights.
    least
        Images that must show a pair.
    """

    def __init__(self, survey: Survey, setup: Setup, *, least: int) -> None:
        super().__init__(survey, setup)
        self._least = least
        self._weights = survey.weights

    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """One image, whatever the number of its exposures."""
        return counts_of_images([scattered_flags(matrices, self.patches, light=light, place=at)], self._least)

    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """Add up the postures, then all combinations of the lights."""
        totals: list[NDArray[np.uint64]] = []
        for light, offsets in enumerate(lights):
            total = np.stack([no_counts(self._weights, self._least)] * len(offsets))
            for at, offset in enumerate(offsets):
                for posture in range(len(self.setup.postures)):
                    image = _Image(posture=posture, pose=pose, light=light, offset=offset)
                    total[at] = added(total[at], self.kept[image])
            totals.append(total)
        return combination_sums(totals, self._weights, threads=self.survey.threads)[0]


class ObjectiveAssessment(_Assessment):
    """Score of an objective of levels, summed over the postures.

    Parameters
    ----------
    survey, setup
        Part, postures and lights; exposure 1 counts.
    objective, thresholds
        What is scored, and which levels are usable.
    """

    def __init__(self, survey: Survey, setup: Setup, *, objective: Objective, thresholds: Thresholds) -> None:
        super().__init__(survey, setup)
        self._objective, self._thresholds = objective, thresholds

    def keep(self, matrices: Sequence[LuminanceMatrix], light: int, at: int) -> Any:
        """Levels, and the areas of the patches that they are of."""
        return matrices[0].levels[light][at], matrices[0].areas

    def scores(self, pose: Offset, lights: Sequence[Sequence[Offset]]) -> Int64:
        """All combinations by the objective's own search."""
        total = np.zeros(int(np.prod([len(offsets) for offsets in lights])), np.int64)
        for posture in range(len(self.setup.postures)):
            images = [
                [self.kept[_Image(posture=posture, pose=pose, light=light, offset=o)] for o in offsets]
                for light, offsets in enumerate(lights)
            ]
            matrix = LuminanceMatrix(
                levels=tuple(np.stack([levels for levels, _ in some]) for some in images),
                areas=images[0][0][1],
            )
            total += self._objective.scores(
                matrix,
                self._objective.weights(matrix.areas),
                self._thresholds,
                threads=self.survey.threads or available_processors(),
            )
        return total
