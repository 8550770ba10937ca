"""The optimisation's answers for chosen postures, scored by what all images of the plan show together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lightopt.core.run_context import Share
from lightopt.design._candidates import Candidates
from lightopt.design._result import SHARES_OF, ChosenPostures, ObjectiveResult, SetResult, angles_of
from lightopt.design.objectives._detectability import DetectabilityObjective
from lightopt.design.postures._light_positions import position_counts, position_counts_fit
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._packed_bits import unpack_flags
from lightopt.design.responses._pair_counts import Counts, covered_weight, sum_counts
from lightopt.design.search._combinations import Ranked
from lightopt.design.search._curves import Curve, score_curves
from lightopt.scene import PanelLight

# among what the lights of a plan are the best, or not known to be
PROVEN_OF = "positions of the lights in these postures at these exposures; for the postures see chosen_postures"

# among what another objective's lights are the best where its own positions could not be searched
PROVEN_OF_ONE = "the positions that the first objective chose, the only ones that were scored"


@dataclass(frozen=True)
class PlannedDetectability(DetectabilityObjective):
    """Detectability of all planned images together, as a share of what the camera sees in any candidate posture.

    area: Of that surface [µm²].
    """

    share_of: str | None = SHARES_OF
    area: int = 0

    def full_score(self, area: int) -> int | None:
        """The same whatever the area of the chosen postures."""
        del area
        return super().full_score(self.area)


def planned_answers(
    result: SetResult,
    chosen: ChosenPostures,
    evaluator: ImageEvaluator,
    candidates: Candidates,
    free: Candidates | None,
    progress: Share | None = None,
) -> SetResult:
    """The best lights of each objective, scored for defects by what they show in the plan's postures and exposures.

    result: Of the chosen postures; the first objective is detectability.
    candidates: Positions of the lights that the result is of.
    free: All positions to choose from: the curves go through them, where the chosen ones are among them; None where
        no light moves.
    progress: Called with the share of the curves that is done.
    """
    first = result.answers[0].objective
    assert isinstance(first, DetectabilityObjective)
    goal = PlannedDetectability(first.hypotheses, first.min_images, area=int(evaluator.weights.areas.sum()))
    answers = tuple(_planned(answer, goal, chosen, evaluator, candidates, free) for answer in result.answers)
    best = answers[0].found.best
    at = angles_of(candidates, best)
    curves: tuple[Curve, ...] = ()
    if (
        free is not None
        and all(angles in some for angles, some in zip(at, free.angles, strict=True))
        and position_counts_fit(evaluator, free, min_images=chosen.least)
    ):
        here = tuple(some.index(angles) for angles, some in zip(at, free.angles, strict=True))
        curves = _curves(replace(best, candidates=here), chosen, evaluator, free, progress)
    return replace(result, answers=answers, curves=curves)


def _curves(
    best: Ranked, chosen: ChosenPostures, evaluator: ImageEvaluator, free: Candidates, progress: Share | None
) -> tuple[Curve, ...]:
    postures = [(posture, chosen.exposures_of(posture)) for posture in chosen.way.order]
    lights = chosen.choice.position_counts or position_counts(
        evaluator, postures, free, min_images=chosen.least, progress=progress
    )

    def score(combination: tuple[int, ...]) -> int:
        shown = (places[k] for places, k in zip(lights, combination, strict=True))
        return covered_weight(sum_counts(shown, evaluator.weights, chosen.least), evaluator.weights)

    return score_curves(free, best, score)


def _planned(
    answer: ObjectiveResult,
    goal: PlannedDetectability,
    chosen: ChosenPostures,
    evaluator: ImageEvaluator,
    candidates: Candidates,
    free: Candidates | None,
) -> ObjectiveResult:
    best = answer.found.best
    panels = candidates.panels_at(best.candidates)
    counts = _counts(chosen, evaluator, panels)
    score = covered_weight(counts, evaluator.weights)
    scores = {**answer.scores, goal.name: score}
    if answer.objective.name != goal.name:
        searched = free is None or any(len(some) > 1 for some in candidates.angles)
        return replace(answer, scores=scores, proven_of=None if searched else PROVEN_OF_ONE)
    # where no other positions show more in these postures; else no bound is known but all there is to see
    best_there = chosen.choice.exact and chosen.choice.converged
    bound = score if best_there else evaluator.weights.total
    seen = evaluator.weights.areas @ unpack_flags(counts[-1], len(goal.hypotheses))
    return replace(
        answer,
        objective=goal,
        found=replace(answer.found, ranking=(replace(best, negative_score=-score),), bound=bound),
        scores=scores,
        details=goal.facts(seen, goal.area),
        nothing=None,
        proven_of=PROVEN_OF,
    )


def _counts(chosen: ChosenPostures, evaluator: ImageEvaluator, panels: Sequence[PanelLight]) -> Counts:
    images = (
        replace(evaluator, exposures=chosen.exposures_of(posture)).counts(posture, panels, min_images=chosen.least)
        for posture in chosen.way.order
    )
    return sum_counts(images, evaluator.weights, chosen.least)
