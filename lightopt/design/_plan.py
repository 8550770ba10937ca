"""From two YAML files to a plan on disk: postures, lights, exposures, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lightopt.config import PartConfig, RigConfig, input_hashes, load_part, load_rig
from lightopt.core.errors import InputError, counted
from lightopt.core.provenance import provenance
from lightopt.design._additions import Appendix, Outcome
from lightopt.design._command_line import command_text
from lightopt.design._commands import HOME
from lightopt.design._found import Draft
from lightopt.design._optimize import Optimum, optimize
from lightopt.design._options import OptimizeOptions, check_options
from lightopt.design._part_file import PLANNED_PART_NAME, planned_text
from lightopt.design._plan_json import plan_dict
from lightopt.design._plan_options import OBJECTIVE, PlanOptions, check_plan
from lightopt.design._plan_progress import Tell, of_stage
from lightopt.design._plan_result import ChosenPostures, PlanResult
from lightopt.design._plan_steps import appraised
from lightopt.design._previous_result import refuse_other_result
from lightopt.design.blind_spots._classes import Legend
from lightopt.design.objectives._registry import OBJECTIVES
from lightopt.design.postures._image_evaluator import ImageEvaluator
from lightopt.design.postures._plan_answers import planned_answers
from lightopt.design.postures._plan_postures import candidates_of, chosen_angles, plan_postures
from lightopt.design.postures._posture_grid import posture_grid
from lightopt.design.tolerances._tolerances import lights_problem
from lightopt.rendering import Report


@dataclass(frozen=True, kw_only=True)
class Planned:
    """What :func:`plan` found and left on disk.

    Attributes
    ----------
    optimum
        The lights, and the files.
    result
        Postures, exposures, trust.
    """

    optimum: Optimum
    result: PlanResult


def plan(
    rig: RigConfig | Path | str,
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: OptimizeOptions,
    wanted: PlanOptions,
    force: bool = False,
    warn: Callable[[str], None] | None = None,
    tell: Callable[[str], None] | None = None,
    report: Report | None = None,
    searching: Tell | None = None,
    page: Callable[[Draft], str] | None = None,
    legend: Legend | None = None,
) -> Planned:
    """Plan postures and exposures, say how exactly the angles must hold, and write it all with the best lights.

    Parameters
    ----------
    rig, part, folder, force, warn, tell, report, searching, page, legend
        As for :func:`lightopt.design.optimize`.
    options
        Of the optimisation.
    wanted
        Of the plan.

    Raises
    ------
    InputError
        Whatever is wrong with the files, the options or the folder.
    CheckFailed
        A target that cannot be reached: the message says the best that can, and why.
    """
    rig = rig if isinstance(rig, RigConfig) else load_rig(rig)
    part = part if isinstance(part, PartConfig) else load_part(part)
    check_options(options)
    check_plan(wanted)
    _check_images(rig, part, options, wanted)
    if wanted.tolerances is not None and (problem := lights_problem(len(rig.lights))):
        raise InputError(problem)
    asked = command_text(rig.source.path, part.source.path, options, wanted)
    options = replace(options, plan={**options.plan, **_facts(options, wanted)})
    chosen: ChosenPostures | None = None
    survey: ImageEvaluator | None = None
    if wanted.chooses or wanted.exposures:
        planned_text(part, [HOME], folder=Path(folder), comment="")  # says now what would be wrong with it
    if wanted.chooses:
        _check_chooses(rig, options, wanted)
        if not force:
            refuse_other_result(Path(folder), _early_provenance(rig, part, options))
        chosen, survey = plan_postures(rig, part, options, wanted, tell, searching)
        options = replace(
            options,
            objectives=options.objectives or (OBJECTIVE,),
            postures=chosen.way.order,
            common_lights=True,
            places=chosen_angles(rig, chosen.choice, options),
        )
    found: list[PlanResult] = []

    def appraise(outcome: Outcome) -> Appendix:
        if chosen is not None and survey is not None:
            # one set of lights for all postures is one result
            answers = planned_answers(
                outcome.results[0],
                chosen,
                survey,
                outcome.candidates,
                candidates_of(rig, options),
                of_stage(searching, "the score along each angle"),
            )
            outcome = replace(outcome, results=(answers,))
        result, looked = appraised(rig, part, outcome, options, wanted, chosen, survey, searching)
        found.append(result)
        files = {}
        if result.commands:
            files[PLANNED_PART_NAME] = planned_text(
                part,
                outcome.scene.postures,
                folder=Path(folder),
                comment=f"planned by: {asked}",
            )
        names = [light.name for light in rig.lights]
        return Appendix(
            sections=plan_dict(result, names),
            files=files,
            results=outcome.results,
            looked=looked,
            exposures={posture: result.exposures_of(posture) for posture in outcome.scene.postures},
        )

    optimum = optimize(
        rig,
        part,
        folder,
        options=options,
        force=force,
        warn=warn,
        tell=tell,
        report=report,
        searching=searching,
        appraise=appraise,
        page=page,
        legend=legend,
        table=None if chosen is None or survey is None else survey.table_of(chosen.way.order),
    )
    return Planned(optimum=optimum, result=found[0])


def _facts(options: OptimizeOptions, wanted: PlanOptions) -> dict[str, Any]:
    # postures and exposures are planned for defects, whatever the objective
    if not (wanted.chooses or wanted.exposures):
        return wanted.facts()
    return {"seen_in": options.seen_in, "threshold": options.contrast, **wanted.facts()}


def _check_chooses(rig: RigConfig, options: OptimizeOptions, wanted: PlanOptions) -> None:
    beside = [OBJECTIVES[name].refusal(len(rig.lights)) for name in options.objectives if name in OBJECTIVES]
    problems = [text for text in beside if text is not None]
    if options.postures is not None:
        asked = " and ".join(
            name
            for name, value in (("--choose-postures", wanted.postures), ("--target", wanted.target))
            if value is not None
        )
        problems.append(
            f"--posture: given together with {asked}, by which postures are chosen from the stage's range; leave "
            f"--posture out, or {asked}"
        )
    if options.objectives and options.objectives[0] != OBJECTIVE:
        problems.append(
            f"--objective: postures are chosen by what they show of the defects: expected {OBJECTIVE} first, found "
            f'"{options.objectives[0]}"'
        )
    if problems:
        raise InputError(*problems)


def _check_images(rig: RigConfig, part: PartConfig, options: OptimizeOptions, wanted: PlanOptions) -> None:
    # no defect can be seen in more images than there are
    if wanted.chooses:
        offered = len(posture_grid(rig, part, step_deg=wanted.posture_step_deg))
        most = min(offered, wanted.postures or offered)
        images = len(rig.lights) * most
        what = f"images of the plan: {counted(len(rig.lights), 'light')} × {counted(most, 'posture')} at most"
    elif wanted.exposures:
        postures = options.postures or part.postures
        images = len(rig.lights) * len(postures)
        of = f"{counted(len(rig.lights), 'light')} × {counted(len(postures), 'posture')}"
        what = f"images of the plan: {of}, further exposures of the same light not being others"
    else:
        return
    if options.seen_in > images:
        raise InputError(
            f"--seen-in: expected at most {images}, the number of {what}; found {options.seen_in}; lower it"
        )


def _early_provenance(rig: RigConfig, part: PartConfig, options: OptimizeOptions) -> dict[str, Any]:
    # of what is known before the postures are: a part of what the result will say
    return provenance(
        input_hashes(rig, part),
        {
            "step_deg": options.step_deg,
            "common_elevation": options.common_elevation,
            "points": options.points,
            "shadows": options.shadows,
            "patch_budget": options.patch_budget,
            **options.plan,
        },
    )
