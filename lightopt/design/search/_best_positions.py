"""The best light positions for every objective, compared under all; or for the other objectives after the first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lightopt.core.errors import InputError, LightoptError
from lightopt.core.threads import blocks
from lightopt.core.transforms import Posture
from lightopt.design._blind_spots import PostureVisibility, by_light, defect_visibility
from lightopt.design._candidates import Candidates, can_move, place_of, score_curves
from lightopt.design._result import ObjectiveResult, SetResult
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import AREA_UNIT_MM2, LevelThresholds, LuminanceMatrix, area_units
from lightopt.design.responses._posture_matrices import PostureMatrices
from lightopt.design.search._between_steps import (
    BetweenSteps,
    ProbedCells,
    bound_between,
    excess_of_levels,
    tested_patches,
)
from lightopt.design.search._exact_search import CombinationSpace, SearchResult, search
from lightopt.rendering import GRAZING_DEG, grain_of

PIECE_PATCHES = 1 << 15  # patches for which an objective's definition is evaluated at once
_Matrices = Sequence[LuminanceMatrix]  # one of each posture


def search_objectives(
    source: PostureMatrices, objectives: tuple[Objective, ...]
) -> tuple[tuple[SetResult, ...], list[PostureVisibility]]:
    """The best sets of every posture, or of all together, and their blind spots where defects are wanted."""
    defects = source.problem.defects if source.problem.defects in objectives else None
    thresholds, all_postures = source.problem.thresholds, source.problem.scene.postures
    results: list[SetResult] = []
    blind_spots: list[PostureVisibility] = []
    # the matrices of postures that do not share their lights are never held together
    for postures in [all_postures] if source.problem.options.common_lights else [(one,) for one in all_postures]:
        matrices = [source.matrix(posture, held=len(postures)) for posture in postures]
        result = answer_set(matrices, postures, objectives, source)
        if defects is not None:
            best, least = result.answers[0].found.best.candidates, defects.min_images
            for matrix, posture in zip(matrices, postures, strict=True):
                chosen, possible = (
                    defect_visibility(by_light([one]), thresholds, least=least)
                    for one in (matrix.combination(best), matrix)
                )
                blind_spots.append((posture, chosen, possible))
        del matrices
        _warn_of_limit(result.answers, postures, source)
        if (between := result.answers[0].between) is not None:
            source.run.warn(*between.warnings(postures))
        results.append(result)
    return tuple(results), blind_spots


def answer_set(
    matrices: _Matrices, postures: Sequence[Posture], objectives: Sequence[Objective], source: PostureMatrices
) -> SetResult:
    """The best light positions for postures that share them: each objective is optimised, and scored under all."""
    for matrix, posture in zip(matrices, postures, strict=True):
        if not len(matrix.areas):
            sight = f"no surface, away from edges, at less than {GRAZING_DEG:g}° to its normal"
            raise InputError(f"posture {posture}: the camera sees {sight}; check the part's placement and the posture")
    thresholds, candidates = source.problem.thresholds, source.problem.candidates
    answers: list[ObjectiveResult] = []
    for objective in objectives:
        found = _search(matrices, postures, candidates.space, objective, source)
        chosen = [matrix.combination(found.best.candidates) for matrix in matrices]
        answer = _answer(found, chosen, matrices, objective, source)
        if answer.scores[objective.name] != found.best.score:
            scores = f"{found.best.score:,} in the search and {answer.scores[objective.name]:,} by its definition"
            raise LightoptError(f"internal error: objective {objective.name} scores the best set {scores}")
        if not answers:
            answer = replace(answer, between=_between_steps(answer, matrices, postures, source))
        answers.append(answer)
    first = answers[0]
    best, areas = first.found.best, [matrix.areas for matrix in matrices]

    def score(combination: tuple[int, ...]) -> int:
        return _score([matrix.combination(combination) for matrix in matrices], first.objective, thresholds)

    return SetResult(
        postures=tuple(postures),
        patches=sum(map(len, areas)),
        area=sum(int(area_units(own).sum()) for own in areas),
        grazing_area=round(sum(matrix.grazing_mm2 for matrix in matrices) / AREA_UNIT_MM2),
        grain=sum(grain_of(own) * float(own.sum()) for own in areas) / sum(float(own.sum()) for own in areas),
        answers=tuple(answers),
        levels=tuple(np.concatenate(matrix.combination(best.candidates).levels) for matrix in matrices),
        curves=() if first.nothing is not None else score_curves(candidates, best, score),
        initial_score=_initial_score(matrices, postures, first.objective, source),
    )


def _between_steps(
    answer: ObjectiveResult, matrices: _Matrices, postures: Sequence[Posture], source: PostureMatrices
) -> BetweenSteps | None:
    # none where the search did not end either, or no light moves
    problem, objective, run = source.problem, answer.objective, source.run
    candidates, where = problem.candidates, ", ".join(map(str, postures))
    cells, best = candidates.cells, answer.found.best
    if not cells.moves or not answer.found.complete or answer.nothing is not None:
        return None
    of_defects = isinstance(objective, DetectabilityObjective)
    evaluator = source.evaluator(source.detection if of_defects else None)
    if not of_defects:
        matrices = [replace(matrix, visibility=None) for matrix in matrices]
    outer = [evaluator.matrices(posture, [own.beyond for own in cells.of_lights])[0] for posture in postures]
    ask = (matrices, outer, objective, problem.thresholds, cells)
    progress = run.stage(f"{objective.name} between the steps, {where}")
    found = bound_between(*ask, limit=problem.options.limit, threads=run.threads, progress=progress)
    if found is None:
        return None
    tested = ProbedCells.around(problem.rig, candidates, problem.options, best.candidates, found.cells)
    few = tested_patches(evaluator, len(postures))
    tests = [source.with_spare(few.matrices(posture, tested.panels)[0]) for posture in postures]
    excess = excess_of_levels(tested, tests, objective, problem.thresholds)
    full = objective.full_score(sum(int(area_units(matrix.areas).sum()) for matrix in matrices))
    return BetweenSteps.of(found.score, excess, full=full, best=best.score, postures=postures)


def _initial_score(
    matrices: _Matrices, postures: Sequence[Posture], objective: Objective, source: PostureMatrices
) -> int | None:
    # of the lights as the rig file has them; None where the positions were chosen before
    problem = source.problem
    if problem.options.places is not None:
        return None
    now = [place_of(light) for light in problem.rig.lights]
    places = problem.candidates.places
    if all(place in some for place, some in zip(now, places, strict=True)):
        at = tuple(some.index(place) for place, some in zip(now, places, strict=True))
        initial = [matrix.combination(at) for matrix in matrices]
    else:
        evaluator, panels = source.evaluator(source.detection), [[panel] for panel in problem.scene.lights]
        initial = [evaluator.matrices(posture, panels)[0] for posture in postures]
    return _score(initial, objective, problem.thresholds)


def candidates_of_others(source: PostureMatrices) -> Candidates | None:
    """Candidates of the other objectives where the first one's positions were chosen before; None for none."""
    problem = source.problem
    places, free = problem.options.places, problem.all_candidates
    if places is None or len(problem.objectives) == 1 or not any(map(can_move, problem.rig.lights)):
        return None
    among = all(place in some for place, some in zip(places, free.places, strict=True))
    if among and source.fits_memory(free):
        return free
    why = "they are too many for memory" if among else "the chosen ones are not among them"
    source.run.warn(f"the other objectives are scored for the chosen light positions only: {why}")
    return None


def search_other_objectives(
    source: PostureMatrices, candidates: Candidates, results: tuple[SetResult, ...]
) -> tuple[SetResult, ...]:
    """The results with the best positions of the other objectives added to those of the first.

    `candidates` are all positions; `results` have one position of each light, which was chosen before.
    """
    objectives, places = source.problem.objectives, source.problem.options.places
    assert places is not None
    at = tuple(some.index(place) for some, place in zip(candidates.places, places, strict=True))
    completed: list[SetResult] = []
    for result in results:
        levels = [source.levels(posture, candidates) for posture in result.postures]
        answers: list[ObjectiveResult] = []
        for objective in objectives:
            if objective is objectives[0]:
                chosen = result.answers[0].found
                found = replace(chosen, ranking=(replace(chosen.best, candidates=at),))
            else:
                found = _search(levels, result.postures, candidates.space, objective, source)
            panels = candidates.panels_at(found.best.candidates)
            evaluator = source.evaluator(source.detection)
            matrices = [evaluator.matrices(one, [[panel] for panel in panels])[0] for one in result.postures]
            answers.append(_answer(found, matrices, levels, objective, source))
        completed.append(replace(result, answers=tuple(answers)))
        _warn_of_limit(answers[1:], result.postures, source)
    return tuple(completed)


def _search(
    matrices: _Matrices, postures: Sequence[Posture], space: CombinationSpace, goal: Objective, source: PostureMatrices
) -> SearchResult:
    options, run, thresholds = source.problem.options, source.run, source.problem.thresholds
    stage, keep = run.stage(f"{goal.name}, {', '.join(map(str, postures))}"), options.rows
    return search(
        matrices, goal, thresholds, space=space, keep=keep, limit=options.limit, threads=run.threads, progress=stage
    )


def _answer(
    found: SearchResult, chosen: _Matrices, matrices: _Matrices, objective: Objective, source: PostureMatrices
) -> ObjectiveResult:
    # `chosen` have the best combination only, `matrices` all candidates; one of each per posture
    thresholds = source.problem.thresholds
    return ObjectiveResult(
        objective=objective,
        found=found,
        scores={other.name: _score(chosen, other, thresholds) for other in source.problem.objectives},
        details=objective.details(chosen, [objective.weights(matrix.areas) for matrix in chosen]),
        nothing=_reason_for_zero(matrices, thresholds, found) if found.best.score == 0 else None,
    )


def _warn_of_limit(answers: Sequence[ObjectiveResult], postures: Sequence[Posture], source: PostureMatrices) -> None:
    some = [one for one in answers if not one.found.complete and one.nothing is None]
    source.run.warn(*(limit_warning(one, postures) for one in some))


def limit_warning(answer: ObjectiveResult, postures: Sequence[Posture]) -> str:
    """The warning about a search that stopped before all combinations were searched."""
    found, name = answer.found, answer.objective.name
    searched = f"the search stopped after {found.scored:,} combinations with {found.left:,} left"
    return (
        f"objective {name}, {', '.join(map(str, postures))}: {searched}; the best found scores {found.best.score:,}, "
        f"none scores more than {found.bound:,}. Raise option 'limit' or option 'step_deg'"
    )


def _score(matrices: _Matrices, objective: Objective, thresholds: LevelThresholds) -> int:
    # of matrices with one candidate of each light
    total = 0
    for matrix in matrices:
        weights = objective.weights(matrix.areas)
        # scores are sums over patches: pieces of them bound the memory
        for start, end in blocks(len(weights), PIECE_PATCHES):
            total += objective.score(matrix.patches(start, end), weights[start:end], thresholds)
    return total


def _reason_for_zero(matrices: _Matrices, thresholds: LevelThresholds, found: SearchResult) -> str:
    layers = [layer for matrix in matrices for layer in matrix.levels]
    count = sum(layer.size for layer in layers)
    dark = sum(int(np.count_nonzero(layer < thresholds.shade)) for layer in layers)
    bright = sum(int(np.count_nonzero(layer >= thresholds.saturation)) for layer in layers)
    which = "every combination" if found.bound == 0 else f"each of {found.scored:,} combinations ({found.left:,} left)"
    return (
        f"{which} scores 0: of the levels of the inspectable patches {100.0 * dark / count:.3g} % are "
        f"shaded (below {thresholds.shade}) and {100.0 * bright / count:.3g} % saturated (from {thresholds.saturation} "
        "on); change the lights' gain or their ranges"
    )
