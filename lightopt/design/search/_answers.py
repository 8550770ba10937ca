"""From luminance matrices to the best set of each objective, compared under every objective."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lightopt.core.errors import InputError, LightoptError
from lightopt.core.run_context import RunContext
from lightopt.core.threads import blocks
from lightopt.core.transforms import Posture
from lightopt.design._result import ObjectiveResult, SetResult
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.objectives._objective import Objective
from lightopt.design.responses._luminance_matrix import (
    AREA_UNIT_MM2,
    LevelThresholds,
    LuminanceMatrix,
    area_units,
)
from lightopt.design.search._curves import score_curves
from lightopt.design.search._exact_search import SearchResult, search
from lightopt.rendering import GRAZING_DEG, grain_of

PIECE_PATCHES = 1 << 15
"""Patches for which an objective's definition is evaluated at once."""


def answer_set(
    matrices: Sequence[LuminanceMatrix],
    postures: Sequence[Posture],
    candidates: Candidates,
    objectives: Sequence[Objective],
    thresholds: LevelThresholds,
    *,
    rows: int,
    limit: int,
    run: RunContext,
) -> SetResult:
    """The best light positions for postures that share them.

    Each objective is optimised, and each best set is scored under all. `rows` and `limit` are `keep` and
    `limit` of :func:`lightopt.design.search`, which says what is raised.
    """
    for matrix, posture in zip(matrices, postures, strict=True):
        if not len(matrix.areas):
            sight = f"all that the camera sees, it sees at more than {GRAZING_DEG:g}° to the normal"
            raise InputError(
                f"posture {posture}: {sight if matrix.grazing_mm2 else 'the camera sees no patch'}, so that no "
                "position of the lights is better than another; check the part's placement and the posture"
            )
    find = partial(search, space=candidates.space, keep=rows, limit=limit, threads=run.threads)
    answers: list[ObjectiveResult] = []
    for objective in objectives:
        stage = f"{objective.name}, {', '.join(map(str, postures))}"
        found = find(matrices, objective, thresholds, progress=run.stage(stage))
        best = found.best.candidates
        scores = {other.name: _score(matrices, other, best, thresholds) for other in objectives}
        if scores[objective.name] != found.best.score:
            raise LightoptError(
                f"internal error: objective {objective.name} scores the best set {found.best.score:,} in the search "
                f"and {scores[objective.name]:,} by its definition; please report it with the rig and the part"
            )
        nothing = _reason_for_zero(matrices, thresholds, found) if found.best.score == 0 else None
        details = objective.details(
            [matrix.combination(best) for matrix in matrices],
            [objective.weights(matrix.areas) for matrix in matrices],
        )
        answers.append(
            ObjectiveResult(objective=objective, found=found, scores=scores, details=details, nothing=nothing)
        )
    first = answers[0]
    return SetResult(
        postures=tuple(postures),
        patches=sum(len(matrix.areas) for matrix in matrices),
        area=sum(int(area_units(matrix.areas).sum()) for matrix in matrices),
        grazing_area=round(sum(matrix.grazing_mm2 for matrix in matrices) / AREA_UNIT_MM2),
        grain=sum(grain_of(matrix.areas) * float(matrix.areas.sum()) for matrix in matrices)
        / sum(float(matrix.areas.sum()) for matrix in matrices),
        answers=tuple(answers),
        levels=tuple(
            np.concatenate(matrix.combination(first.found.best.candidates).levels) for matrix in matrices
        ),
        curves=()
        if first.nothing is not None
        else score_curves(
            candidates,
            first.found.best,
            lambda combination: _score(matrices, first.objective, combination, thresholds),
        ),
    )


def answer_others(
    chosen: SetResult,
    at: tuple[int, ...],
    levels: Sequence[LuminanceMatrix],
    objectives: Sequence[Objective],
    thresholds: LevelThresholds,
    *,
    candidates: Candidates,
    evaluate: Callable[[tuple[int, ...]], Sequence[LuminanceMatrix]],
    rows: int,
    limit: int,
    run: RunContext,
) -> SetResult:
    """The best light positions of other objectives, beside those that were chosen before for the first.

    chosen: The answer of the first objective, with one position of each light.
    at: These positions among the candidates.
    levels: Of all candidates, one matrix per posture.
    evaluate: Computes the matrices of one combination, one per posture, with all that the first objective needs.
    """
    first = chosen.answers[0]
    find = partial(search, space=candidates.space, keep=rows, limit=limit, threads=run.threads)
    answers: list[ObjectiveResult] = []
    for objective in objectives:
        if objective is objectives[0]:
            found = replace(first.found, ranking=(replace(first.found.best, candidates=at),))
        else:
            stage = f"{objective.name}, {', '.join(map(str, chosen.postures))}"
            found = find(levels, objective, thresholds, progress=run.stage(stage))
        matrices = evaluate(found.best.candidates)
        only = (0,) * len(candidates.names)
        answers.append(
            ObjectiveResult(
                objective=objective,
                found=found,
                scores={other.name: _score(matrices, other, only, thresholds) for other in objectives},
                details=objective.details(matrices, [objective.weights(matrix.areas) for matrix in matrices]),
                nothing=_reason_for_zero(levels or matrices, thresholds, found)
                if found.best.score == 0
                else None,
            )
        )
    return replace(chosen, answers=tuple(answers))


def _score(
    matrices: Sequence[LuminanceMatrix],
    objective: Objective,
    combination: tuple[int, ...],
    thresholds: LevelThresholds,
) -> int:
    total = 0
    for matrix in matrices:
        one, weights = matrix.combination(combination), objective.weights(matrix.areas)
        # scores are sums over patches: pieces of them bound the memory
        for start, end in blocks(len(weights), PIECE_PATCHES):
            total += objective.score(one.patches(start, end), weights[start:end], thresholds)
    return total


def _reason_for_zero(
    matrices: Sequence[LuminanceMatrix], thresholds: LevelThresholds, found: SearchResult
) -> str:
    layers = [layer for matrix in matrices for layer in matrix.levels]
    count = sum(layer.size for layer in layers)
    dark = sum(int(np.count_nonzero(layer < thresholds.shade)) for layer in layers)
    bright = sum(int(np.count_nonzero(layer >= thresholds.saturation)) for layer in layers)
    which = (
        "every combination scores 0"
        if found.bound == 0
        else f"all {found.scored:,} combinations that were scored score 0, with {found.left:,} left"
    )
    return (
        f"{which}: of the levels of the inspectable patches {100.0 * dark / count:.3g} % are shaded "
        f"(below {thresholds.shade}) and {100.0 * bright / count:.3g} % saturated (from {thresholds.saturation} on); "
        "change the lights' gain, the thresholds or the lights' ranges"
    )
