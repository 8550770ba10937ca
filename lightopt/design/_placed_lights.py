"""Tolerances and commands for lights and postures that were found."""

from collections.abc import Sequence
from dataclasses import replace

from lightopt.config import RigConfig
from lightopt.core.run_context import RunContext
from lightopt.design._candidates import Candidates
from lightopt.design._commands import Command, plan_commands, render_words
from lightopt.design._options import DEFECT_OBJECTIVE, OptimizeOptions
from lightopt.design._previous_result import PLANNED_PART_NAME, RIG_NAME
from lightopt.design._result import SetResult, ToleranceResult, angles_of
from lightopt.design._tolerances import ObjectiveAssessment, PairAssessment, Setup, Tolerances, analyse_tolerances
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._exposures import Brackets
from lightopt.design.responses._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.images import posture_folder


def placed_lights(
    rig: RigConfig, results: Sequence[SetResult], candidates: Candidates, options: OptimizeOptions
) -> Setup:
    """The lights at the positions that are best for the first objective in each posture, at exposure 1."""
    angles = {
        posture: angles_of(candidates, result.answers[0].found.best)
        for result in results
        for posture in result.postures
    }
    return Setup(
        rig=rig,
        postures=tuple(angles),
        angles=tuple(angles.values()),
        exposures=((1.0,),) * len(angles),
        points=options.points,
    )


def placed_tolerances(
    setup: Setup,
    evaluator: ImageEvaluator,
    tolerances: Tolerances,
    objective: Objective,
    thresholds: LevelThresholds,
    *,
    min_images: int,
    run: RunContext,
) -> tuple[ToleranceResult, ...]:
    """How far the objective's score falls, in each posture and in all together."""
    drawn = replace(evaluator, table=drawn_patches(evaluator.table, DRAWN_PATCHES))
    names = [light.name for light in setup.rig.lights]
    several = len(setup.postures) > 1
    # one posture alone shows nothing where it has fewer lights than images that must show a defect
    groups = [setup.only(i) for i in range(len(setup.postures)) if len(names) >= min_images or not several]
    groups += [setup] if several else []
    found: list[ToleranceResult] = []
    for group in groups:
        if objective.name == DEFECT_OBJECTIVE:
            score = PairAssessment(drawn, group, min_images=min_images)
        else:
            # an objective of levels knows exposure 1 only
            score = ObjectiveAssessment(
                replace(drawn, detection=None),
                replace(group, exposures=((1.0,),) * len(group.postures)),
                objective=objective,
                thresholds=thresholds,
            )
        progress = run.stage(f"tolerances, {', '.join(map(str, group.postures))}")
        found.append(
            ToleranceResult(
                postures=group.postures,
                robustness=analyse_tolerances(score, names, tolerances, progress=progress),
                unit=objective.unit,
                patches=len(drawn.patches),
                grain=drawn.table.grain,
            )
        )
    return tuple(found)


def placed_commands(setup: Setup, brackets: Brackets | None, options: OptimizeOptions) -> tuple[Command, ...]:
    """Commands that capture and render the plan."""
    # as the rig files are written: one where all postures have the same lights
    one_rig = len(set(setup.angles)) == 1
    files = {posture: RIG_NAME if one_rig else f"{posture_folder(posture)}/{RIG_NAME}" for posture in setup.postures}
    return plan_commands(setup.rig, files, PLANNED_PART_NAME, brackets, render_words(options))
