"""The searches of a run: of every objective, or of those beside one whose positions were chosen before."""

from __future__ import annotations

from collections.abc import Callable

from lightopt.config import RigConfig
from lightopt.design._result import SetResult
from lightopt.design._texts import cut_off
from lightopt.design.blind_spots._summary import PostureVisibility, posture_visibility
from lightopt.design.candidates._angles import can_move
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.objectives._detectability import Detectability
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import LuminanceMatrix, Thresholds
from lightopt.design.responses._posture_matrices import Matrices
from lightopt.design.search._answer import answer_set, answers_beside
from lightopt.rendering import Report


def searched(
    makers: Matrices,
    objectives: tuple[Objective, ...],
    thresholds: Thresholds,
    report: Report | None,
    searching: Callable[[str, float], None] | None,
    say: Callable[[str], None],
) -> tuple[tuple[SetResult, ...], list[PostureVisibility]]:
    """The best sets of every posture, or of all together, and what they leave unseen where that was asked for."""
    defects = next((objective for objective in objectives if isinstance(objective, Detectability)), None)
    options, postures_of_all = makers.options, makers.scene.postures
    results: list[SetResult] = []
    looked: list[PostureVisibility] = []
    # the matrices of postures that do not share their lights are never held together
    for postures in [postures_of_all] if options.common_lights else [(one,) for one in postures_of_all]:
        matrices = [makers.matrix(posture, report, held=len(postures)) for posture in postures]
        results.append(
            answer_set(
                matrices,
                postures,
                makers.candidates,
                objectives,
                thresholds,
                rows=options.rows,
                limit=options.limit,
                threads=options.threads,
                progress=searching,
            )
        )
        if defects is not None:
            best = results[-1].answers[0].found.best.candidates
            looked += [
                posture_visibility(matrix, posture, thresholds, seen_in=defects.seen_in, candidates=best)
                for matrix, posture in zip(matrices, postures, strict=True)
            ]
        del matrices
        for answer in results[-1].answers:
            if not answer.found.complete and answer.nothing is None:
                say(cut_off(answer, postures))
    return tuple(results), looked


def candidates_beside(
    makers: Matrices,
    rig: RigConfig,
    free: Candidates,
    objectives: int,
    say: Callable[[str], None],
) -> Candidates | None:
    """What other objectives may choose from, where the first one's places were chosen before; None for nothing."""
    places = makers.options.places
    if places is None or objectives == 1 or not any(map(can_move, rig.lights)):
        return None
    among = all(place in some for place, some in zip(places, free.angles, strict=True))
    if among and makers.holds(free):
        return free
    why = "they are too many for memory" if among else "the chosen ones are not among them"
    say(
        f"the other objectives are scored where the lights were chosen to stand, their own best positions are not "
        f"searched: {why}"
    )
    return None


def searched_beside(
    makers: Matrices,
    candidates: Candidates,
    results: tuple[SetResult, ...],
    objectives: tuple[Objective, ...],
    thresholds: Thresholds,
    report: Report | None,
    searching: Callable[[str, float], None] | None,
    say: Callable[[str], None],
) -> tuple[SetResult, ...]:
    """The results with the best positions of the other objectives beside those of the first."""
    options = makers.options
    assert options.places is not None
    at = tuple(some.index(place) for some, place in zip(candidates.angles, options.places, strict=True))
    found: list[SetResult] = []
    for result in results:

        def look(combination: tuple[int, ...], result: SetResult = result) -> list[LuminanceMatrix]:
            panels = candidates.panels_at(combination)
            return [makers.of_places(posture, panels) for posture in result.postures]

        found.append(
            answers_beside(
                result,
                at,
                [makers.levels(posture, candidates, report) for posture in result.postures],
                objectives,
                thresholds,
                candidates=candidates,
                look=look,
                rows=options.rows,
                limit=options.limit,
                threads=options.threads,
                progress=searching,
            )
        )
        for answer in found[-1].answers[1:]:
            if not answer.found.complete and answer.nothing is None:
                say(cut_off(answer, result.postures))
    return tuple(found)
