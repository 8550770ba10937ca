"""Postures, lights and exposures chosen together.

Two plans are made, one with postures and lights as chosen for exposure 1 alone, one with those chosen for what the
images show with any of the exposures; to either the exposures with enough gain are added (:mod:`._exposures`). The plan
is kept that reaches the target with fewer postures, and then the one that shows more, after deducting the least gain
for each further exposure. Each exposure of the first plan adds as much as that at least: so what is kept shows no less
than the plan without further exposures.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from lightopt.core.run_context import RunContext
from lightopt.core.transforms import Posture
from lightopt.design._candidates import Candidates
from lightopt.design.postures._cover_search import Cover, best_set, cover_steps, greedy_cover, greedy_order
from lightopt.design.postures._exposures import plan_exposures
from lightopt.design.postures._light_positions import best_positions, position_counts_fit
from lightopt.design.postures._posture_search import PostureChoice, PostureRequest, choose_postures
from lightopt.design.responses._image_evaluator import ImageEvaluator
from lightopt.design.responses._packed_bits import Counts
from lightopt.lights import PanelLight

MOST_ITERATIONS = 2  # of the lights for the images as they are planned, at the end


def choose_with_exposures(
    whole: ImageEvaluator,
    drawn: ImageEvaluator,
    postures: Sequence[Posture],
    start: Sequence[PanelLight],
    candidates: Candidates | None,
    request: PostureRequest,
    exposures: Sequence[float],  # 1 among them; with no other the choice is that of exposure 1, without brackets
    gain_points: float,  # what a further exposure has to add [hundredths of the pairs]
    run: RunContext,
) -> PostureChoice:
    """Choose postures and lights, and which further exposures are planned; figures are of the planned images.

    whole, drawn, postures, start, candidates, request, run: As for :func:`lightopt.design.choose_postures`;
        evaluators of exposure 1.
    Returns the choice of the planned images; bounds and all candidates' share hold for any of the exposures. Where a
    target cannot be reached, what was chosen for all exposures, without brackets.
    """
    levels = tuple(dict.fromkeys((1.0, *exposures)))
    if len(levels) == 1:
        return choose_postures(whole, drawn, postures, start, candidates, request, run=run)

    def chosen_on(every: ImageEvaluator, some: ImageEvaluator, stage: str) -> PostureChoice:
        choice = choose_postures(every, some, postures, start, candidates, request, run=run.within(stage))
        # counts and images of positions are of other exposures than those that will be planned
        return replace(choice, position_counts=None, images=None)

    single = chosen_on(whole, drawn, "exposure 1")
    every, some = (replace(evaluator, exposures=levels) for evaluator in (whole, drawn))
    together = chosen_on(every, some, "all exposures")
    both = [one for one in (single, together) if request.target is None or one.cover.share >= request.target]
    if not any(one.postures for one in both):
        return together
    planner = _JointPlanner(every, candidates, request, gain_points / 100.0, run)
    best = max((planner.add_exposures(one) for one in both if one.postures), key=planner.merit)
    best = planner.place_lights(best)
    cover = planner.cover(best, postures)
    chosen = tuple(postures[step.candidate] for step in cover.steps)
    return replace(best, postures=chosen, cover=cover, initial=single.initial)


@dataclass(frozen=True, eq=False)
class _JointPlanner:
    """The evaluator's exposures and the positions of the lights to choose from."""

    whole: ImageEvaluator
    candidates: Candidates | None
    request: PostureRequest
    least_gain: float
    run: RunContext

    def add_exposures(self, choice: PostureChoice) -> PostureChoice:
        """A choice with the exposures that have enough gain."""
        panels, progress = [choice.panels] * len(choice.postures), self.run.stage("exposures")
        request = self.whole.exposures, 100.0 * self.least_gain, self.request.target
        return replace(choice, brackets=plan_exposures(self.whole, choice.postures, panels, *request, progress))

    def merit(self, plan: PostureChoice) -> tuple[float, ...]:
        """Sort key of a plan; see the module's text."""
        assert plan.brackets is not None
        further = sum(exposure.reason is not None for exposure in plan.brackets.further)
        count = 0 if self.request.target is None else -len(plan.postures)
        return count, plan.brackets.after - self.least_gain * further, -further

    def place_lights(self, plan: PostureChoice) -> PostureChoice:
        """The lights where they serve the planned images best, and the exposures with enough gain there."""
        if self.candidates is None:
            return plan
        if not position_counts_fit(self.whole, self.candidates):
            return replace(plan, converged=False)
        for _ in range(MOST_ITERATIONS):
            postures = [(posture, plan.exposures_of(posture)) for posture in plan.postures]
            progress, limit = self.run.stage("lights for the planned images"), self.request.limit
            positions, _ = best_positions(self.whole, postures, self.candidates, limit=limit, progress=progress)
            assert plan.brackets is not None
            covered = round(plan.brackets.after * max(1, self.whole.weights.total))
            plan = replace(plan, converged=positions.covered <= covered, exact=plan.exact and positions.exact)
            if plan.converged:
                return plan
            lights, panels = positions.candidates, self.candidates.panels_at(positions.candidates)
            better = self.add_exposures(replace(plan, lights=lights, panels=panels, iterations=plan.iterations + 1))
            if self.merit(better) <= self.merit(plan):
                return plan
            plan = better
        return plan

    def cover(self, plan: PostureChoice, postures: Sequence[Posture]) -> Cover:
        """What the planned images show, posture by posture; bounds are of all postures at any of the exposures."""
        weights = self.whole.weights
        indices = [postures.index(posture) for posture in plan.postures]
        every = [self._counts(plan, posture, self.whole.exposures) for posture in postures]
        free = greedy_cover(every, weights, count=len(indices), threads=self.whole.threads)
        own = {i: self._counts(plan, postures[i], plan.exposures_of(postures[i])) for i in sorted(indices)}
        cover = replace(
            free,
            steps=cover_steps([(i, own[i]) for i in greedy_order(own, weights, self.whole.needed)], weights),
            # where fewer postures show everything, more cannot add to it
            bounds=(*free.bounds, *([free.all_benefit] * (len(indices) - len(free.steps)))),
        )
        if self.request.target is not None:
            return replace(cover, target=self.request.target)
        _, most, sets = best_set(every, weights, free.chosen, len(indices), threads=self.whole.threads)
        return cover if sets is None else replace(cover, sets=sets, max_covered=most)

    def _counts(self, plan: PostureChoice, posture: Posture, exposures: tuple[float, ...]) -> Counts:
        return replace(self.whole, exposures=exposures).counts(posture, plan.panels)
