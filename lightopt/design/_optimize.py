"""The pipeline: from a rig and a part to a :class:`DesignResult`.

Postures (where they are to be chosen) → candidate positions and their responses → objectives → exact search →
exposures, tolerances, blind spots.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lightopt.config import PartConfig, RigConfig, load_part, load_rig
from lightopt.core.errors import InputError
from lightopt.core.run_context import RunContext
from lightopt.design._candidates import Candidates, can_move, find_candidates
from lightopt.design._checks import check_request
from lightopt.design._commands import command_text, plan_commands
from lightopt.design._files import check_editable
from lightopt.design._options import DEFECT_OBJECTIVE, OptimizeOptions, PlanOptions, known_provenance, run_provenance
from lightopt.design._previous_result import refuse_other_result
from lightopt.design._problem import Problem, candidates_of, detection_model_of
from lightopt.design._result import ChosenPostures, DesignResult, PlanResult, SetResult, ToleranceResult, angles_of
from lightopt.design._tolerances import ObjectiveAssessment, PairAssessment, Setup, Tolerances, analyse_tolerances
from lightopt.design.blind_spots._summary import BlindSpotSummary, PostureVisibility, planned_visibility
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.objectives._registry import objectives_named
from lightopt.design.postures._exposures import plan_exposures
from lightopt.design.postures._plan_postures import plan_postures, planned_answers, with_chosen
from lightopt.design.responses._defect_hypotheses import defect_hypotheses
from lightopt.design.responses._image_evaluator import DRAWN_PATCHES, ImageEvaluator, drawn_patches
from lightopt.design.responses._luminance_matrix import LevelThresholds
from lightopt.design.responses._posture_matrices import PostureMatrices
from lightopt.design.search._best_positions import candidates_of_others, search_objectives, search_other_objectives
from lightopt.rendering import cast_rays_at, refuse_unusable_scene
from lightopt.scene import Scene, build_catalogue, build_scene, coarse_warnings


def optimize(
    rig: RigConfig | Path | str,
    part: PartConfig | Path | str,
    folder: Path | str,
    *,
    options: OptimizeOptions | None = None,
    plan: PlanOptions | None = None,
    force: bool = False,
    run: RunContext | None = None,
) -> DesignResult:
    """Find the best positions of a rig's lights for a part (paper, section 5), and plan what `plan` asks for.

    In the output folder only luminance matrices are cached; :func:`lightopt.design.write_design` writes the results.
    With `force`, the folder may hold other results.

    Raises InputError: Whatever is wrong with the files, the options or the folder.
    Raises CheckFailed: A target that cannot be reached: the message says the best that can, and why.
    """
    rig = rig if isinstance(rig, RigConfig) else load_rig(rig)
    part = part if isinstance(part, PartConfig) else load_part(part)
    options, plan, run = options or OptimizeOptions(), plan or PlanOptions(), run or RunContext()
    folder = Path(folder)
    check_request(rig, part, options, plan, folder)
    command = command_text(rig.source.path, part.source.path, options, plan)

    chosen = None
    if plan.chooses:
        if not force:
            refuse_other_result(folder, known_provenance(rig, part, options, plan))
        chosen = plan_postures(rig, part, options, plan, run)
        options = with_chosen(options, rig, chosen)

    problem = _state_problem(rig, part, options, plan, None if force else folder, run)
    table = None if chosen is None else chosen.evaluator.table_of(chosen.way.order)
    matrices = PostureMatrices(problem, folder, run, table)
    found = _search(problem, matrices, run)
    if chosen is not None:
        # one set of lights for all postures is one result: the same positions, scored by all planned images together
        free, progress = candidates_of(rig, options), run.stage("the score along each angle")
        result = planned_answers(found.results[0], chosen, found.candidates, free, progress)
        found = replace(found, results=(result,))

    planned, visibility = _complete(problem, matrices, found, plan, chosen, run)
    blind = None
    if problem.defects is not None:
        areas = matrices.patches().patches.areas
        blind = BlindSpotSummary.of(visibility, areas, problem.defects, found.candidates.names)
    return DesignResult(
        **vars(replace(problem, candidates=found.candidates)),
        folder=folder,
        command=command,
        patches=matrices.table,
        results=found.results,
        plan=planned,
        blind=blind,
        reused=matrices.reused,
        warnings=run.warnings,
    )


def _state_problem(
    rig: RigConfig, part: PartConfig, options: OptimizeOptions, plan: PlanOptions, folder: Path | None, run: RunContext
) -> Problem:
    """Build the scene and the candidates; `folder` must hold no other result, None where it may."""

    def candidates_in(scene: Scene | None, places: Sequence[tuple[float, float]] | None) -> Candidates:
        return find_candidates(
            rig,
            step_deg=options.step_deg,
            common_elevation=options.common_elevation,
            points=options.points,
            places=places,
            scene=scene,
        )

    candidates_in(None, options.places)  # errors in the rig alone come before the part is loaded
    check_editable(rig)
    objectives = _objectives(rig, part, options, run)
    scene = build_scene(rig, part, postures=options.postures, points=options.points, defects=False)
    thresholds = LevelThresholds.of_sensor(scene.sensor, shade_share=options.shade_below)
    provenance = run_provenance(rig, part, scene, options, plan, objectives)
    if folder is not None:
        refuse_other_result(folder, provenance)
    caster = cast_rays_at(scene)
    # a light that moves may find its way out of the part: only its candidates count
    fixed = tuple(panel for panel, light in zip(scene.lights, rig.lights, strict=True) if not can_move(light))
    refuse_unusable_scene(replace(scene, lights=fixed), rig, part, caster)
    candidates = all_candidates = candidates_in(scene, options.places)
    if options.places is not None and any(map(can_move, rig.lights)):
        all_candidates = candidates_in(scene, None)
    run.warn(*scene.warnings, *coarse_warnings(scene.lights, scene.reflectance.sigma))
    return Problem(
        rig=rig,
        part=part,
        options=options,
        objectives=objectives,
        scene=scene,
        caster=caster,
        thresholds=thresholds,
        candidates=candidates,
        all_candidates=all_candidates,
        provenance=provenance,
    )


def _objectives(rig: RigConfig, part: PartConfig, options: OptimizeOptions, run: RunContext) -> tuple[Objective, ...]:
    """The objectives; one that was named must be possible, one that is a default is left out otherwise."""
    chosen = objectives_named(
        options.objectives,
        # positions that were chosen before were chosen for the images of all postures together
        lambda: DetectabilityObjective(
            defect_hypotheses(build_catalogue(part)), options.min_images, across_postures=options.places is not None
        ),
    )
    refusals = {objective.name: objective.refusal(len(rig.lights)) for objective in chosen}
    problems = [text for text in refusals.values() if text is not None]
    possible = tuple(objective for objective in chosen if refusals[objective.name] is None)
    if problems and (options.objectives or not possible):
        raise InputError(*problems)
    run.warn(*problems)
    return possible


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """Best positions, the candidates that they are indices into, and what the best images show of defects."""

    results: tuple[SetResult, ...]
    candidates: Candidates
    visibility: Sequence[PostureVisibility]


def _search(problem: Problem, matrices: PostureMatrices, run: RunContext) -> _Found:
    """The best positions for every objective, exactly."""
    objectives, options = problem.objectives, problem.options
    free = candidates_of_others(matrices)
    if free is not None or options.places is None:
        run.inform((free or problem.candidates).message)
    first = objectives if free is None else objectives[:1]
    results, visibility = search_objectives(matrices, first)
    if free is not None:
        results = search_other_objectives(matrices, free, results)
    if options.report:
        matrices.patches()
    if matrices.coarse_warning is not None:
        run.warn(matrices.coarse_warning)
    return _Found(results=results, candidates=free or problem.candidates, visibility=visibility)


def _complete(
    problem: Problem,
    matrices: PostureMatrices,
    found: _Found,
    plan: PlanOptions,
    chosen: ChosenPostures | None,
    run: RunContext,
) -> tuple[PlanResult, Sequence[PostureVisibility]]:
    """Exposures and tolerances of the best positions, and what all images of the plan show of defects."""
    requested = chosen is not None or plan.exposures or plan.tolerances is not None
    if not requested or any(result.answers[0].nothing is not None for result in found.results):
        return PlanResult(chosen=chosen), found.visibility
    options = problem.options
    # the lights where they are best for the first objective in each posture, at exposure 1
    angles = {
        posture: angles_of(found.candidates, result.answers[0].found.best)
        for result in found.results
        for posture in result.postures
    }
    lights = Setup(
        rig=problem.rig,
        postures=tuple(angles),
        angles=tuple(angles.values()),
        exposures=((1.0,),) * len(angles),
        points=options.points,
    )
    brackets, tolerances = None if chosen is None else chosen.brackets, ()
    # all shares are of the surface that the postures were chosen on
    evaluator = matrices.evaluator(detection_model_of(problem.scene, problem.part, options))
    shares_on = evaluator if chosen is None else chosen.evaluator
    if plan.exposures and chosen is None:
        brackets = plan_exposures(
            shares_on,
            lights.postures,
            [lights.panels(i) for i in range(len(lights.postures))],
            plan.exposures,
            min_images=options.min_images,
            gain_points=plan.exposure_gain,
            target=plan.target,
            progress=run.stage("exposures"),
        )
    if brackets is not None:
        lights = replace(lights, exposures=tuple(map(brackets.of, lights.postures)))
    if plan.tolerances is not None:
        objective = found.results[0].answers[0].objective
        tolerances = _placed_tolerances(lights, shares_on, plan.tolerances, objective, problem, run)
    if chosen is None and brackets is None:
        return PlanResult(tolerances=tolerances), found.visibility
    commands = plan_commands(lights, options)
    planned = PlanResult(chosen=chosen, brackets=brackets, tolerances=tolerances, commands=commands)
    if problem.defects is None:
        return planned, found.visibility
    candidates = found.candidates if chosen is None else candidates_of(problem.rig, options)
    visibility = planned_visibility(
        evaluator,
        lights,
        candidates,
        all_exposures=plan.all_exposures,
        thresholds=problem.thresholds,
        least=options.min_images,
        progress=run.stage("blind spots"),
    )
    return planned, visibility


def _placed_tolerances(
    setup: Setup,
    evaluator: ImageEvaluator,
    tolerances: Tolerances,
    objective: Objective,
    problem: Problem,
    run: RunContext,
) -> tuple[ToleranceResult, ...]:
    """How far the objective's score falls, in each posture and in all together."""
    min_images = problem.options.min_images
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
                thresholds=problem.thresholds,
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
