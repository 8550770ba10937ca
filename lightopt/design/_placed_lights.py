"""Exposures, tolerances and commands for lights and postures that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from lightopt.config import RigConfig
from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design._commands import Command, plan_commands, render_words
from lightopt.design._options import DEFECT_OBJECTIVE, OptimizeOptions, PlanOptions
from lightopt.design._previous_result import PLANNED_PART_NAME, RIG_NAME
from lightopt.design._result import SetResult, ToleranceResult, angles_of
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.exposures._plan_exposures import plan_exposures
from lightopt.design.exposures._selection import Brackets
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.tolerances._analysis import Tolerances, analyse_tolerances
from lightopt.design.tolerances._misaligned_scores import ObjectiveAssessment, PairAssessment, Setup
from lightopt.images import posture_folder

Angles = tuple[tuple[float, float], ...]  # elevation and azimuth of each light [°]


@dataclass(frozen=True, eq=False)
class PlacedLights:
    """A rig's lights at their best positions in each posture."""

    rig: RigConfig
    options: OptimizeOptions
    angles: Mapping[Posture, Angles]

    @staticmethod
    def of(
        rig: RigConfig, options: OptimizeOptions, results: Sequence[SetResult], candidates: Candidates
    ) -> PlacedLights:
        """At the positions that are best for the first objective."""
        angles = {
            posture: angles_of(candidates, result.answers[0].found.best)
            for result in results
            for posture in result.postures
        }
        return PlacedLights(rig, options, angles)

    def setup(self, brackets: Brackets | None, postures: Sequence[Posture] | None = None) -> Setup:
        """These lights in some of the postures, all by default, with the planned exposures."""
        postures = tuple(self.angles if postures is None else postures)
        return Setup(
            rig=self.rig,
            postures=postures,
            angles=tuple(self.angles[posture] for posture in postures),
            exposures=tuple(brackets.of(posture) if brackets else (1.0,) for posture in postures),
            points=self.options.points,
        )

    def exposures(self, evaluator: ImageEvaluator, plan: PlanOptions, run: RunContext) -> Brackets:
        """Further exposures that add enough."""
        postures = tuple(self.angles)
        setup = self.setup(None)
        lights = range(len(self.rig.lights))
        return plan_exposures(
            evaluator,
            postures,
            [[setup.panel(i, light, (0.0, 0.0)) for light in lights] for i in range(len(postures))],
            plan.exposures,
            min_images=self.options.min_images,
            gain_points=plan.exposure_gain,
            target=plan.target,
            progress=run.stage("exposures"),
        )

    def tolerances(
        self,
        evaluator: ImageEvaluator,
        tolerances: Tolerances,
        brackets: Brackets | None,
        objective: Objective,
        thresholds: LevelThresholds,
        run: RunContext,
    ) -> tuple[ToleranceResult, ...]:
        """How far the objective's score falls, in each posture and in all together."""
        drawn = replace(evaluator, table=drawn_patches(evaluator.table, DRAWN_PATCHES))
        postures = tuple(self.angles)
        # one posture alone shows nothing where it has fewer lights than images that must show a defect
        single = len(self.rig.lights) >= self.options.min_images or len(postures) == 1
        groups = [(posture,) for posture in postures if single] + ([postures] if len(postures) > 1 else [])
        return tuple(
            ToleranceResult(
                postures=group,
                robustness=analyse_tolerances(
                    self._assessment(drawn, self.setup(brackets, group), objective, thresholds),
                    [light.name for light in self.rig.lights],
                    tolerances,
                    progress=run.stage(f"tolerances, {', '.join(map(str, group))}"),
                ),
                unit=objective.unit,
                patches=len(drawn.patches),
                grain=drawn.table.grain,
            )
            for group in groups
        )

    def _assessment(
        self, drawn: ImageEvaluator, setup: Setup, objective: Objective, thresholds: LevelThresholds
    ) -> PairAssessment | ObjectiveAssessment:
        if objective.name == DEFECT_OBJECTIVE:
            return PairAssessment(drawn, setup, min_images=self.options.min_images)
        # an objective of levels knows exposure 1 only
        return ObjectiveAssessment(
            replace(drawn, detection=None),
            replace(setup, exposures=((1.0,),) * len(setup.postures)),
            objective=objective,
            thresholds=thresholds,
        )

    def commands(self, brackets: Brackets | None) -> tuple[Command, ...]:
        """Commands that capture and render the plan."""
        # as the rig files are written: one where all postures have the same lights
        one_rig = len(set(self.angles.values())) == 1
        files = {posture: RIG_NAME if one_rig else f"{posture_folder(posture)}/{RIG_NAME}" for posture in self.angles}
        return plan_commands(self.rig, files, PLANNED_PART_NAME, brackets, render_words(self.options))
