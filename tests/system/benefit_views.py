"""Defects strewn over a part, and which of them lights, postures and exposures show: predicted and counted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from contrasts import counted, predicted
from numpy.typing import NDArray
from strewn import strew
from touched import Touched, touched
from truth import FINISHES, SEED

from lightopt.config import PartConfig, RigConfig
from lightopt.core.transforms import Posture
from lightopt.defects import PlacedDefect
from lightopt.design import Contrast, DefectHypothesis, DetectionModel, ImageEvaluator, defect_hypotheses
from lightopt.lights import PanelLight
from lightopt.rendering import build_patches, cast_rays_at
from lightopt.scene import Scene, build_catalogue

__all__ = ["Looked", "Row", "finished", "look_at", "places_text"]

THIN_FROM_PX = 12.0
"""Of wider defects every second pixel of every second row is looked at."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """A set of lights, or a plan.

    Attributes
    ----------
    part, finish, min_images
        What was asked.
    what
        Which set or plan.
    lights
        Where they stand.
    share
        Of surface × defects that the objective says is seen.
    defects
        That were strewn.
    predicted, counted
        Of these, how many the objective says are seen, and how many are.
    """

    part: str
    finish: str
    min_images: int
    what: str
    lights: str
    share: float
    defects: int
    predicted: int
    counted: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Looked:
    """A survey, and defects strewn over it."""

    evaluator: ImageEvaluator
    trials: tuple[DefectHypothesis, ...]
    contrast: Contrast
    defects: tuple[PlacedDefect, ...]
    traced: dict[Posture, Touched] = field(default_factory=dict[Posture, Touched])

    def pixels(self, posture: Posture) -> Touched:
        """Of the defects in a posture's image, traced when first asked for."""
        if posture not in self.traced:
            self.traced[posture] = touched(
                self.evaluator.scene,
                posture,
                self.defects,
                caster=self.evaluator.caster,
                patches=self.evaluator.table.patches,
                thin_from_px=THIN_FROM_PX,
            )
        return self.traced[posture]

    def seen(
        self, postures: Sequence[Posture], panels: Sequence[PanelLight], exposures: Sequence[Sequence[float]]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """In how many images each defect is, predicted and counted; exposures of a light are one image."""
        count = len(self.defects)
        scene = replace(self.evaluator.scene, lights=tuple(panels))
        said, found = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for number, (posture, levels) in enumerate(zip(postures, exposures, strict=True)):
            pixels = self.pixels(posture)
            both = pixels.levels(scene, self.evaluator.caster)
            matrices = self.evaluator.matrices(posture, [[panel] for panel in panels], exposures=levels)
            visibility = [matrix.visibility for matrix in matrices if matrix.visibility is not None]
            said += predicted(pixels, visibility, self._first_trials(), count).sum(axis=0)
            images = [
                counted(pixels, both, scene, count, contrast=self.contrast, exposure=level, image=number)
                for level in levels
            ]
            found += np.any(images, axis=0).sum(axis=0)
        return said, found

    def _first_trials(self) -> NDArray[np.intp]:
        names = [trial.name for trial in self.trials]
        # the name of a strewn defect is its entry's and a number
        return np.array([names.index(defect.name.rsplit("-", 1)[0]) for defect in self.defects])


def look_at(rig: RigConfig, part: PartConfig, scene: Scene, *, patches: int, defects: int) -> Looked:
    caster = cast_rays_at(scene)
    trials = defect_hypotheses(build_catalogue(part))
    contrast = Contrast(sensor=scene.sensor, full_scale=scene.reflectance.full_scale)
    evaluator = ImageEvaluator(
        scene=scene,
        table=build_patches(scene, caster=caster, budget=patches),
        caster=caster,
        detection=DetectionModel(hypotheses=trials, contrast=contrast),
    )
    placed = strew(rig, part, scene, count=defects, seed=SEED)
    return Looked(evaluator=evaluator, trials=trials, contrast=contrast, defects=placed)


def finished(examined: Looked, finish: str) -> Looked:
    scene = examined.evaluator.scene
    scene = replace(scene, reflectance=replace(scene.reflectance, **FINISHES[finish]))
    return replace(examined, evaluator=replace(examined.evaluator, scene=scene))


def places_text(panels: Sequence[PanelLight]) -> str:
    angles: list[str] = []
    for panel in panels:
        x, y, z = panel.centre / np.linalg.norm(panel.centre)
        elevation, azimuth = math.degrees(math.asin(z)), math.degrees(math.atan2(y, x)) % 360.0
        angles.append(f"{elevation:.0f}°/{azimuth:.0f}°")
    return ", ".join(angles)
