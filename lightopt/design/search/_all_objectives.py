"""The searches of a run: for every objective, or for the others beside one whose positions were chosen before."""

from __future__ import annotations

from lightopt.config import RigConfig
from lightopt.core.run_context import RunContext
from lightopt.design._result import SetResult
from lightopt.design._texts import cut_off
from lightopt.design.blind_spots._summary import PostureVisibility, posture_visibility
from lightopt.design.candidates._angles import can_move
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import LevelThresholds, LuminanceMatrix
from lightopt.design.responses._posture_matrices import PostureMatrices
from lightopt.design.search._answers import answer_others, answer_set


def search_objectives(
    source: PostureMatrices,
    objectives: tuple[Objective, ...],
    thresholds: LevelThresholds,
    run: RunContext,
) -> tuple[tuple[SetResult, ...], list[PostureVisibility]]:
    """The best sets of every posture, or of all together, and their blind spots where defects are wanted."""
    defects = next(
        (objective for objective in objectives if isinstance(objective, DetectabilityObjective)), None
    )
    options, postures_of_all = source.options, source.scene.postures
    results: list[SetResult] = []
    blind_spots: list[PostureVisibility] = []
    # the matrices of postures that do not share their lights are never held together
    for postures in [postures_of_all] if options.common_lights else [(one,) for one in postures_of_all]:
        matrices = [source.matrix(posture, held=len(postures)) for posture in postures]
        results.append(
            answer_set(
                matrices,
                postures,
                source.candidates,
                objectives,
                thresholds,
                rows=options.rows,
                limit=options.limit,
                run=run,
            )
        )
        if defects is not None:
            best = results[-1].answers[0].found.best.candidates
            blind_spots += [
                posture_visibility(matrix, posture, thresholds, seen_in=defects.seen_in, candidates=best)
                for matrix, posture in zip(matrices, postures, strict=True)
            ]
        del matrices
        for answer in results[-1].answers:
            if not answer.found.complete and answer.nothing is None:
                run.warn(cut_off(answer, postures))
    return tuple(results), blind_spots


def candidates_of_others(
    source: PostureMatrices, rig: RigConfig, free: Candidates, objectives: int, run: RunContext
) -> Candidates | None:
    """Candidates of the other objectives where the first one's positions were chosen before; None for none."""
    places = source.options.places
    if places is None or objectives == 1 or not any(map(can_move, rig.lights)):
        return None
    among = all(place in some for place, some in zip(places, free.angles, strict=True))
    if among and source.fits_memory(free):
        return free
    why = "they are too many for memory" if among else "the chosen ones are not among them"
    run.warn(
        f"the other objectives are scored where the lights were chosen to stand, their own best positions are not "
        f"searched: {why}"
    )
    return None


def search_other_objectives(
    source: PostureMatrices,
    candidates: Candidates,
    results: tuple[SetResult, ...],
    objectives: tuple[Objective, ...],
    thresholds: LevelThresholds,
    run: RunContext,
) -> tuple[SetResult, ...]:
    """The results with the best positions of the other objectives added to those of the first."""
    options = source.options
    assert options.places is not None
    at = tuple(some.index(place) for some, place in zip(candidates.angles, options.places, strict=True))
    found: list[SetResult] = []
    for result in results:

        def evaluate(combination: tuple[int, ...], result: SetResult = result) -> list[LuminanceMatrix]:
            panels = candidates.panels_at(combination)
            return [source.at_positions(posture, panels) for posture in result.postures]

        found.append(
            answer_others(
                result,
                at,
                [source.levels(posture, candidates) for posture in result.postures],
                objectives,
                thresholds,
                candidates=candidates,
                evaluate=evaluate,
                rows=options.rows,
                limit=options.limit,
                run=run,
            )
        )
        for answer in found[-1].answers[1:]:
            if not answer.found.complete and answer.nothing is None:
                run.warn(cut_off(answer, result.postures))
    return tuple(found)
