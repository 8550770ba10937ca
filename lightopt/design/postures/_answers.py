"""The answers of an optimisation for chosen postures, as all images of the plan show them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lightopt.design._plan_progress import Share
from lightopt.design._plan_result import SHARES_OF, ChosenPostures
from lightopt.design._result import ObjectiveResult, SetResult, angles_of
from lightopt.design.candidates._candidates import Candidates
from lightopt.design.objectives._bit_runs import flags_of
from lightopt.design.objectives._detectability import Detectability
from lightopt.design.postures._common_lights import holds_places, place_counts
from lightopt.design.postures._counts import Counts, added, no_counts, reached
from lightopt.design.postures._pair_visibility import Survey
from lightopt.design.search._curves import Curve, score_curves
from lightopt.design.search._ranking import Ranked
from lightopt.scene import PanelLight

PROVEN_OF = (
    "positions of the lights in these postures at these exposures; for the postures see chosen_postures"
)
"""Among what the lights of a plan are the best, or not known to be."""


PROVEN_OF_ONE = "the positions that the first objective chose, the only ones that were scored"
"""Among what another objective's lights are the best where its own positions could not be searched."""


@dataclass(frozen=True)
class PlannedDetectability(Detectability):
    """Detectability of all planned images together, as a share of what the camera sees in any posture to choose from.

    Attributes
    ----------
    area
        Of that surface [µm²].
    """

    share_of: str = SHARES_OF
    area: int = 0

    def whole(self, area: int) -> int | None:
        """The same whatever the area of the chosen postures."""
        del area
        return super().whole(self.area)


def planned_answers(
    result: SetResult,
    chosen: ChosenPostures,
    survey: Survey,
    candidates: Candidates,
    free: Candidates | None,
    tell: Share | None = None,
) -> SetResult:
    """The best lights of each objective, scored for defects by what they show in the plan's postures and exposures.

    Parameters
    ----------
    result
        Of the chosen postures; the first objective is detectability.
    chosen
        Postures and exposures.
    survey
        The part that they were chosen on.
    candidates
        Positions of the lights that the result is of.
    free
        All that there were to choose from: the curves go through them, where the chosen ones are among them; None
        where no light moves.
    tell
        Called with the share of the curves that is done.
    """
    first = result.answers[0].objective
    assert isinstance(first, Detectability)
    goal = PlannedDetectability(first.trials, first.seen_in, area=int(survey.weights.areas.sum()))
    answers = tuple(_planned(answer, goal, chosen, survey, candidates, free) for answer in result.answers)
    best = answers[0].found.best
    at = angles_of(candidates, best)
    curves: tuple[Curve, ...] = ()
    if (
        free is not None
        and all(angles in some for angles, some in zip(at, free.angles, strict=True))
        and holds_places(survey, free, least=chosen.least)
    ):
        here = tuple(some.index(angles) for angles, some in zip(at, free.angles, strict=True))
        curves = _curves(replace(best, candidates=here), chosen, survey, free, tell)
    return replace(result, answers=answers, curves=curves)


def _curves(
    best: Ranked,
    chosen: ChosenPostures,
    survey: Survey,
    free: Candidates,
    tell: Share | None,
) -> tuple[Curve, ...]:
    postures = [(posture, chosen.exposures_of(posture)) for posture in chosen.way.order]
    lights = chosen.choice.places or place_counts(survey, postures, free, least=chosen.least, tell=tell)

    def score(combination: tuple[int, ...]) -> int:
        total = no_counts(survey.weights, chosen.least)
        for places, k in zip(lights, combination, strict=True):
            total = added(total, places[k])
        return reached(total, survey.weights)

    return score_curves(free, best, score)


def _planned(
    answer: ObjectiveResult,
    goal: PlannedDetectability,
    chosen: ChosenPostures,
    survey: Survey,
    candidates: Candidates,
    free: Candidates | None,
) -> ObjectiveResult:
    best = answer.found.best
    panels = candidates.panels_at(best.candidates)
    counts = _counts(chosen, survey, panels)
    score = reached(counts, survey.weights)
    scores = {**answer.scores, goal.name: score}
    if answer.objective.name != goal.name:
        searched = free is None or any(len(some) > 1 for some in candidates.angles)
        return replace(answer, scores=scores, proven_of=None if searched else PROVEN_OF_ONE)
    # where no other positions show more in these postures; else no bound is known but all there is to see
    best_there = chosen.choice.exact and chosen.choice.settled
    bound = score if best_there else survey.weights.total
    seen = survey.weights.areas @ flags_of(counts[-1], len(goal.trials))
    return replace(
        answer,
        objective=goal,
        found=replace(answer.found, ranking=(replace(best, negative_score=-score),), bound=bound),
        scores=scores,
        details=goal.facts(seen, goal.area),
        nothing=None,
        proven_of=PROVEN_OF,
    )


def _counts(chosen: ChosenPostures, survey: Survey, panels: Sequence[PanelLight]) -> Counts:
    total = no_counts(survey.weights, chosen.least)
    for posture in chosen.way.order:
        there = replace(survey, exposures=chosen.exposures_of(posture))
        total = added(total, there.counts(posture, panels, least=chosen.least))
    return total
