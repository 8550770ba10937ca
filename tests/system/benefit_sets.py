"""The best lights for detectability against the best for paper, in a part's first posture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from benefit_views import Looked, Row, finished, look_at, places_text
from numpy.typing import NDArray
from truth import FINISHES, SEEN_IN

from lightopt import build_scene
from lightopt.config import PartConfig, RigConfig
from lightopt.design import (
    OBJECTIVES,
    DetectabilityObjective,
    LevelThresholds,
    area_units,
    find_candidates,
    luminance_matrix,
    search,
)

__all__ = ["DEFECTS", "STEP", "sets"]

FREE = ("spout",)
FREE_AZIMUTH, FREE_STEP = 45.0, 15.0
"""To each side [°], and the step then."""

STEP = 5.0
"""Of the lights' angles otherwise [°]."""

DEFECTS = 210


def sets(
    rig: RigConfig, part: PartConfig, *, patches: int, defects: int = DEFECTS, step: float = STEP
) -> Iterator[Row]:
    """The best lights for detectability and for paper, in the part's first posture."""
    scene = build_scene(rig, part, defects=False)
    scene = replace(scene, postures=scene.postures[:1])
    examined = look_at(rig, part, scene, patches=patches, defects=defects)
    for finish in FINISHES:
        yield from _best_sets(finished(examined, finish), rig, part, finish, step)
    if part.name in FREE:
        free = rig.model_copy(
            update={
                "lights": tuple(
                    light.model_copy(
                        update={
                            "azimuth_range_deg": (light.azimuth_deg - FREE_AZIMUTH, light.azimuth_deg + FREE_AZIMUTH)
                        }
                    )
                    for light in rig.lights
                )
            }
        )
        yield from _best_sets(finished(examined, "glossy"), free, part, "glossy, free azimuths", FREE_STEP)


def _best_sets(examined: Looked, rig: RigConfig, part: PartConfig, finish: str, step: float) -> Iterator[Row]:
    evaluator = examined.evaluator
    scene, posture = evaluator.scene, evaluator.scene.postures[0]
    candidates = find_candidates(rig, step_deg=step, scene=scene)
    matrix = luminance_matrix(
        scene, evaluator.table, posture, candidates.panels, caster=evaluator.caster, detection=evaluator.detection
    )
    thresholds = LevelThresholds.of_sensor(scene.sensor, shade_share=10 / 255)
    weights = area_units(matrix.areas)
    paper = search([matrix], OBJECTIVES["paper"], thresholds, space=candidates.space, keep=1).best.candidates
    seen: dict[tuple[int, ...], tuple[NDArray[np.int64], NDArray[np.int64]]] = {}
    for min_images in SEEN_IN:
        goal = DetectabilityObjective(examined.trials, min_images)
        own = search([matrix], goal, thresholds, space=candidates.space, keep=1).best.candidates
        for what, places in (("detectability", own), ("paper", paper)):
            score = goal.score(matrix.combination(places), weights, thresholds)
            panels = candidates.panels_at(places)
            if places not in seen:
                seen[places] = examined.seen([posture], panels, [(1.0,)])
            said, found = seen[places]
            yield Row(
                part=part.name, finish=finish, min_images=min_images, what=what, lights=places_text(panels),
                share=score / (int(weights.sum()) * goal.total_weight), defects=len(examined.defects),
                predicted=int((said >= min_images).sum()), counted=int((found >= min_images).sum()),
            )  # fmt: skip
