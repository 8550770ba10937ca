"""The pipeline: from a rig and a part to a :class:`DesignResult`.

Postures (where they are to be chosen) → candidate positions and their responses → objectives → exact search →
exposures, tolerances, blind spots.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import InputError, counted, refuse
from lightopt.core.run_context import RunContext
from lightopt.design import _problem, _result, _tolerances
from lightopt.design._blind_spots import BlindSpotSummary, PostureVisibility, planned_visibility
from lightopt.design._candidates import Candidates, bodies_of, can_move
from lightopt.design._files import check_editable, planned_part_text, refuse_other_result
from lightopt.design._misalignment import ObjectiveAssessment, PairAssessment, Setup
from lightopt.design.objectives import OBJECTIVES
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.postures._exposures import plan_exposures
from lightopt.design.postures._plan_postures import plan_postures, planned_answers, with_chosen
from lightopt.design.responses._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.responses._pairs import planned_catalogue
from lightopt.design.responses._posture_matrices import PostureMatrices
from lightopt.design.search._best_positions import candidates_of_others, search_objectives, search_other_objectives
from lightopt.rendering import cast_rays_at, refuse_unusable_scene
from lightopt.scene import at_rest_warnings, build_catalogue, build_scene, coarse_warnings

JOINT_TOLERANCE_PATCHES = 2_000  # of all postures together, that represent the others


def optimize(
    rig: RigConfig | Path | str,
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: _problem.OptimizeOptions | None = None,
    plan: _problem.PlanOptions | None = None,
    force: bool = False,
    run: RunContext | None = None,
) -> _result.DesignResult:
    """Find the best positions of a rig's lights for a part (paper, section 5), and plan what `plan` requests.

    In the output folder only luminance matrices are cached; :func:`lightopt.design.write_design` writes the results.
    With `force`, the folder may hold other results.

    Raises InputError: Whatever is wrong with the files, the options or the folder.
    Raises CheckFailed: A target that cannot be reached: the message says the best that can, and why.
    """
    rig = rig if isinstance(rig, RigConfig) else load_rig(rig)
    part = part if isinstance(part, PartConfig) else load_part(part)
    options, plan, run = options or _problem.OptimizeOptions(), plan or _problem.PlanOptions(), run or RunContext()
    folder = Path(folder)
    _check_request(rig, part, options, plan, folder)
    options = _decided(rig, part, options, plan, run)
    command = _result.command_text(rig.source.path, part.source.path, options, plan)

    chosen = None
    if plan.chooses:
        if not force:
            refuse_other_result(folder, _problem.run_provenance(rig, part, options, plan))
        chosen = plan_postures(rig, part, options, plan, run)
        options = with_chosen(options, rig, chosen)

    problem = _state_problem(rig, part, options, plan, None if force else folder, run)
    table = None if chosen is None else chosen.evaluator.table_of(chosen.way.order)
    matrices = PostureMatrices(problem, folder, run, table, None if chosen is None else chosen.choice.images)
    results, candidates, visibility = _search(matrices)
    if chosen is not None:
        # one set of lights for all postures is one result: the same positions, scored by all planned images together
        free = _problem.candidates_of(rig, options)
        results = (planned_answers(results[0], chosen, rig, candidates, free, options, run),)

    planned, seen = _complete(matrices, results, candidates, plan, chosen)
    blind = None
    if problem.defects is not None:
        areas = matrices.patches().patches.areas
        blind = BlindSpotSummary.of(seen or visibility, areas, problem.defects, candidates.names)
    return _result.DesignResult(
        **vars(replace(problem, candidates=candidates)),
        folder=folder,
        command=command,
        patches=matrices.table,
        results=results,
        plan=planned,
        blind=blind,
        reused=matrices.reused,
        warnings=run.warnings,
    )


def _check_request(
    rig: RigConfig, part: PartConfig, options: _problem.OptimizeOptions, plan: _problem.PlanOptions, folder: Path
) -> None:
    """Refuse options that are out of range, contradict each other, or do not go with the rig and the part."""
    _problem.check_options(options, plan)
    _check_image_count(rig, part, options, plan)
    if plan.tolerances is not None:
        _tolerances.check_body_count(len(bodies_of(rig)))
    if plan.chooses or plan.exposures:
        planned_part_text(part, [_result.HOME], folder=folder, comment="")
    if plan.chooses:
        _check_choice_of_postures(rig, options)


def _decided(
    rig: RigConfig, part: PartConfig, options: _problem.OptimizeOptions, plan: _problem.PlanOptions, run: RunContext
) -> _problem.OptimizeOptions:
    """The options with the number of images that can show a defect on this surface."""
    images = _problem.images_that_decide(rig, part, options.min_images, longest=max(plan.all_exposures))
    if images == options.min_images:
        return options
    if _problem.DEFECT_OBJECTIVE in options.objectives or plan.chooses or plan.exposures:
        why = f"the surface scatters too little light to be seen (R_d {part.reflectance.R_d:g})"
        run.warn(f"{part.source.path}: {why}, so that no second image confirms a defect: one image decides")
    return replace(options, min_images=images)


def _check_image_count(
    rig: RigConfig, part: PartConfig, options: _problem.OptimizeOptions, plan: _problem.PlanOptions
) -> None:
    # no defect can be seen in more images than there are; further exposures of a light do not count
    if plan.chooses:
        available = len(_problem.posture_grid(rig, part, step_deg=plan.posture_step_deg))
        postures = min(available, plan.choose_postures or available)
    elif plan.exposures:
        postures = len(options.postures or part.postures)
    else:
        return
    images = len(rig.lights) * postures
    if options.min_images > images:
        raise InputError(
            f"option 'min_images': expected at most {images}, the number of images of the plan: "
            f"{counted(len(rig.lights), 'light')} × {counted(postures, 'posture')} at most; found {options.min_images}"
        )


def _check_choice_of_postures(rig: RigConfig, options: _problem.OptimizeOptions) -> None:
    refusals = [OBJECTIVES[name].refusal(len(rig.lights)) for name in options.objectives if name in OBJECTIVES]
    problems = [text for text in refusals if text is not None]
    if options.postures is not None:
        chosen = "option 'choose_postures' or option 'target'"
        problems.append(f"option 'postures': cannot be combined with {chosen}; omit one or the other")
    if not options.common_lights:
        problems.append("option 'lights_per_posture': postures are chosen for one set of light positions; omit it")
    if options.objectives and options.objectives[0] != _problem.DEFECT_OBJECTIVE:
        found = f'expected {_problem.DEFECT_OBJECTIVE} first, found "{options.objectives[0]}"'
        problems.append(f"option 'objectives': postures are chosen by the defects that they show: {found}")
    refuse(problems)


def _state_problem(
    rig: RigConfig,
    part: PartConfig,
    options: _problem.OptimizeOptions,
    plan: _problem.PlanOptions,
    folder: Path | None,
    run: RunContext,
) -> _problem.Problem:
    """Build the scene and the candidates; `folder` must hold no other result, None where it may."""
    _problem.candidates_in(None, rig, options, options.places)  # errors in the rig alone come before the part is loaded
    if options.places is None and not any(map(can_move, rig.lights)):
        ranges = "an elevation_range_deg, an azimuth_range_deg or a distance_range_mm"
        run.warn(f"{rig.source.at('lights')}: no light can be moved; give one or more {ranges}")
    check_editable(rig)
    objectives = _objectives(rig, part, options, run)
    scene = build_scene(
        rig, part, postures=options.postures, points=options.points, defects=False, bounces=part.inspection.bounces
    )
    scene = replace(scene, camera=replace(scene.camera, obstructions=None))  # no position in the view is a candidate
    thresholds = LevelThresholds.of_sensor(scene.sensor, shade_share=options.shade_below)
    postures, names = [posture.as_dict() for posture in scene.postures], [objective.name for objective in objectives]
    provenance = _problem.run_provenance(rig, part, options, plan, {"objectives": names, "postures": postures})
    if folder is not None:
        refuse_other_result(folder, provenance)
    caster = cast_rays_at(scene)
    # a light that moves may find its way out of the part: only its candidates count
    fixed = tuple(panel for panel, light in zip(scene.lights, rig.lights, strict=True) if not can_move(light))
    refuse_unusable_scene(replace(scene, lights=fixed), rig, part, caster)
    candidates = all_candidates = _problem.candidates_in(scene, rig, options, options.places)
    if options.places is not None and any(map(can_move, rig.lights)):
        all_candidates = _problem.candidates_in(scene, rig, options)
    at_rest = at_rest_warnings(scene, max(plan.all_exposures))
    run.warn(*scene.warnings, *coarse_warnings(scene.lights, scene.sharpest), *at_rest)
    found = scene, caster, thresholds, candidates, all_candidates
    return _problem.Problem(rig, part, options, objectives, *found, provenance)


def _objectives(
    rig: RigConfig, part: PartConfig, options: _problem.OptimizeOptions, run: RunContext
) -> tuple[Objective, ...]:
    """The objectives; one that was named must be possible, one that is a default is left out otherwise."""
    names = options.objectives or tuple(OBJECTIVES)
    chosen: list[Objective] = []
    for name in names:
        if name in OBJECTIVES:
            chosen.append(OBJECTIVES[name])
        else:
            defects = planned_catalogue(build_catalogue(part)).defects
            # positions that were chosen before were chosen for the images of all postures together
            across, decide = options.places is not None, (options.min_images, options.false_alarms)
            chosen.append(DetectabilityObjective(defects, *decide, across_postures=across))
    refusals = [objective.refusal(len(rig.lights)) for objective in chosen]
    problems = [text for text in refusals if text is not None]
    possible = tuple(objective for objective, text in zip(chosen, refusals, strict=True) if text is None)
    if problems and (options.objectives or not possible):
        raise InputError(*problems)
    run.warn(*problems)
    return possible


def _search(matrices: PostureMatrices) -> tuple[tuple[_result.SetResult, ...], Candidates, Sequence[PostureVisibility]]:
    """Best positions for every objective, the candidates that they are indices into, and what their images show."""
    problem, run = matrices.problem, matrices.run
    free = candidates_of_others(matrices)
    if free is not None or problem.options.places is None:
        run.inform((free or problem.candidates).message)
    first = problem.objectives if free is None else problem.objectives[:1]
    results, visibility = search_objectives(matrices, first)
    if free is not None:
        results = search_other_objectives(matrices, free, results)
    if problem.options.report:
        matrices.patches()
    if matrices.coarse_warning is not None:
        run.warn(matrices.coarse_warning)
    return results, free or problem.candidates, visibility


def _complete(
    matrices: PostureMatrices,
    results: Sequence[_result.SetResult],
    candidates: Candidates,
    plan: _problem.PlanOptions,
    chosen: _result.ChosenPostures | None,
) -> tuple[_result.PlanResult, Sequence[PostureVisibility]]:
    """Exposures and tolerances of the best positions; and what the planned images show of defects, if that is more."""
    problem, options, run = matrices.problem, matrices.problem.options, matrices.run
    requested = chosen is not None or plan.exposures or plan.tolerances is not None
    if not requested or any(result.answers[0].nothing is not None for result in results):
        return _result.PlanResult(chosen=chosen), ()
    # the lights where they are best for the first objective in each posture, at exposure 1
    sets = [(result.postures, _result.places_of(candidates, result.answers[0].found.best)) for result in results]
    angles = {posture: own for postures, own in sets for posture in postures}
    exposures = ((1.0,),) * len(angles)
    lights = Setup(problem.rig, tuple(angles), tuple(angles.values()), exposures, points=options.points)
    brackets, tolerances = None if chosen is None else chosen.choice.brackets, ()
    # all shares are of the surface that the postures were chosen on
    evaluator = matrices.evaluator(_problem.detection_model_of(problem.scene, problem.part, options))
    shares_on = evaluator if chosen is None else chosen.evaluator
    if plan.exposures and chosen is None:
        inspected = shares_on
        if problem.defects is None:
            # exposures are planned for defects, whatever the objective
            inspected = replace(shares_on, table=problem.cut_patches(edges=False, threads=run.threads))
        panels, progress = [lights.panels(i) for i in range(len(angles))], run.stage("exposures")
        request = plan.exposures, plan.exposure_gain, plan.target
        brackets = plan_exposures(inspected, lights.postures, panels, *request, progress=progress)
    if brackets is not None:
        lights = replace(lights, exposures=tuple(map(brackets.of, lights.postures)))
    if plan.tolerances is not None:
        tolerances = _placed_tolerances(lights, shares_on, plan.tolerances, results[0].answers[0].objective, matrices)
    if chosen is None and brackets is None:
        return _result.PlanResult(tolerances=tolerances), ()
    commands = _result.plan_commands(lights, options)
    planned = _result.PlanResult(chosen=chosen, brackets=brackets, tolerances=tolerances, commands=commands)
    if problem.defects is None:
        return planned, ()
    if brackets is not None and chosen is None:
        found = np.array(brackets.found[: len(problem.defects.defects)])
        shares = problem.defects.facts(found, int(shares_on.weights.areas.sum()))["defects"]
        planned = replace(planned, defects=shares)
    free = candidates if chosen is None else _problem.candidates_of(problem.rig, options)
    goal, progress = (problem.thresholds, options.min_images), run.stage("blind spots")
    return planned, planned_visibility(
        replace(evaluator, pool=run.pool), lights, free, plan.all_exposures, *goal, progress
    )


def _placed_tolerances(
    setup: Setup,
    evaluator: ImageEvaluator,
    tolerances: _tolerances.Tolerances,
    objective: Objective,
    matrices: PostureMatrices,
) -> tuple[_result.ToleranceResult, ...]:
    """How far the objective's score falls, in each posture and in all together."""
    problem, min_images = matrices.problem, matrices.problem.options.min_images
    drawn = replace(evaluator, table=drawn_patches(evaluator.table, DRAWN_PATCHES))
    several = len(setup.postures) > 1
    # one posture alone shows nothing where it has fewer lights than images that must show a defect
    groups = [setup.only(i) for i in range(len(setup.postures)) if len(setup.rig.lights) >= min_images or not several]
    groups += [setup] if several else []
    found: list[_result.ToleranceResult] = []
    for group in groups:
        if objective.name == _problem.DEFECT_OBJECTIVE:
            score = PairAssessment(drawn, group)
        else:
            # an objective of levels knows exposure 1 only
            single, levels = replace(group, exposures=((1.0,),) * len(group.postures)), replace(drawn, detection=None)
            score = ObjectiveAssessment(levels, single, objective=objective, thresholds=problem.thresholds)
        progress = matrices.run.stage(f"tolerances, {', '.join(map(str, group.postures))}")
        robustness = _tolerances.analyse_tolerances(score, setup.names, tolerances, progress=progress)
        patches, grain = len(drawn.patches), drawn.table.grain
        found.append(_result.ToleranceResult(group.postures, robustness, objective.unit, patches=patches, grain=grain))
    return tuple(found)


def design_tolerances(
    result: _result.DesignResult, *, target: float = _tolerances.DEFAULT_TOLERANCE_TARGET, run: RunContext | None = None
) -> _tolerances.JointTolerances | None:
    """The tolerances of a design's first lights with which `target` of the share of defects is kept; None for none."""
    run, best = run or RunContext(), result.results[0]
    if result.defects is None or best.answers[0].nothing is not None:
        return None
    plan, postures = result.plan, best.postures
    places = (_result.places_of(result.candidates, best.answers[0].found.best),) * len(postures)
    exposures = tuple(map(plan.exposures_of, postures))
    setup = Setup(result.rig, postures, places, exposures, points=result.options.points)
    if plan.chosen is not None:
        evaluator = plan.chosen.evaluator
    else:
        table = result.patches or result.cut_patches(edges=False, threads=run.threads)
        detection = _problem.detection_model_of(result.scene, result.part, result.options)
        shadows = result.options.shadows
        evaluator = ImageEvaluator(result.scene, table, result.caster, detection, shadows=shadows, threads=run.threads)
    few = max(1, JOINT_TOLERANCE_PATCHES // len(postures))
    drawn = replace(evaluator, table=drawn_patches(evaluator.table, few), images=None)
    # as the share is counted
    together = plan.chosen is not None or plan.brackets is not None
    score = PairAssessment(drawn, setup, together=together)
    return _tolerances.joint_tolerances(score, len(setup.bodies), target, progress=run.stage("tolerances"))
