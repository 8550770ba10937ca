"""What is wrong with a request, before any ray is cast."""

from pathlib import Path

from lightopt.config import PartConfig, RigConfig
from lightopt.core.errors import InputError, counted
from lightopt.design._commands import HOME
from lightopt.design._files import planned_part_text
from lightopt.design._options import DEFECT_OBJECTIVE, OptimizeOptions, PlanOptions, check_options
from lightopt.design._tolerances import lights_problem
from lightopt.design.objectives._registry import OBJECTIVES
from lightopt.design.postures._posture_grid import posture_grid


def check_request(rig: RigConfig, part: PartConfig, options: OptimizeOptions, plan: PlanOptions, folder: Path) -> None:
    """Refuse options that are out of range, contradict each other, or do not go with the rig and the part."""
    check_options(options, plan)
    _check_image_count(rig, part, options, plan)
    if plan.tolerances is not None and (problem := lights_problem(len(rig.lights))):
        raise InputError(problem)
    if plan.chooses or plan.exposures:
        planned_part_text(part, [HOME], folder=folder, comment="")
    if plan.chooses:
        _check_choice_of_postures(rig, options, plan)


def _check_image_count(rig: RigConfig, part: PartConfig, options: OptimizeOptions, plan: PlanOptions) -> None:
    # no defect can be seen in more images than there are
    if plan.chooses:
        available = len(posture_grid(rig, part, step_deg=plan.posture_step_deg))
        most = min(available, plan.choose_postures or available)
        images = len(rig.lights) * most
        what = f"images of the plan: {counted(len(rig.lights), 'light')} × {counted(most, 'posture')} at most"
    elif plan.exposures:
        postures = options.postures or part.postures
        images = len(rig.lights) * len(postures)
        of = f"{counted(len(rig.lights), 'light')} × {counted(len(postures), 'posture')}"
        what = f"images of the plan: {of}, further exposures of the same light not being others"
    else:
        return
    if options.min_images > images:
        raise InputError(
            f"option 'min_images': expected at most {images}, the number of {what}; found {options.min_images}; "
            "lower it"
        )


def _check_choice_of_postures(rig: RigConfig, options: OptimizeOptions, plan: PlanOptions) -> None:
    refusals = [OBJECTIVES[name].refusal(len(rig.lights)) for name in options.objectives if name in OBJECTIVES]
    problems = [text for text in refusals if text is not None]
    if options.postures is not None:
        given = " and ".join(
            name
            for name, value in (("option 'choose_postures'", plan.choose_postures), ("option 'target'", plan.target))
            if value is not None
        )
        problems.append(
            f"option 'postures': given together with {given}, by which postures are chosen from the stage's range; "
            f"leave option 'postures' out, or {given}"
        )
    if options.objectives and options.objectives[0] != DEFECT_OBJECTIVE:
        problems.append(
            "option 'objectives': postures are chosen by what they show of the defects: expected "
            f"{DEFECT_OBJECTIVE} first, "
            f'found "{options.objectives[0]}"'
        )
    if problems:
        raise InputError(*problems)
